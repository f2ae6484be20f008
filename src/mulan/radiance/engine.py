"""What a trainable radiance field offers; every backend (torch, native, GPU) implements exactly this."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.ray_gradients import RayGradients


@dataclass(frozen=True)
class RayBatch:
    """Rays to learn from.

    Attributes:
        origins: World points [m].
        directions: Unit world directions.
        colours: Target colours in [0, 1], already over the background where the scene has one.
        weights: Trust in each ray; zero means the ray is ignored.
        image_index: Which image each ray came from.
        opacity: Coverage of each ray's pixel by the object, where known; only learning before random
            backgrounds needs it.
        rays_a_pixel: So many neighbouring rays (at most 16) sample one pixel, repeat its colour, weight and
            image: the loss compares the colour with their mean.
    """

    origins: Float[Tensor, "r 3"]
    directions: Float[Tensor, "r 3"]
    colours: Float[Tensor, "r 3"]
    weights: Float[Tensor, "r"]
    image_index: Int[Tensor, "r"]
    opacity: Float[Tensor, "r"] | None = None
    rays_a_pixel: int = 1

    def to(self, device: torch.device) -> "RayBatch":
        """The same rays on another device."""
        return RayBatch(
            origins=self.origins.to(device),
            directions=self.directions.to(device),
            colours=self.colours.to(device),
            weights=self.weights.to(device),
            image_index=self.image_index.to(device),
            opacity=None if self.opacity is None else self.opacity.to(device),
            rays_a_pixel=self.rays_a_pixel,
        )


@dataclass(frozen=True)
class Rendering:
    """What rays see.

    Attributes:
        colour: In [0, 1], over the background.
        depth_m: Expected distance along the ray.
        opacity: Accumulated alpha.
        variance: Predicted variance of the colour.
    """

    colour: Float[Tensor, "r 3"]
    depth_m: Float[Tensor, "r"]
    opacity: Float[Tensor, "r"]
    variance: Float[Tensor, "r"]


@dataclass(frozen=True)
class StepReport:
    """What one optimiser step did.

    Attributes:
        loss: Weighted mean loss.
        mean_squared_error: Unweighted mean squared colour error of the batch.
        samples: Field evaluations marched.
    """

    loss: float
    mean_squared_error: float
    samples: int


@dataclass(frozen=True)
class RaySamples:
    """Samples along rays, packed one after another, for planners.

    Attributes:
        ray_index: Ray each sample lies on (non-decreasing).
        blend: Compositing weight of each sample (transmittance times alpha).
        colour: Colour of each sample.
        variance: Predicted colour variance of each sample.
        distance_m: Distance along the ray.
    """

    ray_index: Int[Tensor, "s"]
    blend: Float[Tensor, "s"]
    colour: Float[Tensor, "s 3"]
    variance: Float[Tensor, "s"]
    distance_m: Float[Tensor, "s"]


class RadianceEngine(ABC):
    """A radiance field that can be trained, rendered, saved and restored.

    Attributes:
        device: Where it computes, and where batches are best kept. Rays from elsewhere are moved there;
            answers go back to where the rays came from.
    """

    device: torch.device = torch.device("cpu")

    @abstractmethod
    def train_step(self, batch: RayBatch, learning_rate_factor: float) -> StepReport:
        """One optimiser step; the factor scales the base learning rates (schedule)."""

    @abstractmethod
    def render(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """Colour, depth, opacity and colour variance along rays, without gradients."""

    def preview(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """A rendering that may leave out what is nearly clear, where an engine is faster without it."""
        return self.render(origins, directions)

    @abstractmethod
    def sample(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> RaySamples:
        """The samples a rendering is made of, without gradients."""

    @abstractmethod
    def density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        """Density [1/m] at world points, without gradients."""

    @abstractmethod
    def set_level_weights(self, weights: Float[Tensor, "levels"]) -> None:
        """Scale each level's features (coarse-to-fine); a level of weight 0 neither acts nor learns.

        Raises:
            ValueError: There are not as many as levels, or one is not finite.
        """

    @abstractmethod
    def ray_gradients(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        colour_gradient: Float[Tensor, "r 3"],
    ) -> tuple[Rendering, RayGradients]:
        """A rendering, and what a gradient to its colours means for the rays; the field stays as it is."""

    @abstractmethod
    def state(self) -> dict[str, Tensor]:
        """Everything needed to go on training: parameters, moments, occupancy, counters."""

    def check_state(self, state: dict[str, Tensor]) -> None:
        """Compare a saved state's names, shapes and types with this engine's own.

        Raises:
            ValueError: A tensor is missing or of another shape or type.
        """
        for name, mine in self.state().items():
            if name not in state:
                raise ValueError(f"the saved field lacks '{name}'")
            if state[name].shape != mine.shape or state[name].dtype != mine.dtype:
                raise ValueError(
                    f"'{name}' has shape {tuple(state[name].shape)} and type {state[name].dtype},"
                    f" not {tuple(mine.shape)} and {mine.dtype}"
                )

    @abstractmethod
    def load_state(self, state: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` gave.

        Raises:
            ValueError: A tensor is missing or has another shape.
        """
