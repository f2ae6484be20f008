"""Real spherical harmonics of a viewing direction, bands 0 to 3."""

import torch
from jaxtyping import Float
from torch import Tensor


def spherical_harmonics(directions: Float[Tensor, "n 3"], degree: int) -> Float[Tensor, "n coefficients"]:
    """The first ``degree`` bands (degree² numbers) at unit directions.

    Order and signs are those of instant-ngp (Sloan, "Efficient Spherical Harmonic Evaluation", 2013):
    within band l the order m runs from -l to l.

    Raises:
        ValueError: The degree is not 1, 2, 3 or 4.
    """
    if degree not in (1, 2, 3, 4):
        raise ValueError(f"degree must be 1, 2, 3 or 4, not {degree}")
    x, y, z = directions.unbind(-1)
    bands = [torch.full_like(x, 0.28209479177387814)]
    if degree > 1:
        bands += [-0.48860251190291987 * y, 0.48860251190291987 * z, -0.48860251190291987 * x]
    if degree > 2:
        bands += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.94617469575756 * z * z - 0.31539156525252,
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    if degree > 3:
        bands += [
            0.5900435899266435 * y * (-3 * x * x + y * y),
            2.890611442640554 * x * y * z,
            0.4570457994644657 * y * (1 - 5 * z * z),
            0.3731763325901154 * z * (5 * z * z - 3),
            0.4570457994644657 * x * (1 - 5 * z * z),
            1.445305721320277 * z * (x * x - y * y),
            0.5900435899266435 * x * (-x * x + 3 * y * y),
        ]
    return torch.stack(bands, -1)
