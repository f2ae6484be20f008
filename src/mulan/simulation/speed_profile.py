"""Rest-to-rest travel with bounded acceleration and a cruising speed (trapezoid of speed over time)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray


@dataclass(frozen=True)
class SpeedProfile:
    """Law of motion over one leg.

    Attributes:
        distance_m: Length of the leg.
        speed_m_per_s: Cruising speed, reached only on long legs.
        acceleration_m_per_s2: Of start and stop.
    """

    distance_m: float
    speed_m_per_s: float
    acceleration_m_per_s2: float

    @property
    def ramp_s(self) -> float:
        """Time to speed up, equal to the time to slow down."""
        reached = min(self.speed_m_per_s, np.sqrt(self.distance_m * self.acceleration_m_per_s2))
        return float(reached / self.acceleration_m_per_s2)

    @property
    def duration_s(self) -> float:
        """Time from rest to rest."""
        if self.distance_m == 0:
            return 0.0
        return self.ramp_s + self.distance_m / (self.ramp_s * self.acceleration_m_per_s2)

    def distance_at(self, time_s: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        """Metres covered, held before the start and after the end."""
        a, ramp, total = self.acceleration_m_per_s2, self.ramp_s, self.duration_s
        t = np.clip(time_s, 0.0, total)
        cruise = a * ramp * (t - ramp / 2)
        slowing = self.distance_m - a * (total - t) ** 2 / 2
        return np.where(t < ramp, a * t**2 / 2, np.where(t > total - ramp, slowing, cruise))

    def time_at(self, distance_m: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        """Inverse of :meth:`distance_at`."""
        a, ramp, total = self.acceleration_m_per_s2, self.ramp_s, self.duration_s
        if total == 0:
            return np.zeros_like(distance_m)
        ramp_m = a * ramp**2 / 2
        left_m = np.maximum(self.distance_m - distance_m, 0.0)
        cruise = distance_m / (a * ramp) + ramp / 2
        rising, falling = np.sqrt(2 * distance_m / a), total - np.sqrt(2 * left_m / a)
        return np.where(distance_m < ramp_m, rising, np.where(left_m < ramp_m, falling, cruise))
