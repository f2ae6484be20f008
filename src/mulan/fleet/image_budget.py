"""Which photographs are sent and how strongly they are compressed, so that they fit a stated rate."""

from dataclasses import dataclass, field

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.fleet.token_bucket import TokenBucket
from mulan.fleet.view_novelty import NoveltyConfig, ViewNovelty
from mulan.mission import pixels

_MOST_ASKED = 0.95  # of what a photograph can tell: from an empty purse nothing more can be asked for


@dataclass(frozen=True)
class ImageConfig:
    """Photographs sent."""

    kilobytes_per_s: float = 0.0
    """Budget over the mission's time; 0 sends every photograph as it was recorded."""
    qualities: tuple[int, ...] = (90, 75, 60, 45)
    """JPEG qualities tried from the best down when a photograph does not fit the budget."""
    burst_s: float = 5.0
    """So many seconds of budget may be spent at once."""
    novelty: NoveltyConfig = field(default_factory=NoveltyConfig)
    """With a budget: what a photograph is expected to tell beside those already sent."""
    least_gain_nats: float = 0.5
    """With a budget: one expected to tell less is left out; the emptier the purse, the more it must tell."""


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
        self._novelty = ViewNovelty(config.novelty)

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
        worth_it = T_odom_body is None or self._novelty.gain_nats(T_odom_body) >= self._needed_nats(time_s)
        chosen = self._compressed(data, time_s) if worth_it else None
        if chosen is None:
            self.left_out += 1
            return None
        self.sent += 1
        self.recompressed += chosen is not data
        if T_odom_body is not None:
            self._novelty.add(T_odom_body)
        return chosen

    def _needed_nats(self, time_s: float) -> float:
        """From the least that is worth sending, with a full purse, to nearly all a photograph can tell."""
        filled = self._bucket.available(time_s) / self._bucket.capacity
        least = min(self._config.least_gain_nats, self._novelty.most_nats)
        return least + (_MOST_ASKED * self._novelty.most_nats - least) * max(0.0, 1 - filled)

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
