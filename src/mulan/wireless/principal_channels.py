"""Many alike channels (subcarriers) as few orthogonal ones with the same summed power."""

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray


def principal_channels(
    channel: Complex[NDArray, "n c"],
) -> tuple[Complex[NDArray, "n r"], Float[NDArray, "r"]]:
    """Orthogonal combinations of the columns, strongest first, and the squared norm of each.

    ``Σ_c |a·h_c|²`` is the same for both whatever the steering a. The strongest r alone fall short by at most
    ``|a|²`` times the squared norm of the one after them, because what is left has no stronger direction.
    """
    if channel.shape[1] == 1:
        return channel, np.array([float(np.vdot(channel, channel).real)])
    power, mix = np.linalg.eigh(channel.conj().T @ channel)
    power, mix = np.maximum(power[::-1], 0.0), mix[:, ::-1]
    kept = power > 1e-14 * power[0] if power[0] > 0 else np.arange(len(power)) < 1
    return channel @ mix[:, kept], power[kept]
