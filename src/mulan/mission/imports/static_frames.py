"""Where one frame sits in another, through a tree of static transforms."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.mission.bag_mounts import Mounts


def T_between(mounts: Mounts, frame: str, other: str) -> Float[NDArray, "4 4"] | None:
    """``T_frame_other`` by way of any frame above both; None if the tree does not connect them."""
    above_frame, above_other = _upwards(mounts, frame), _upwards(mounts, other)
    for name, T_ancestor_frame in above_frame.items():
        if name in above_other:
            return se3.inverse(T_ancestor_frame) @ above_other[name]
    return None


def _upwards(mounts: Mounts, frame: str) -> dict[str, Float[NDArray, "4 4"]]:
    """The frame's pose in itself and in every frame above it; a circle ends where it closes."""
    at = frame.lstrip("/")
    T = np.eye(4)
    found = {at: T}
    while at in mounts.parent:
        at, T_up = mounts.parent[at]
        T = T_up @ T
        if at in found:
            break
        found[at] = T
    return found
