"""What a ray's error costs while learning, and what a ray's samples cost by themselves."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

RENDERED_VARIANCE_FLOOR = 1e-4
ENTROPY_RIM = 1e-3  # opacities nearer to 0 or 1 count as decided


class ColourLoss(ABC):
    """Cost of the error of a ray's colour."""

    @property
    def teaches_variance(self) -> bool:
        """Whether the cost depends on the rendered variance, which then shapes the whole field.

        Else the variance head learns by itself, from detached inputs, and changes nothing but itself.
        """
        return False

    @abstractmethod
    def __call__(self, error: Float[Tensor, "r 3"], variance: Float[Tensor, "r"]) -> Float[Tensor, "r"]:
        """Cost of each ray, from its error and the variance of its colour (floor included)."""


@dataclass(frozen=True)
class SquaredLoss(ColourLoss):
    """Mean square of the error."""

    def __call__(self, error: Float[Tensor, "r 3"], variance: Float[Tensor, "r"]) -> Float[Tensor, "r"]:  # noqa: ARG002
        """``mean e²``."""
        return error.square().mean(-1)


@dataclass(frozen=True)
class HuberLoss(ColourLoss):
    """Mean square of small errors, linear in large ones (Huber 1964)."""

    delta: float = 0.1
    """Errors above this count linearly."""

    def __post_init__(self) -> None:
        """Refuse a corner at or below zero.

        Raises:
            ValueError: ``delta`` is not positive.
        """
        if not self.delta > 0:
            raise ValueError(f"Huber's corner must be positive, not {self.delta}")

    def __call__(self, error: Float[Tensor, "r 3"], variance: Float[Tensor, "r"]) -> Float[Tensor, "r"]:  # noqa: ARG002
        """``mean e²`` up to delta, ``mean delta (2 |e| - delta)`` beyond."""
        size = error.abs()
        return torch.where(size <= self.delta, size.square(), self.delta * (2 * size - self.delta)).mean(-1)


@dataclass(frozen=True)
class GaussianLikelihoodLoss(ColourLoss):
    """Negative log-likelihood of the error under the variance the field itself renders.

    What the field cannot explain it may call noise, and then learns less from (Kendall and Gal 2017, eq. 5).
    """

    @property
    def teaches_variance(self) -> bool:
        """True: the trunk is told which errors to expect."""
        return True

    def __call__(self, error: Float[Tensor, "r 3"], variance: Float[Tensor, "r"]) -> Float[Tensor, "r"]:
        """``(mean e² / v + log v) / 2``."""
        return gaussian_likelihood(error.square().mean(-1), variance)


def gaussian_likelihood(
    squared_error: Float[Tensor, "r"], variance: Float[Tensor, "r"]
) -> Float[Tensor, "r"]:
    """Negative log-likelihood of a mean squared error over channels, but for constants, a channel."""
    return 0.5 * (squared_error / variance + variance.log())


def opacity_entropy(opacity: Float[Tensor, "r"]) -> Float[Tensor, "r"]:
    """Entropy [nat] of hitting something: highest for a half-transparent ray, least for 0 and for 1.

    Flat within :data:`ENTROPY_RIM` of both ends, where its slope would be infinite.
    """
    o = opacity.clamp(ENTROPY_RIM, 1 - ENTROPY_RIM)
    return -(o * o.log() + (1 - o) * (1 - o).log())
