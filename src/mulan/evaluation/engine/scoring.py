"""Every held-out view's PSNR as a training goes on, off the clock, and how fast views are rendered."""

import time
from statistics import median

from mulan.evaluation.engine.curve import curve_on_views, evaluation_times_s
from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.held_out import Renders, psnr_db

FIRST_SCORE_S = (
    1.0  # or a quarter of the training: before, most of space counts as occupied and renders slowly
)
RATED_VIEWS = 10


def rays_per_s(engine: RadianceEngine, views: ImageTensors) -> float:
    """Median over some views, a whole image a call; making the rays is not counted."""
    rates = []
    for i in range(0, len(views), max(1, len(views) // RATED_VIEWS)):
        rays = views.image_rays(i)
        began = time.perf_counter()
        engine.render(rays.origins, rays.directions).colour.cpu()  # a GPU is done when its result is here
        rates.append(len(rays.origins) / (time.perf_counter() - began))
    return median(rates)


class CurveRecorder:
    """Scores a field whenever its training clock passes the next of the planned moments.

    Attributes:
        view_curve: Seconds and the PSNR of every view at each moment scored so far.
    """

    def __init__(self, views: ImageTensors, budget_s: float, points: int) -> None:
        self._views = views
        times = evaluation_times_s(budget_s, points, min(FIRST_SCORE_S, budget_s / 4))
        self._times = list(times[:-1])  # the end is scored when it has come
        self.view_curve: list[tuple[float, list[float]]] = []

    @property
    def curve(self) -> list[tuple[float, float]]:
        """Seconds and the mean PSNR over all views."""
        return curve_on_views(self.view_curve, 1)

    @property
    def latest(self) -> str:
        """The last score, for a progress display."""
        return f"{self.curve[-1][1]:.2f} dB at {self.curve[-1][0]:.1f} s" if self.view_curve else ""

    def visit(self, field: Renders, seconds: float, sub_pixels: int = 1) -> None:
        """Called after every step with the training clock."""
        if not self._times or seconds < self._times[0]:
            return
        self._times = [later for later in self._times if later > seconds]
        self._score(field, seconds, sub_pixels)

    def finish(self, field: Renders, seconds: float, sub_pixels: int = 1) -> float:
        """Score the end of the training; returns the mean over the views."""
        self._score(field, seconds, sub_pixels)
        return self.curve[-1][1]

    def _score(self, field: Renders, seconds: float, sub_pixels: int) -> None:
        scores = [round(psnr_db(field, self._views, i, sub_pixels), 4) for i in range(len(self._views))]
        self.view_curve.append((round(seconds, 3), scores))
