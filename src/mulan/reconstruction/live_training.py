"""A field that goes on learning while photographs are added and their poses change."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mulan.errors import InputError
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage, load_captured
from mulan.reconstruction.checkpoint import Progress, read_checkpoint, write_checkpoint
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import FEW_VIEWS, choose_field, choose_march, choose_optimiser
from mulan.reconstruction.field_file import FieldDescription, read_tensors, save_field
from mulan.reconstruction.held_out import psnr_db
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.sub_pixels import Antialiasing
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import CURVE_VIEWS, SMOOTHING, next_rays
from mulan.reconstruction.weights import Weighting

CHECKPOINT = "live_checkpoint.safetensors"
_MOVED_SHARE = 0.3  # of the radius: a scene farther off than this is learnt anew
_RESIZED = 1.6


@dataclass(frozen=True)
class _Shown:
    """What is learnt from at present."""

    train: tuple[CapturedImage, ...]
    test: tuple[CapturedImage, ...]


class LiveTraining:
    """Learns from whatever was shown last; every step draws from all photographs, old and new alike.

    The learning rate stays at its first value while photographs may still come, for what comes last must be
    learnt as well as what came first, and falls only in :meth:`cool_down` (a constant rate with a short fall
    does as well as a cosine over the whole training; Hägele et al. 2024).

    Attributes:
        run: Folder of checkpoint, field and history.
        engine: The field; None before photographs were shown.
        progress: Steps, seconds and curve so far.
        begun_anew: How often the scene turned out to be elsewhere and the field was begun anew.
    """

    def __init__(self, run: RunFolder, config: TrainConfig, weighting: Weighting) -> None:
        """Take up an earlier live training in the run if there is one.

        Args:
            run: Folder to write to.
            config: Options; the time budget and the number of steps are not used.
            weighting: How far each pixel is trusted.

        Raises:
            InputError: The checkpoint in the run is damaged or was made with other options.
        """
        self.run = run
        self.engine: RadianceEngine | None = None
        self.progress = Progress()
        self.begun_anew = 0
        self._config, self._weighting = config, weighting
        self._description: FieldDescription | None = None
        self._decoded: dict[Path, CapturedImage] = {}
        self._shown = _Shown((), ())
        self._data: ImageTensors | None = None
        self._sampler = torch.Generator().manual_seed(config.seed + 1)
        if self._checkpoint.exists():
            self._take_up()

    @property
    def description(self) -> FieldDescription:
        """Sizes and space of the field.

        Raises:
            ValueError: There is none yet.
        """
        if self._description is None:
            raise ValueError("no photograph was shown yet")
        return self._description

    @property
    def test(self) -> tuple[CapturedImage, ...]:
        """Held-out photographs shown last."""
        return self._shown.test

    def show(self, images: PosedImageSet) -> None:
        """Learn from these photographs from now on; a file is decoded once, its pose may change.

        Raises:
            InputError: A photograph is missing or damaged, or its pose is not finite.
        """
        self._shown = _Shown(self._captured(images.train), self._captured(images.test))
        train = self._shown.train
        likely, other = self._spaces(train)
        known = None if self._description is None else self._description.space
        if known is None or (_is_elsewhere(known, likely) and _is_elsewhere(known, other)):
            self._begin(likely)
        space = self.description.space
        data = ImageTensors(train, self._weighting.weight_maps(train, space))
        self._data = data if data.drawable_pixels else None
        if self._data is not None:
            self._data.move_to(self._config.device.resolve())

    def learn(self, seconds: float, stop: Callable[[], bool] = lambda: False) -> None:
        """Learn for a time at the full rate, or until told to stop."""
        until_s = self.progress.seconds + seconds
        while self._data is not None and self.progress.seconds < until_s and not stop():
            self._step(1.0, pairs=False)

    def cool_down(self, seconds: float, stop: Callable[[], bool] = lambda: False) -> None:
        """Learn for a time while the rate falls to its last value, or until told to stop."""
        if self._data is None:
            return
        begin_s = self.progress.seconds
        antialiasing = self._antialiasing
        while not stop() and (done := (self.progress.seconds - begin_s) / max(seconds, 1e-9)) < 1:
            self._step(self._config.learning_rate_factor(done), antialiasing.began(done))

    def save(self) -> None:
        """Write the checkpoint, the field, and the curve with a new point; nothing before the first step.

        Raises:
            InputError: The disk is full; earlier files are untouched.
        """
        if self.engine is None or not self.progress.steps:
            return
        self._add_to_history()
        write_checkpoint(
            self._checkpoint, self.engine.state(), self._sampler, self.progress, self._identity()
        )
        save_field(self.run.field, self.engine, self.description)
        write_json(self.run.history, list(self.progress.history))

    @property
    def _checkpoint(self) -> Path:
        return self.run.root / CHECKPOINT

    @property
    def _antialiasing(self) -> Antialiasing:
        on_gpu = self._config.device.resolve().type == "cuda"
        return Antialiasing.choose(self._config.antialias_share, self.description.space.unbounded, on_gpu)

    def _captured(self, images: tuple[PosedImage, ...]) -> tuple[CapturedImage, ...]:
        captured = []
        for image in images:
            if image.path not in self._decoded:
                self._decoded[image.path] = load_captured([image], self._config.image_size)[0]
            captured.append(replace(self._decoded[image.path], posed=image))
        return tuple(captured)

    def _spaces(self, train: tuple[CapturedImage, ...]) -> tuple[SceneSpace, SceneSpace]:
        """Where the scene is by the photographs that are trusted and by all, the likelier first.

        The first round may trust the anchor alone, whose few photographs say less than those of all.
        """
        by_all = choose_space(train)
        trusted = [
            image
            for image, ignored in zip(train, self._weighting.ignored(train, by_all), strict=True)
            if not ignored
        ]
        if len(trusted) == len(train):
            return by_all, by_all
        by_trusted = choose_space(trusted)
        return (by_trusted, by_all) if 2 * len(trusted) > len(train) else (by_all, by_trusted)

    def _begin(self, space: SceneSpace) -> None:
        """An untrained field where the scene is."""
        config, device = self._config, self._config.device.resolve()
        on_gpu = device.type == "cuda"
        # more photographs will come, so the field is made for many
        field = config.field or choose_field(config.image_size, FEW_VIEWS + 1, space.unbounded, on_gpu)
        march = config.march or choose_march(config.image_size, space.unbounded, on_gpu=on_gpu)
        antialiasing = Antialiasing.choose(config.antialias_share, space.unbounded, on_gpu)
        if self._description is not None:
            self.begun_anew += 1
        self._description = FieldDescription(
            field, march, space, not space.unbounded, antialiasing.sub_pixels
        )
        self.engine = self._new_engine(self._description)
        self.progress = replace(self.progress, rays=Progress.rays, mean_squared_error=None)

    def _new_engine(self, description: FieldDescription) -> RadianceEngine:
        device = self._config.device.resolve()
        optimiser = choose_optimiser(description.space.unbounded)
        return description.new_engine(self._config.seed, optimiser, device)

    def _take_up(self) -> None:
        _, header = read_tensors(self._checkpoint)
        try:
            self._description = FieldDescription.from_json(header["identity"]["description"])
        except (KeyError, TypeError) as error:
            problem = "is not one of this version"
            raise InputError(self._checkpoint, "checkpoint", problem, "delete it to start anew") from error
        tensors, self._sampler, self.progress = read_checkpoint(self._checkpoint, self._identity())
        self.engine = self._new_engine(self._description)
        self.engine.load_state(tensors)

    def _identity(self) -> dict[str, Any]:
        options = self._config.what_is_learnt()
        for name in ("device", "field", "march", "time_budget_s", "steps"):
            del options[name]
        return {
            **options,
            "weighting": f"{self._weighting}",
            "description": self.description.to_json(),
        }

    def _step(self, learning_rate_factor: float, pairs: bool) -> None:
        assert self.engine is not None
        assert self._data is not None
        s, config, began = self.progress, self._config, time.perf_counter()
        draw = self._data.sample_pairs if pairs else self._data.sample
        report = self.engine.train_step(draw(s.rays, self._sampler), learning_rate_factor)
        seconds = s.seconds + time.perf_counter() - began
        error = report.mean_squared_error
        if s.mean_squared_error is not None:
            error = SMOOTHING * s.mean_squared_error + (1 - SMOOTHING) * error
        target = config.samples_a_batch(config.device.resolve().type == "cuda")
        rays = next_rays(s.rays, report.samples, target)
        self.progress = Progress(
            s.steps + 1, seconds, rays, s.samples + report.samples, report.loss, error, s.history
        )

    def _add_to_history(self) -> None:
        assert self.engine is not None
        s, test = self.progress, self._shown.test
        views = ImageTensors(test[:: max(1, len(test) // CURVE_VIEWS)]) if test else None
        scores = [psnr_db(self.engine, views, i) for i in range(len(views))] if views else []
        point = {
            "seconds": round(s.seconds, 3),
            "steps": s.steps,
            "loss": s.loss,
            "train_psnr_db": -10 * math.log10(max(s.mean_squared_error or 1.0, 1e-10)),
            "test_psnr_db": sum(scores) / len(scores) if scores else None,
            "photographs": len(self._shown.train),
        }
        self.progress = replace(s, history=(*s.history, point))


def _is_elsewhere(known: SceneSpace, found: SceneSpace) -> bool:
    """Whether a scene lies so far from where it was thought to be that its field is of no use."""
    apart_m = float(np.linalg.norm(np.subtract(known.centre_m, found.centre_m)))
    ratio = found.radius_m / known.radius_m
    moved = apart_m > _MOVED_SHARE * known.radius_m or not 1 / _RESIZED < ratio < _RESIZED
    return moved or known.unbounded != found.unbounded
