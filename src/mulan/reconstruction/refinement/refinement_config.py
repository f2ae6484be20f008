"""Options of pose refinement."""

from dataclasses import dataclass, field, replace

from mulan.radiance.space import SceneSpace
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
class AllAroundConfig:
    """What is done otherwise where the background lies all around.

    There a field bends to a robot that is displaced as a whole, and holds it there. What the best-known
    robot's images alone have taught does not, and shows much of what the others see. Of an object, it knows
    one side.
    """

    anchor_stage: CoarseStage = field(default_factory=lambda: CoarseStage(1, 16, 2000))
    """Registration begins once more, with these images alone."""
    stage: CoarseStage = field(default_factory=lambda: CoarseStage(1, 16, 1500))
    """And then all images and poses again, in that field."""
    final_alone: float = 0.15
    """So does the final field, for this share of its training."""
    final_every: int = 5
    """Steps of the final field between two Gauss-Newton steps: before it bends again."""
    independent_residuals: float = 48.0
    """Of an image of 100 pixels a side: each pixel shows something. Chosen as the other one is, on seeds 100
    and 101."""


@dataclass(frozen=True)
class RefinementConfig:
    """How poses are corrected while the field is learnt."""

    image_size: int = 100
    """Longest side of the pictures registration works on, in pixels."""
    first: CoarseStage = field(default_factory=lambda: CoarseStage(6, 3, 200))
    """Before any pose moves: the best-known robot's images alone."""
    stages: tuple[CoarseStage, ...] = (CoarseStage(6, 3, 100), CoarseStage(3, 5, 200), CoarseStage(1, 6, 200))
    """Then all images, poses and field by turns."""
    frame_stage: CoarseStage = field(default_factory=lambda: CoarseStage(0, 16, 300))
    """Where no image is exact, one more: the map as a whole must fit the few that localization knows best."""
    all_around: AllAroundConfig = field(default_factory=AllAroundConfig)
    """What is done otherwise where no object was cut out."""
    multi_start: MultiStartConfig = field(default_factory=MultiStartConfig)
    """How starts are drawn from the prior."""
    first_pose_steps: int = 12
    """Gauss-Newton steps before the best-known robot's field."""
    pose_every: int = 10
    """Steps of the field between two Gauss-Newton steps of registration."""
    most_misfit: float = 2.0
    """An image whose residuals are so many times those of the best-known images is lost: it is looked for
    anew, and left out if it stays lost."""
    rays: int = 256
    """Pixels of each image in a Gauss-Newton step."""
    batch_samples: int = 2**14
    """Field evaluations a step of registration."""
    final_every: int = 25
    """Steps of the final field between two Gauss-Newton steps."""
    final_alone: float = 0.0
    """Share of the final training in which only the best-known robot's images are learnt from."""
    final_rays: int = 128
    """Pixels of each image in one of these."""
    first_step_share: float = 1.6
    """Of a Gauss-Newton step, the share the first ones take: the field follows each move, so that poses which
    move together get on in small steps."""
    least_step_share: float = 0.1
    """The share the last ones take; it shrinks to that during the training."""
    final_from: float = 0.15
    """Share of the final training before which poses rest: a field that is still a blur, or changes fast,
    misleads them by more than registration left to mend."""
    final_until: float = 0.85
    """Share of the final training after which poses rest."""
    residual_area_px: float = 4.0
    """In registration, pixels whose residuals agree with each other, as an area."""
    final_residuals: float = 64.0
    """Residuals of an image that count as independent where poses follow the final field. With more, what
    localization knows of neighbouring images counts for nothing; with fewer, poses follow too slowly. Chosen
    on seed 100."""
    independent_residuals: float = 6.0
    """Residuals of an image of 100 pixels a side that count as independent for its posterior covariance:
    where the field is wrong, it is so over whole parts of a picture. As many fewer as the image is larger.
    Chosen for honest covariances on seeds from 100 on."""
    held_error: float = 3.0
    """Where no image is exact, variance by which the one known best may lie off its place in the map, as a
    multiple of what its own residuals leave it. Chosen for honest covariances on seeds 100 to 102."""
    posterior_points: int = 16
    """Points of each image that are looked up in all others to tell how well poses are known in the end."""

    def for_space(self, space: SceneSpace) -> "RefinementConfig":
        """The options that hold in a scene."""
        if not space.unbounded:
            return self
        around = self.all_around
        return replace(
            self,
            final_alone=around.final_alone,
            final_every=around.final_every,
            independent_residuals=around.independent_residuals,
        )
