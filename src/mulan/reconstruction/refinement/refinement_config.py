"""Options of pose refinement."""

from dataclasses import dataclass, field

from mulan.reconstruction.refinement.multi_start import MultiStartConfig


@dataclass(frozen=True)
class CoarseStage:
    """One stage of registration: how smooth the pictures are and how fine the field."""

    blur_px: int
    """Radius of the box every pixel is averaged over, at the registration's image size."""
    levels: int
    """Coarsest levels of the hash grid that take part."""
    steps: int
    """Steps of the field."""


@dataclass(frozen=True)
class RefinementConfig:
    """How poses are corrected while the field is learnt."""

    image_size: int = 100
    """Longest side of the pictures registration works on, in pixels."""
    first: CoarseStage = field(default_factory=lambda: CoarseStage(6, 3, 200))
    """Before any pose moves: the best-known robot's images alone."""
    stages: tuple[CoarseStage, ...] = (CoarseStage(6, 3, 100), CoarseStage(3, 5, 200), CoarseStage(1, 6, 200))
    """Then all images, poses and field by turns."""
    multi_start: MultiStartConfig = field(default_factory=MultiStartConfig)
    """How starts are drawn from the prior."""
    first_pose_steps: int = 8
    """Gauss-Newton steps before the best-known robot's field."""
    pose_every: int = 10
    """Steps of the field between two Gauss-Newton steps of registration."""
    rays: int = 256
    """Pixels of each image in a Gauss-Newton step."""
    batch_samples: int = 2**14
    """Field evaluations a step of registration."""
    final_every: int = 75
    """Steps of the final field between two Gauss-Newton steps."""
    final_rays: int = 384
    """Pixels of each image in one of these."""
    least_step_share: float = 0.1
    """Of a Gauss-Newton step, the share the last ones take; it shrinks to that during the training."""
    final_from: float = 0.2
    """Share of the final training before which poses rest: a field that is still a blur misleads them."""
    final_until: float = 0.85
    """Share of the final training after which poses rest."""
    residual_area_px: float = 4.0
    """Pixels whose residuals agree with each other, as an area."""
