"""What each of two processes does for test_data_parallel; prints one JSON line a process."""

import hashlib
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest import mock

import torch

from mulan.errors import InputError
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.process_group import ProcessGroup, processes_of_torchrun
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingResult, TrainingStatus, train
from mulan.reconstruction.weights import UncertaintyWeights

BATCH_SAMPLES = 1024  # of each process
CONFIG = TrainConfig(
    image_size=24, steps=130, batch_samples=BATCH_SAMPLES, evaluate_every_s=0.0, checkpoint_every_s=1e9
)
SAVES_OFTEN = replace(CONFIG, checkpoint_every_s=0.0)


class StoppedError(Exception):
    """Ends a training as a kill would: at once, everywhere."""


class Processes:
    """One of the two."""

    def __init__(self, group: ProcessGroup, folder: Path) -> None:
        self.group, self.folder = group, folder

    def train(
        self, config: TrainConfig, run: str, progress: Callable[[TrainingStatus], None] | None = None
    ) -> TrainingResult:
        images = read_transforms(self.folder / "transforms.json")
        return train(images, UncertaintyWeights(), config, RunFolder(self.folder / run), progress, self.group)

    def stopped(self) -> None:
        def stop(status: TrainingStatus) -> None:
            if status.steps == 100:
                raise StoppedError

        try:
            self.train(SAVES_OFTEN, "resumed", stop)
        except StoppedError:
            return
        raise AssertionError

    def failure(self) -> str:
        """How a training ends in which process 1 cannot draw its sixth batch."""

        def fail(*_: object) -> None:
            raise ValueError("no such ray")

        def progress(status: TrainingStatus) -> None:
            if self.group.place.rank == 1 and status.steps == 5:
                spoilt.start()

        spoilt = mock.patch.object(ImageTensors, "rays", fail)
        try:
            self.train(CONFIG, "failed", progress)
        except (InputError, ValueError) as error:
            return f"{type(error).__name__} {error}"
        finally:
            mock.patch.stopall()
        return "nothing"

    def say(self, **values: object) -> None:
        sys.stdout.write(json.dumps({"rank": self.group.place.rank, **values}) + "\n")
        sys.stdout.flush()


def digests(state: dict[str, torch.Tensor]) -> dict[str, str]:
    return {name: hashlib.sha256(t.numpy().tobytes()).hexdigest() for name, t in state.items()}


def main() -> None:
    with processes_of_torchrun() as group:
        assert group is not None
        these = Processes(group, Path(sys.argv[1]))
        whole = these.train(CONFIG, "whole")
        these.stopped()
        resumed = these.train(SAVES_OFTEN, "resumed")
        timed = these.train(replace(SAVES_OFTEN, steps=None, time_budget_s=0.5), "timed")
        these.say(
            whole=digests(whole.engine.state()),
            resumed=digests(resumed.engine.state()),
            whole_seconds=whole.seconds,
            timed=[timed.steps, timed.seconds],
            failure=these.failure(),
        )


if __name__ == "__main__":
    main()
