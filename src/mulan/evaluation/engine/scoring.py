"""Mean PSNR over all held-out views, off the clock, and how fast they were rendered."""

import time
from statistics import median

from mulan.evaluation.engine.curve import evaluation_times_s
from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.held_out import Renders, psnr_db

FIRST_SCORE_S = 0.1  # or a twentieth of the training, if that is less
RATED_VIEWS = 10


def mean_psnr_db(field: Renders, views: ImageTensors) -> float:
    """Mean over the views of each view's PSNR."""
    return sum(psnr_db(field, views, i) for i in range(len(views))) / len(views)


def rays_per_s(engine: RadianceEngine, views: ImageTensors) -> float:
    """Median over some views, a whole image a call; making the rays is not counted."""
    rates = []
    for i in range(0, len(views), max(1, len(views) // RATED_VIEWS)):
        rays = views.image_rays(i)
        began = time.perf_counter()
        engine.render(rays.origins, rays.directions)
        rates.append(len(rays.origins) / (time.perf_counter() - began))
    return median(rates)


class CurveRecorder:
    """Scores a field whenever its training clock passes the next of the planned moments.

    Attributes:
        curve: What was scored so far.
    """

    def __init__(self, views: ImageTensors, budget_s: float, points: int) -> None:
        self._views = views
        times = evaluation_times_s(budget_s, points, min(FIRST_SCORE_S, budget_s / 20))
        self._times = list(times[:-1])  # the end is scored when it has come
        self.curve: list[tuple[float, float]] = []

    @property
    def latest(self) -> str:
        """The last score, for a progress display."""
        return f"{self.curve[-1][1]:.2f} dB at {self.curve[-1][0]:.1f} s" if self.curve else ""

    def visit(self, field: Renders, seconds: float) -> None:
        """Called after every step with the training clock."""
        if not self._times or seconds < self._times[0]:
            return
        while self._times and seconds >= self._times[0]:
            self._times.pop(0)
        self._score(field, seconds)

    def finish(self, field: Renders, seconds: float) -> float:
        """Score the end of the training."""
        self.curve = [point for point in self.curve if point[0] < seconds]
        self._score(field, seconds)
        return self.curve[-1][1]

    def _score(self, field: Renders, seconds: float) -> None:
        self.curve.append((round(seconds, 3), mean_psnr_db(field, self._views)))
