"""Which photographs are sent and how strongly they are compressed, so that they fit a stated rate."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.fleet.token_bucket import TokenBucket
from mulan.geometry import se3, so3
from mulan.mission import pixels


@dataclass(frozen=True)
class ImageConfig:
    """Photographs sent."""

    kilobytes_per_s: float = 0.0
    """Budget over the mission's time; 0 sends every photograph as it was recorded."""
    qualities: tuple[int, ...] = (90, 75, 60, 45)
    """JPEG qualities tried from the best down when a photograph does not fit the budget."""
    burst_s: float = 5.0
    """So many seconds of budget may be spent at once."""
    least_move_m: float = 0.05
    """With a budget: a photograph from nearer than this to the last one sent, ..."""
    least_turn_deg: float = 3.0
    """... and turned by less than this, tells little new and is left out."""


class ImageBudget:
    """Chooses photograph by photograph.

    Attributes:
        sent, recompressed, left_out: How many photographs were.
    """

    def __init__(self, config: ImageConfig) -> None:
        self.sent = 0
        self.recompressed = 0
        self.left_out = 0
        self._config = config
        rate = config.kilobytes_per_s * 1e3
        self._bucket = TokenBucket(rate, rate * config.burst_s)
        self._last_sent: Float[NDArray, "4 4"] | None = None

    def fit(self, data: bytes, time_s: float, T_odom_body: Float[NDArray, "4 4"] | None) -> bytes | None:
        """The photograph to send, or None to leave it out.

        Args:
            data: JPEG or PNG file.
            time_s: When it was taken.
            T_odom_body: Where it was taken, by dead reckoning; None if unknown.

        Raises:
            InputError: The file is neither or is damaged.
        """
        if self._config.kilobytes_per_s == 0:
            self.sent += 1
            return data
        chosen = None if self._tells_little(T_odom_body) else self._compressed(data, time_s)
        if chosen is None:
            self.left_out += 1
            return None
        self.sent += 1
        self.recompressed += chosen is not data
        self._last_sent = T_odom_body
        return chosen

    def _compressed(self, data: bytes, time_s: float) -> bytes | None:
        # a file larger than the whole bucket would otherwise never be sent again once it is full
        if len(data) <= self._bucket.capacity and self._bucket.take(len(data), time_s):
            return data
        rgb = pixels.decode(data, "photograph")
        if rgb.shape[2] == 4:
            return None  # its transparency means something, and JPEG has none
        for quality in self._config.qualities:
            smaller = pixels.encode_jpeg(rgb, quality)
            fits = len(smaller) < len(data) and len(smaller) <= self._bucket.capacity
            if fits and self._bucket.take(len(smaller), time_s):
                return smaller
        return None

    def _tells_little(self, T_odom_body: Float[NDArray, "4 4"] | None) -> bool:
        if T_odom_body is None or self._last_sent is None:
            return False
        T = se3.inverse(self._last_sent) @ T_odom_body
        turn_deg = np.degrees(np.linalg.norm(so3.log(T[:3, :3])))
        moved_m = np.linalg.norm(T[:3, 3])
        return bool(moved_m < self._config.least_move_m and turn_deg < self._config.least_turn_deg)
