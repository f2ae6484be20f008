"""The one place where the table calls pose refinement."""

from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.refinement.refine import Progress, RefinedTraining, refine_and_train
from mulan.reconstruction.refinement.refinement_config import RefinementConfig
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import Weighting

_REFINEMENT = RefinementConfig()


def refinement_options() -> str:
    """Everything the refinement depends on, as text."""
    return f"{_REFINEMENT}"


def train_refined(
    images: PosedImageSet, weighting: Weighting, config: TrainConfig, run: RunFolder, progress: Progress
) -> RefinedTraining:
    """Correct the poses that carry a covariance and learn the field, with the default options.

    Raises:
        InputError: See :func:`mulan.reconstruction.refinement.refine.refine_and_train`.
    """
    return refine_and_train(images, weighting, config, _REFINEMENT, run, progress)
