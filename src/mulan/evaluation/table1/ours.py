"""The one place where the table calls pose refinement."""

from collections.abc import Callable
from dataclasses import dataclass

from mulan.errors import InputError
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingResult, TrainingStatus
from mulan.reconstruction.weights import Weighting


@dataclass(frozen=True)
class RefinedTraining:
    """A field and the poses corrected while it was learnt.

    Attributes:
        training: The field.
        images: The photographs at their refined poses, with posterior covariances.
    """

    training: TrainingResult
    images: PosedImageSet


def refinement_options() -> str:
    """Everything the refinement depends on, as text."""
    return ""


def train_refined(
    images: PosedImageSet,  # noqa: ARG001
    weighting: Weighting,  # noqa: ARG001
    config: TrainConfig,  # noqa: ARG001
    run: RunFolder,  # noqa: ARG001
    progress: Callable[[TrainingStatus], None] | None,  # noqa: ARG001
) -> RefinedTraining:
    """Learn the field and correct the poses.

    Raises:
        InputError: Always, until refinement is there.
    """
    raise InputError(
        "--only", "setup 'ours'", "pose refinement is not built yet", "name the other setups with --only"
    )
