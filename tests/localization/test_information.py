from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize_from_measurements

from .team import draw_measurements, make_team


def measured_team(seed, count):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, count, n=50, photos=10)
    return robots, *draw_measurements(rng, robots, bearings=6, ranges=20)


def test_a_lone_range_and_one_bearing_do_not_give_the_heading():
    robots, bearings, ranges = measured_team(20, 2)
    seen = [b for b in bearings if b.observer == "alpha"][2]
    at_once = min(ranges, key=lambda r: abs(r.time_s - seen.time_s))
    found = localize_from_measurements(robots, [seen], [at_once], LocalizationConfig())
    (missing,) = found.undetermined
    assert (missing.robot, missing.freedoms) == ("beta", ("heading",))
    assert (
        "heading: is not determined by 0 bearings of its own, 1 bearing to it and 1 range"
        in missing.sentence()
    )
    assert "record a bearing by it" in missing.remedy
    assert set(found.trajectories) == {"alpha"}
    with pytest.raises(InputError, match="heading"):
        found.require_any_placed()


def test_the_freedom_is_the_heading_also_far_from_the_start():
    # seen from a start frame 50 m away, turning about the antenna is mostly a shift
    robots, bearings, ranges = measured_team(21, 2)
    odometry = robots[1].odometry
    shift = np.eye(4)
    shift[:3, 3] = [50.0, 0.0, 0.0]
    far = (
        robots[0],
        replace(robots[1], odometry=replace(odometry, T_odom_body=shift @ odometry.T_odom_body)),
    )
    seen = [b for b in bearings if b.observer == "alpha"][2]
    at_once = min(ranges, key=lambda r: abs(r.time_s - seen.time_s))
    (missing,) = localize_from_measurements(far, [seen], [at_once], LocalizationConfig()).undetermined
    assert missing.freedoms[0] == "heading"


def test_determined_robots_are_solved_beside_an_undetermined_one():
    robots, bearings, ranges = measured_team(22, 3)
    to_gamma = next(b for b in bearings if b.observer == "alpha" and b.peer == "gamma")
    some = [b for b in bearings if "gamma" not in (b.observer, b.peer)]
    others = [r for r in ranges if "gamma" not in (r.observer, r.peer)]
    found = localize_from_measurements(robots, [*some, to_gamma], others, LocalizationConfig())
    assert set(found.trajectories) == {"alpha", "beta"}
    assert [u.robot for u in found.undetermined] == ["gamma"]
    assert {"heading", "position along x"} & set(found.undetermined[0].freedoms)
    assert len(found.bearings) == len(some)
    found.require_any_placed()
    with pytest.raises(InputError, match="gamma"):
        found.require_all_placed()
