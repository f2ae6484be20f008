import numpy as np
import pytest

from mulan.errors import InputError
from mulan.geometry import se3, so3
from mulan.localization.initialization import InitializationConfig, initial_alignment

from .team import draw_measurements, make_team


def true_T_world_odom(robots):
    start = [r.ground_truth.T_world_body[0] @ se3.inverse(r.odometry.T_odom_body[0]) for r in robots]
    return {r.name: se3.inverse(start[0]) @ T for r, T in zip(robots, start, strict=True)}


def errors(found, robots):
    truth = true_T_world_odom(robots)
    out = []
    for name, T in found.items():
        difference = se3.inverse(truth[name]) @ T
        out.append(
            (np.linalg.norm(difference[:3, 3]), np.degrees(np.linalg.norm(so3.log(difference[:3, :3]))))
        )
    return np.array(out)


@pytest.mark.parametrize("count", [2, 4])
def test_random_start_frames_are_recovered(count):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        robots = make_team(rng, count)
        bearings, ranges = draw_measurements(rng, robots, bearings=5, ranges=60)
        off = errors(initial_alignment(robots, bearings, ranges, InitializationConfig()), robots)
        assert off[:, 0].max() < 0.5
        assert off[:, 1].max() < 5.0


def test_a_fifth_of_outliers_does_no_harm():
    for seed in range(5):
        rng = np.random.default_rng(100 + seed)
        robots = make_team(rng)
        bearings, ranges = draw_measurements(rng, robots, bearings=6, ranges=60, outliers=0.2)
        off = errors(initial_alignment(robots, bearings, ranges, InitializationConfig()), robots)
        assert off[:, 0].max() < 0.6
        assert off[:, 1].max() < 6.0


def test_bearings_alone_and_ranges_alone_suffice_with_motion():
    rng = np.random.default_rng(7)
    robots = make_team(rng)
    bearings, ranges = draw_measurements(rng, robots, bearings=10, ranges=150, sigma_rad=0.01)
    for some_bearings, some_ranges in ((bearings, []), ([], ranges)):
        off = errors(initial_alignment(robots, some_bearings, some_ranges, InitializationConfig()), robots)
        assert off[:, 0].max() < 1.5


def test_tilted_start_frames_need_and_get_six_freedoms():
    rng = np.random.default_rng(8)
    robots = make_team(rng)
    bearings, ranges = draw_measurements(rng, robots, bearings=8, ranges=80)
    off = errors(
        initial_alignment(robots, bearings, ranges, InitializationConfig(), gravity_aligned=False), robots
    )
    assert off[:, 0].max() < 0.6


def test_a_robot_without_measurements_is_named():
    rng = np.random.default_rng(9)
    robots = make_team(rng, 3)
    bearings, ranges = draw_measurements(rng, robots[:2])
    with pytest.raises(InputError, match="gamma") as caught:
        initial_alignment(robots, bearings, ranges, InitializationConfig())
    assert "none" in caught.value.problem


def test_missing_heading_is_said():
    rng = np.random.default_rng(10)
    robots = make_team(rng)
    bearings, _ = draw_measurements(rng, robots, bearings=1, ranges=0)
    one_way = [b for b in bearings if b.observer == "alpha"]
    with pytest.raises(InputError, match="beta") as caught:
        initial_alignment(robots, one_way, [], InitializationConfig())
    assert caught.value.field in {"heading", "position", "height", "position along x", "position along y"}


def test_level_bearings_need_the_common_floor_for_height():
    rng = np.random.default_rng(11)
    robots = make_team(rng, flat=True)
    bearings, ranges = draw_measurements(rng, robots, bearings=8, ranges=80, level=True)
    found = initial_alignment(robots, bearings, ranges, InitializationConfig(), common_floor_sigma_m=0.02)
    assert errors(found, robots)[:, 0].max() < 0.6
    with pytest.raises(InputError, match="height"):
        initial_alignment(robots, bearings, [], InitializationConfig())
