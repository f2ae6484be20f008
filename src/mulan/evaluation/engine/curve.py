"""Quality against training time: what a curve is, and the figures read off it, the same way for everyone."""

import math
from collections.abc import Sequence

PsnrCurve = Sequence[Sequence[float]]
"""Pairs (seconds on the training clock, mean PSNR over all held-out views [dB]) in order of time."""

ViewCurve = Sequence[tuple[float, Sequence[float]]]
"""Pairs (seconds on the training clock, PSNR of every held-out view [dB]) in order of time."""

THRESHOLD_DB = 28.0  # the quality whose price in seconds is compared


def curve_on_views(curve: ViewCurve, every_nth: int) -> list[tuple[float, float]]:
    """The mean over views 0, n, 2n, ... only; 1 for all."""
    return [(seconds, sum(psnr[::every_nth]) / len(psnr[::every_nth])) for seconds, psnr in curve]


def evaluation_times_s(budget_s: float, points: int, first_s: float) -> tuple[float, ...]:
    """Times of a training at which to score it, equally spaced in log time; the last is the budget itself."""
    if points < 2 or budget_s <= first_s:
        return (budget_s,)
    growth = math.log(budget_s / first_s) / (points - 1)
    return (*(first_s * math.exp(growth * i) for i in range(points - 1)), budget_s)


def seconds_to_psnr(curve: PsnrCurve, threshold_db: float) -> float | None:
    """When a curve first reaches a quality, linear between its points; None if it never does."""
    before: tuple[float, float] | None = None
    for seconds, psnr_db in curve:
        if psnr_db >= threshold_db:
            if before is None:
                return seconds
            share = (threshold_db - before[1]) / (psnr_db - before[1])
            return before[0] + share * (seconds - before[0])
        before = (seconds, psnr_db)
    return None


def fastest_to_psnr(curves: Sequence[PsnrCurve], threshold_db: float) -> float | None:
    """:func:`seconds_to_psnr` of whichever training of a method got there first."""
    times = [seconds_to_psnr(curve, threshold_db) for curve in curves]
    return min((seconds for seconds in times if seconds is not None), default=None)


def best_until_s(curves: Sequence[PsnrCurve], seconds: float) -> float | None:
    """Best score that any training of a method had by then; None before the first."""
    return max((psnr_db for curve in curves for t, psnr_db in curve if t <= seconds), default=None)


def least_lead_db(ours: Sequence[PsnrCurve], theirs: PsnrCurve) -> float | None:
    """By how much we are ahead at the moment of their curve where that is least.

    Moments before our first score are left out; None if that leaves none.
    """
    leads = [best - psnr_db for t, psnr_db in theirs if (best := best_until_s(ours, t)) is not None]
    return min(leads, default=None)
