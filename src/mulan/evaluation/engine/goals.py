"""What the engine is meant to reach on two CPU cores, beside what was measured."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from mulan.evaluation.engine.curve import least_lead_db
from mulan.evaluation.engine.throughput import NAIVE, NATIVE, TUNED

PSNR_GOALS_DB = {
    "lego_100": {"5": 29.0, "60": 32.5},
    "lego_200": {"60": 31.5, "180": 32.8},
    "lego_400": {"300": 31.0},
}
RATIO_GOALS = {f"{NATIVE}_over_{TUNED}": 6.0, f"{NATIVE}_over_{NAIVE}": 10.0}
FASTER_THAN_PEERS = {"nerfacto": 100.0}
FASTER_THAN_ANY_PEER = 10.0
RENDER_RAYS_PER_S = 1e6
PEAK_MEMORY_GB = 1.5


@dataclass(frozen=True)
class Goal:
    """One line of the table.

    Attributes:
        name: What is meant to hold.
        unit: Of both figures.
        goal: Bound, None for a figure that is only told.
        measured: None where it was not measured.
        at_most: Whether the bound is an upper one.
        note: A few words on a figure that is itself a bound or could not be had.
    """

    name: str
    unit: str
    goal: float | None
    measured: float | None
    at_most: bool = False
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether it holds; None where that cannot be told."""
        if self.goal is None or self.measured is None:
            return None
        return self.measured <= self.goal if self.at_most else self.measured >= self.goal


def check_goals(metrics: dict[str, Any]) -> list[Goal]:
    """Every goal of the engine with the figure in a (possibly partial) metrics.json."""
    return [*_quality(metrics), *_speed(metrics), *_against_peers(metrics)]


def _quality(metrics: dict[str, Any]) -> Iterator[Goal]:
    for scene, goals in PSNR_GOALS_DB.items():
        measured = metrics.get(scene, {}).get("psnr_db_at_s", {})
        for budget, goal_db in goals.items():
            yield Goal(f"{scene}, {budget} s of training", "dB", goal_db, measured.get(budget))


def _speed(metrics: dict[str, Any]) -> Iterator[Goal]:
    ratios = metrics.get("ratios", {})
    for name, goal in RATIO_GOALS.items():
        yield Goal(f"samples/s, {name.replace('_', ' ')}", "×", goal, ratios.get(name))
    render = metrics.get("lego_100", {}).get("render_rays_per_s")
    yield Goal(
        "rendering lego_100", "M rays/s", RENDER_RAYS_PER_S / 1e6, None if render is None else render / 1e6
    )
    memory = metrics.get("lego_200", {}).get("peak_memory_gb")
    yield Goal("peak memory, lego_200", "GB", PEAK_MEMORY_GB, memory, at_most=True)


def _against_peers(metrics: dict[str, Any]) -> Iterator[Goal]:
    ours_s = metrics.get("lego_100", {}).get("seconds_to_28_db")
    yield Goal("lego_100, time to 28 dB", "s", None, ours_s)
    ratios: dict[str, tuple[float, bool]] = {}
    for name, results in metrics.get("peers", {}).items():
        ratio = _times_faster(results.get("lego_100", {}))
        if ratio is not None:
            ratios[name] = ratio
    foreign = {name: ratio for name, ratio in ratios.items() if name not in (TUNED, NAIVE)}
    best = min(foreign.values(), default=None)
    yield Goal("time to 28 dB, best peer over ours", "×", FASTER_THAN_ANY_PEER, *_bound(best))
    for name in sorted({*ratios, *FASTER_THAN_PEERS}):
        yield Goal(
            f"time to 28 dB, {name} over ours", "×", FASTER_THAN_PEERS.get(name), *_bound(ratios.get(name))
        )
    for name, results in metrics.get("peers", {}).items():
        theirs = results.get("fox_270x480", {})
        if theirs.get("ours_same_views"):
            ours = list(theirs["ours_same_views"]["psnr_curves"].values())
            lead_db = least_lead_db(ours, theirs["psnr_curve"])
            yield Goal(f"fox_270x480, least lead over {name}", "dB", 0.0, lead_db)


def _times_faster(theirs: dict[str, Any]) -> tuple[float, bool] | None:
    """How many times as long they took, and whether they never got there, so that it is a lower bound."""
    ours_s = (theirs.get("ours_same_views") or {}).get("seconds_to_28_db")
    if ours_s is None:
        return None
    reached_s = theirs.get("seconds_to_28_db")
    if reached_s is not None:
        return reached_s / ours_s, False
    return theirs["psnr_curve"][-1][0] / ours_s, True


def _bound(ratio: tuple[float, bool] | None) -> tuple[float | None, bool, str]:
    if ratio is None:
        return None, False, "not run"
    return ratio[0], False, "at least: it never got there" if ratio[1] else ""
