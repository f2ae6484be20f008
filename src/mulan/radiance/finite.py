"""Numbers that are NaN or infinite are refused before they reach a kernel; one would spoil a whole field."""

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.engine import RayBatch


def check_finite(what: str, *arrays: Tensor) -> None:
    """Refuse numbers that are not finite.

    Args:
        what: Name of the arrays in the message.
        arrays: Of any shapes.

    Raises:
        ValueError: One of them holds a NaN or an infinity.
    """
    for array in arrays:
        # a finite sum has finite parts; enormous finite parts may still add up to infinity
        if not torch.isfinite(array.sum()) and not torch.isfinite(array).all():
            raise ValueError(f"{what} must be finite: there is a NaN or an infinity among them")


def check_finite_rays(origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> None:
    """Refuse rays that start or go nowhere.

    Raises:
        ValueError: An origin or a direction is not finite.
    """
    check_finite("rays", origins, directions)


def check_finite_batch(batch: RayBatch) -> None:
    """Refuse a batch that would teach a NaN; colours of ignored rays are not looked at.

    Raises:
        ValueError: A ray, a weight, an opacity, or the colour of a ray with weight is not finite.
    """
    check_finite_rays(batch.origins, batch.directions)
    check_finite("weights", batch.weights)
    if not torch.isfinite(batch.colours.sum()):
        check_finite("colours", batch.colours[batch.weights > 0])
    if batch.opacity is not None:
        check_finite("opacities", batch.opacity)
