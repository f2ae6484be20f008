from dataclasses import replace

import numpy as np
import pytest

from mulan.geometry import se3, so3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.lies import Lie
from mulan.localization.localize import localize_from_measurements

from .team import draw_measurements, make_team

TURN_DEG = 30.0
BIAS_M = 1.0


def measured_team(seed, count, bearings=5, ranges=10):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, count, n=25, photos=5)
    found, heard = draw_measurements(rng, robots, bearings=bearings, ranges=ranges)
    return robots, found, heard


def turned(bearing, deg=TURN_DEG):
    R = so3.about_z(np.array(np.deg2rad(deg)))
    return replace(bearing, direction_odom=bearing.direction_odom @ R.T)


def with_turned_bearings(bearings, liar):
    return [turned(b) if b.observer == liar else b for b in bearings]


def with_long_ranges(ranges, liar):
    return [replace(r, range_m=r.range_m + BIAS_M) if liar in (r.observer, r.peer) else r for r in ranges]


def sigmas_moved(honest, other, but=()):
    """Largest shift of any pose of the robots beside the anchor, in the sigmas it is stated with."""
    worst = 0.0
    for name, before in honest.trajectories.items():
        if name in (honest.anchor, *but):
            continue
        after = other.trajectories[name]
        xi = se3.log(se3.inverse(before.T_world_body) @ after.T_world_body)
        sigma = np.sqrt(np.einsum("nii->ni", after.covariance))
        worst = max(worst, float((np.abs(xi) / sigma).max()))
    return worst


@pytest.mark.parametrize(("count", "liar"), [(3, "beta"), (3, "alpha"), (4, "delta")])
def test_a_robot_with_turned_bearings_is_named_and_moves_nobody(count, liar):
    robots, bearings, ranges = measured_team(count, count)
    honest = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
    lied_to = localize_from_measurements(
        robots, with_turned_bearings(bearings, liar), ranges, LocalizationConfig()
    )
    assert honest.suspects == ()
    (suspect,) = lied_to.suspects
    assert (suspect.robot, suspect.lie, suspect.alternatives) == (liar, Lie.BEARINGS_TURNED, ())
    assert suspect.amount is not None
    assert np.degrees(suspect.amount) == pytest.approx(TURN_DEG, abs=4)
    assert suspect.measurements == sum(b.observer == liar for b in bearings)
    assert sigmas_moved(honest, lied_to, but=(liar,)) < 2
    from_liar = np.array([b.observer == liar for b in lied_to.bearings])
    assert lied_to.bearing_inlier[from_liar].max() == 0
    assert lied_to.bearing_inlier[~from_liar].mean() > 0.9


def test_a_robot_with_long_ranges_is_named_and_moves_nobody():
    robots, bearings, ranges = measured_team(11, 3)
    honest = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
    lied_to = localize_from_measurements(
        robots, bearings, with_long_ranges(ranges, "gamma"), LocalizationConfig()
    )
    (suspect,) = lied_to.suspects
    assert (suspect.robot, suspect.lie, suspect.alternatives) == ("gamma", Lie.RANGES_BIASED, ())
    assert suspect.amount == pytest.approx(BIAS_M, abs=0.1)
    assert sigmas_moved(honest, lied_to, but=("gamma",)) < 2


def test_of_two_robots_with_long_ranges_either_may_be_the_one():
    rng = np.random.default_rng(12)
    robots = make_team(rng, 2, n=40, photos=10)
    sharp, ranges = draw_measurements(rng, robots, bearings=12, ranges=20, sigma_rad=0.01)
    lied_to = localize_from_measurements(
        robots, sharp, with_long_ranges(ranges, "beta"), LocalizationConfig()
    )
    (suspect,) = lied_to.suspects
    assert {suspect.robot, *suspect.alternatives} == {"alpha", "beta"}


def test_a_robot_whose_bearings_point_anywhere_is_named():
    rng = np.random.default_rng(13)
    robots, bearings, ranges = measured_team(13, 3)

    def anywhere(bearing):
        u = rng.normal(size=3)
        return replace(bearing, direction_odom=(u / np.linalg.norm(u))[None])

    wrong = [anywhere(b) if b.observer == "beta" else b for b in bearings]
    (suspect,) = localize_from_measurements(robots, wrong, ranges, LocalizationConfig()).suspects
    assert (suspect.robot, suspect.lie, suspect.amount) == ("beta", Lie.BEARINGS_WRONG, None)


def test_silent_robots_are_placed_by_the_others_and_move_nobody():
    robots, bearings, ranges = measured_team(14, 3)
    honest = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
    without = [b for b in bearings if b.observer != "gamma"]
    quiet = localize_from_measurements(robots, without, ranges, LocalizationConfig())
    assert quiet.suspects == ()
    assert set(quiet.trajectories) == {"alpha", "beta", "gamma"}
    assert sigmas_moved(honest, quiet, but=("gamma",)) < 2


def test_missing_robots_are_listed_and_move_nobody():
    robots, bearings, ranges = measured_team(15, 3)
    honest = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
    alone = localize_from_measurements(
        robots,
        [b for b in bearings if "gamma" not in (b.observer, b.peer)],
        [r for r in ranges if "gamma" not in (r.observer, r.peer)],
        LocalizationConfig(),
    )
    (missing,) = alone.undetermined
    assert (missing.robot, missing.freedoms) == ("gamma", ("bearings and ranges",))
    assert set(alone.trajectories) == {"alpha", "beta"}
    assert sigmas_moved(honest, alone, but=("gamma",)) < 2


def test_random_outliers_make_nobody_a_liar():
    rng = np.random.default_rng(16)
    robots = make_team(rng, 3, n=50, photos=25)
    bearings, ranges = draw_measurements(rng, robots, bearings=8, ranges=20, outliers=0.2)
    assert localize_from_measurements(robots, bearings, ranges, LocalizationConfig()).suspects == ()
