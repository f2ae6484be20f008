"""A short open path past every view, and the smooth curve a robot flies along it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from mulan.geometry import se3, so3

_LEAST_LEG_M = 0.05  # keeps photographs at one spot apart in time


def order_views(T_world_camera: Float[NDArray, "n 4 4"]) -> Int[NDArray, "n"]:
    """Order of visit: nearest neighbour from the most remote view, then 2-opt (Croes 1958), ends open."""
    position = T_world_camera[:, :3, 3]
    n = len(position)
    distance = np.linalg.norm(position[:, None] - position[None], axis=-1)
    order = [int(np.argmax(np.linalg.norm(position - position.mean(0), axis=1)))]
    left = np.ones(n, dtype=bool)
    left[order[0]] = False
    while left.any():
        order.append(int(np.argmin(np.where(left, distance[order[-1]], np.inf))))
        left[order[-1]] = False
    return _two_opt(np.array(order), distance)


def _two_opt(order: Int[NDArray, "n"], distance: Float[NDArray, "n n"]) -> Int[NDArray, "n"]:
    """Reverse stretches while that shortens the path; a phantom point at distance 0 closes the open ends."""
    n = len(order)
    D = np.zeros((n + 1, n + 1))
    D[:n, :n] = distance
    tour = np.concatenate([[n], order])
    improved = True
    while improved:
        improved = False
        for i in range(n):
            following = np.roll(tour, -1)
            j = np.arange(i + 1, n + 1)
            old = D[tour[i], following[i]] + D[tour[j], following[j]]
            gain = old - D[tour[i], tour[j]] - D[following[i], following[j]]
            best = int(np.argmax(gain))
            if gain[best] > 1e-12:
                tour[i + 1 : j[best] + 1] = tour[i + 1 : j[best] + 1][::-1].copy()
                improved = True
    start = int(np.flatnonzero(tour == n)[0])
    return np.roll(tour, -start)[1:]


@dataclass(frozen=True)
class ViewPath:
    """A smooth curve through body poses.

    Attributes:
        T_world_body: Poses it passes exactly, in order of visit.
        knot_m: Place of each on the curve: metres travelled, or the metres a turn is worth where the robot
            turns more than it moves.
    """

    T_world_body: Float[NDArray, "n 4 4"]
    knot_m: Float[NDArray, "n"]

    def pose(self, along_m: Float[NDArray, "q"]) -> Float[NDArray, "q 4 4"]:
        """Body poses on the curve: cubic spline of position, spherical interpolation of rotation."""
        T = se3.interpolate(self.knot_m, self.T_world_body, along_m)
        if len(self.knot_m) > 1:
            spline = CubicSpline(self.knot_m, self.T_world_body[:, :3, 3], bc_type="natural")
            T[:, :3, 3] = spline(np.clip(along_m, self.knot_m[0], self.knot_m[-1]))
        return T


def view_path(T_world_body: Float[NDArray, "n 4 4"], metres_per_radian: float = 1.0) -> ViewPath:
    """The curve through poses in the given order.

    Args:
        T_world_body: Poses to pass.
        metres_per_radian: Travel that takes as long as a turn of one radian.
    """
    chord_m = np.linalg.norm(np.diff(T_world_body[:, :3, 3], axis=0), axis=1)
    R = T_world_body[:, :3, :3]
    turn_rad = np.linalg.norm(so3.log(np.swapaxes(R[:-1], 1, 2) @ R[1:]), axis=1)
    leg_m = np.maximum(np.maximum(chord_m, turn_rad * metres_per_radian), _LEAST_LEG_M)
    return ViewPath(T_world_body, np.concatenate([[0.0], np.cumsum(leg_m)]))
