"""What a photograph is expected to tell beside those already sent, judged by where it was taken."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3, so3

_NEAREST = 24  # views a photograph is compared with
_REMEMBERED = 4096


@dataclass(frozen=True)
class NoveltyConfig:
    """How alike two views are."""

    position_scale_m: float = 0.25
    """Views this far apart have little in common."""
    turn_scale_deg: float = 12.0
    """The same for views turned against each other."""
    noise_share: float = 0.1
    """Variance of what one photograph tells of its view, in shares of what is unknown before."""


class ViewNovelty:
    """Expected information gain over what is seen from a pose, under a Gaussian process on poses.

    What a view shows is taken for a unit-variance process whose covariance falls with distance and turn, as
    ``exp(-d²/2)``; a photograph measures it with noise. The gain of one more is the mutual information
    ``½ log(1 + variance left / noise)`` (Krause, Singh and Guestrin 2008, "Near-optimal sensor placements in
    Gaussian processes"). The robot needs neither model nor network for it; the field's own opinion comes from
    the base station as goals.
    """

    def __init__(self, config: NoveltyConfig) -> None:
        self._config = config
        self._sent: deque[Float[NDArray, "4 4"]] = deque(maxlen=_REMEMBERED)

    @property
    def most_nats(self) -> float:
        """Of a photograph of what nothing is known of."""
        return float(0.5 * np.log(1 + 1 / self._config.noise_share))

    def add(self, T_odom_body: Float[NDArray, "4 4"]) -> None:
        """A photograph from here was sent."""
        self._sent.append(T_odom_body)

    def gain_nats(self, T_odom_body: Float[NDArray, "4 4"]) -> float:
        """What one from here would tell."""
        if not self._sent:
            return self.most_nats
        known = np.stack(self._sent)
        alike = self._alike(T_odom_body[None], known)[0]
        nearest = np.argsort(-alike)[:_NEAREST]
        K = self._alike(known[nearest], known[nearest]) + self._config.noise_share * np.eye(len(nearest))
        left = 1 - alike[nearest] @ np.linalg.solve(K, alike[nearest])
        return float(0.5 * np.log(1 + max(left, 0.0) / self._config.noise_share))

    def _alike(self, a: Float[NDArray, "n 4 4"], b: Float[NDArray, "m 4 4"]) -> Float[NDArray, "n m"]:
        T = se3.inverse(a)[:, None] @ b[None]
        moved = np.linalg.norm(T[..., :3, 3], axis=-1) / self._config.position_scale_m
        turned_rad = np.linalg.norm(so3.log(T[..., :3, :3].reshape(-1, 3, 3)), axis=-1).reshape(moved.shape)
        turned = turned_rad / np.deg2rad(self._config.turn_scale_deg)
        return np.exp(-0.5 * (moved**2 + turned**2))
