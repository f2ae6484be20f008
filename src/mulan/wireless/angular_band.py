"""A profile's resolution is set by its aperture: few directions give all others by interpolation.

The beamformer output is a trigonometric polynomial in azimuth and in elevation (taken round the whole
meridian), of a degree little above the aperture's radius times the wavenumber.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray


def sufficient_azimuths(radius_rad: float) -> int:
    """Azimuths, divisible by four, that determine the output of an aperture to 1e-5.

    Bessel functions J_m(r) fall below 1e-5 at m = r + 5 ∛r + 4.
    """
    return 4 * int(np.ceil((radius_rad + 5 * np.cbrt(radius_rad) + 4) / 2))


def _dirichlet(angle_rad: Float[NDArray, "*b"], count: int) -> Float[NDArray, "*b"]:
    """Interpolation kernel of ``count`` (even) samples on a circle."""
    half = (angle_rad + np.pi) % (2 * np.pi) / 2 - np.pi / 2
    at_sample = np.abs(half) < 1e-9
    return np.where(at_sample, 1.0, np.sin(count * half) / (count * np.tan(np.where(at_sample, 1.0, half))))


@lru_cache(maxsize=8)
def _kernels(
    count: int, azimuth_count: int, elevation_count: int
) -> tuple[Float[NDArray, "e m"], Float[NDArray, "n a"]]:
    """Matrices that act on the elevations (near and far half of the meridian) and the azimuths."""
    step = 2 * np.pi / count
    given = -np.pi / 2 + step * np.arange(count // 2 + 1)
    wanted = np.linspace(-np.pi / 2, np.pi / 2, elevation_count)[:, None]
    # the far half of the meridian, past the zenith, holds the directions half a turn away
    meridian = np.concatenate([given, np.pi - given[1:-1]])
    elevations = _dirichlet(wanted - meridian, count)
    azimuths = _dirichlet(
        step * np.arange(count)[:, None] - 2 * np.pi * np.arange(azimuth_count) / azimuth_count, count
    )
    return elevations.astype(np.float32), azimuths.astype(np.float32)


def interpolated(output: Any, azimuth_count: int, elevation_count: int, xp: Any = np) -> Any:
    """Output on a ``direction_grid`` of other size.

    Args:
        output: [*, n / 2 + 1, n] on a grid of one step, of enough azimuths for its aperture.
        azimuth_count: Wanted.
        elevation_count: Wanted.
        xp: numpy or torch, the kind of the array.

    Returns:
        [*, elevation_count, azimuth_count].
    """
    count = output.shape[-1]
    elevations, azimuths = _kernels(count, azimuth_count, elevation_count)
    far = xp.roll(output[..., 1:-1, :], count // 2, -1)
    meridian = xp.concatenate([output, far], -2)
    on_device = [xp.asarray(kernel, device=output.device) for kernel in (elevations, azimuths)]
    return on_device[0] @ meridian @ on_device[1]
