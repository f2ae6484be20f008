"""Best-fit rigid and similarity transforms between two point sets."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3


def umeyama(
    source: Float[NDArray, "n 3"], target: Float[NDArray, "n 3"], with_scale: bool = False
) -> tuple[Float[NDArray, "4 4"], float]:
    """Least-squares ``target ≈ s R source + t`` (Umeyama, PAMI 1991).

    Returns:
        The rigid part ``T`` (rotation R, translation t) and the scale ``s`` (1.0 unless asked for).
    """
    mean_source, mean_target = source.mean(0), target.mean(0)
    cross = (target - mean_target).T @ (source - mean_source) / len(source)
    U, singular, Vt = np.linalg.svd(cross)
    sign = np.ones(3)
    sign[2] = np.sign(np.linalg.det(U) * np.linalg.det(Vt)) or 1.0
    R = U @ np.diag(sign) @ Vt
    variance = float(((source - mean_source) ** 2).sum(1).mean())
    scale = float((singular * sign).sum()) / variance if with_scale and variance > 0 else 1.0
    return se3.from_parts(R, mean_target - scale * R @ mean_source), scale


def point_nearest_to_axes(
    origins: Float[NDArray, "n 3"], directions: Float[NDArray, "n 3"]
) -> Float[NDArray, "3"]:
    """The point with the least summed squared distance to a bundle of lines (unit directions).

    Lines that are nearly parallel leave it undetermined; a weak pull to the mean origin settles it.
    """
    P = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    A = P.sum(0) + 1e-6 * len(origins) * np.eye(3)
    b = (P @ origins[:, :, None]).sum(0)[:, 0] + 1e-6 * origins.sum(0)
    return np.linalg.solve(A, b)
