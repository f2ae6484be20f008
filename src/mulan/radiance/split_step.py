"""A training step in two halves, so that several processes can average their gradients between them."""

from abc import abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from mulan.radiance.engine import RadianceEngine, RayBatch, StepReport


@dataclass(frozen=True)
class BatchPart:
    """Which rays of a joint batch a process has; sampling noise goes by a ray's number in the joint batch.

    Attributes:
        first: Number of its first ray.
        rays: Rays it has.
        joint_rays: Rays of the joint batch.
    """

    first: int
    rays: int
    joint_rays: int

    @staticmethod
    def whole(rays: int) -> "BatchPart":
        """All of a batch."""
        return BatchPart(0, rays, rays)

    @staticmethod
    def of_process(joint_rays: int, rank: int, processes: int) -> "BatchPart":
        """A process's even share, the shares lying one after another."""
        first = joint_rays * rank // processes
        return BatchPart(first, joint_rays * (rank + 1) // processes - first, joint_rays)

    def in_pixels(self, rays_a_pixel: int) -> "BatchPart":
        """The same share counted in pixels of so many rays, none of which it cuts."""
        return BatchPart(*(n // rays_a_pixel for n in (self.first, self.rays, self.joint_rays)))

    def in_rays(self, rays_a_pixel: int) -> "BatchPart":
        """A share counted in pixels, in rays."""
        return BatchPart(*(n * rays_a_pixel for n in (self.first, self.rays, self.joint_rays)))

    def of(self, joint: Shaped[Tensor, "joint *each"]) -> Shaped[Tensor, "part *each"]:
        """The part's numbers among those of the joint batch."""
        return joint[self.first : self.first + self.rays]

    def uniform(self, generator: torch.Generator, *each: int) -> Float[Tensor, "part *each"]:
        """The part's share of random numbers in [0, 1), drawn for every ray of the joint batch."""
        return self.of(torch.rand(self.joint_rays, *each, generator=generator))


@dataclass(frozen=True)
class ParameterGradients:
    """Gradient of a batch's weighted mean loss.

    The gradient of several batches' joint weighted mean is the mean of theirs, weighted with ``weight``.

    Attributes:
        values: To every parameter, one after another in the engine's own order.
        weight: Sum of the rays' weights.
        rays: Rays of positive weight.
    """

    values: Float[Tensor, "parameters"]
    weight: float
    rays: int


class SplitStepEngine(RadianceEngine):
    """An engine whose training step also comes in two halves.

    ``apply(gradients(batch)[0], factor)`` does what ``train_step(batch, factor)`` does. Engines of the same
    arguments stay equal, occupancy and random numbers included, as long as each step gives them the same
    ``values`` and batches that are parts of one joint batch.
    """

    @property
    @abstractmethod
    def parameter_count(self) -> int:
        """Length of :attr:`ParameterGradients.values`."""

    @abstractmethod
    def gradients(
        self, batch: RayBatch, part: BatchPart | None = None, out: Float[Tensor, "parameters"] | None = None
    ) -> tuple[ParameterGradients, StepReport]:
        """Gradient of the loss and what a step's report says; parameters and occupancy stay as they are.

        Args:
            batch: Rays.
            part: Which rays of the joint batch they are; all of it if not given.
            out: Where to put ``values``; new memory if not given.
        """

    @abstractmethod
    def apply(self, gradients: ParameterGradients, learning_rate_factor: float) -> None:
        """Move the parameters, and look at the occupancy again when it is time."""

    @abstractmethod
    def parameter_gradient(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        colour_gradient: Float[Tensor, "r 3"],
    ) -> Float[Tensor, "parameters"]:
        """What a gradient to the colours along rays means for every parameter; the field stays as it is.

        Samples lie in the middle of their steps, as in a rendering. The order is that of
        :attr:`ParameterGradients.values`.
        """
