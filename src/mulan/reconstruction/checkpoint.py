"""An unfinished training on disk, and whether it may be taken up again."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mulan.errors import InputError
from mulan.reconstruction.field_file import read_tensors, write_tensors

_SAMPLER = "trainer.generator"


@dataclass(frozen=True)
class Progress:
    """Where a training stands, apart from the engine's own state.

    Attributes:
        steps: Optimiser steps done.
        seconds: Time spent learning, evaluation and files excluded.
        rays: Rays in the next batch.
        samples: Field evaluations so far.
        loss: Of the last step.
        mean_squared_error: Running mean over recent batches, None before the first.
        history: Training curve so far.
    """

    steps: int = 0
    seconds: float = 0.0
    rays: int = 256
    samples: int = 0
    loss: float = 0.0
    mean_squared_error: float | None = None
    history: tuple[dict[str, Any], ...] = ()


def write_checkpoint(
    path: Path,
    engine_state: dict[str, Tensor],
    sampler: torch.Generator,
    progress: Progress,
    identity: dict[str, Any],
) -> None:
    """Write everything needed to go on as if nothing had happened, atomically.

    Args:
        path: File to write.
        engine_state: The engine's tensors.
        sampler: Generator that draws the batches.
        progress: Where the training stands.
        identity: Options and data the training depends on.
    """
    tensors = {**engine_state, _SAMPLER: sampler.get_state()}
    header = {"identity": identity, "progress": {**progress.__dict__, "history": list(progress.history)}}
    write_tensors(path, tensors, header)


def read_checkpoint(
    path: Path, identity: dict[str, Any]
) -> tuple[dict[str, Tensor], torch.Generator, Progress]:
    """What :func:`write_checkpoint` wrote, if it belongs to the same training.

    Raises:
        InputError: The file is damaged, or was made with other options or other images (the first that
            differs is named).
    """
    tensors, header = read_tensors(path)
    try:
        saved, progress = header["identity"], header["progress"]
        sampler = torch.Generator()
        sampler.set_state(tensors.pop(_SAMPLER))
        state = Progress(**{**progress, "history": tuple(progress["history"])})
    except (KeyError, TypeError, RuntimeError) as error:
        raise InputError(
            path, "checkpoint", "is not one of this version", "delete it to start anew"
        ) from error
    # options before images: a changed option is the better explanation of changed weights
    for key in sorted({*identity, *saved}, key=lambda key: (key == "images", key)):
        if identity.get(key) != saved.get(key):
            problem = f"was {saved.get(key)!r} in the unfinished training and is {identity.get(key)!r} now"
            raise InputError(
                path, key, problem, "use the earlier options to resume, or delete the file to start anew"
            )
    return tensors, sampler, state
