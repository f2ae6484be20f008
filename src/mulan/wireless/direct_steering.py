"""Beamformer output at any directions, one exponential a packet and direction; waves plane or spherical."""

from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

_PACKETS_PER_BLOCK = 192
_DIRECTIONS_PER_BLOCK = 256  # with the packets in float32, three times over, inside a 1 MiB L2 cache


def direct_output(
    phase_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n c"],
    direction: Float[NDArray, "d 3"],
    range_rad: float | None = None,
    xp: Any = np,
    device: str = "cpu",
) -> Any:
    """``Σ_k h_kc exp(-j φ_k(u))`` in single precision.

    Args:
        phase_m: Positions times the wavenumber, about the point that directions and range refer to.
        channel: Columns are treated alike.
        direction: Unit vectors u.
        range_rad: Range of the source times the wavenumber, r: φ is then ``r - |r u - p|`` instead of p·u.
        xp: numpy or torch, whose arrays do the work.
        device: Where torch does it.

    Returns:
        Real and imaginary parts, [c, 2, d], of the kind of ``xp``.
    """
    count = channel.shape[1]

    def single(array: NDArray) -> Any:
        return xp.asarray(np.ascontiguousarray(array, np.float32), device=device)

    position, unit = single(phase_m.T), single(direction)
    square = single((phase_m**2).sum(1))
    weight = single(np.concatenate([np.real(channel), np.imag(channel)], 1))
    packets, directions = _PACKETS_PER_BLOCK, _DIRECTIONS_PER_BLOCK
    if device != "cpu":
        packets, directions = len(channel), 1 << 14
    output = xp.zeros((len(direction), 2 * count), dtype=xp.float32, device=device)
    for at in range(0, len(direction), directions):
        rows = slice(at, at + directions)
        for start in range(0, len(channel), packets):
            block = slice(start, start + packets)
            phase = unit[rows] @ position[:, block]
            if range_rad is not None:
                # r - |r u - p| without the difference of two large numbers
                excess = 2 * range_rad * phase - square[block]
                phase = excess / (range_rad + xp.sqrt(range_rad**2 - excess))
            in_phase, quadrature = xp.cos(phase) @ weight[block], xp.sin(phase) @ weight[block]
            output[rows, :count] += in_phase[:, :count] + quadrature[:, count:]
            output[rows, count:] += in_phase[:, count:] - quadrature[:, :count]
    return output.swapaxes(0, 1).reshape(2, count, len(direction)).swapaxes(0, 1)
