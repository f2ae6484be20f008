from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mulan.geometry import se3, so3
from mulan.simulation.speed_profile import SpeedProfile
from mulan.simulation.timeline import ApertureConfig, TourConfig, plan_motions
from mulan.simulation.tour import order_views, view_path


def _random_poses(n: int, seed: int, size_m: float = 3.0):
    rng = np.random.default_rng(seed)
    return se3.from_parts(so3.exp(0.6 * rng.normal(size=(n, 3))), rng.uniform(0.0, size_m, (n, 3)))


def _length(position):
    return np.linalg.norm(np.diff(position, axis=0), axis=1).sum()


@given(st.integers(1, 40), st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_order_visits_every_view_once(n: int, seed: int):
    assert sorted(order_views(_random_poses(n, seed))) == list(range(n))


def test_order_is_nearly_the_shortest_open_path():
    for seed in range(5):
        T = _random_poses(7, seed)
        best = min(_length(T[list(p), :3, 3]) for p in permutations(range(7)))
        assert _length(T[order_views(T), :3, 3]) < 1.15 * best


def test_order_recovers_a_shuffled_line():
    x = np.random.default_rng(0).permutation(30).astype(float)
    T = se3.from_parts(np.tile(np.eye(3), (30, 1, 1)), np.stack([x, 0 * x, 0 * x], -1))
    along = x[order_views(T)]
    assert np.all(np.diff(along) == 1) or np.all(np.diff(along) == -1)


@given(st.floats(0.01, 30.0), st.floats(0.1, 3.0), st.floats(0.1, 3.0))
@settings(max_examples=60, deadline=None)
def test_speed_profile_starts_and_ends_at_rest_within_its_limits(
    distance_m: float, speed: float, acceleration: float
):
    leg = SpeedProfile(distance_m, speed, acceleration)
    t = np.linspace(0.0, leg.duration_s, 2001)
    s = leg.distance_at(t)
    v = np.gradient(s, t)
    assert s[0] == 0
    assert s[-1] == pytest.approx(distance_m)
    assert np.all(np.diff(s) >= -1e-12)
    assert v.max() <= speed * (1 + 1e-3)
    assert max(v[0], v[-1]) <= acceleration * leg.duration_s / 1000
    assert np.allclose(leg.distance_at(leg.time_at(s)), s, atol=1e-9 * max(distance_m, 1.0))


def _motions(rounds: int = 4, robots: int = 3, **options):
    paths = [view_path(_random_poses(9 + r, r)) for r in range(robots)]
    return plan_motions(paths, TourConfig(rounds=rounds, **options))


@pytest.mark.parametrize("rounds", [0, 1, 2, 5, 15])
def test_photographs_are_taken_exactly_at_the_views_in_increasing_time(rounds: int):
    for motion in _motions(rounds):
        assert np.all(np.diff(motion.photo_time_s) > 0)
        assert np.allclose(motion.pose(motion.photo_time_s), motion.path.T_world_body, atol=1e-7)
        assert len(motion.aperture_s) == rounds
        assert motion.photo_time_s[-1] < motion.end_s


def test_one_robot_moves_its_antenna_while_all_others_stand_still():
    motions = _motions()
    for mover in motions:
        for begin_s, end_s in mover.aperture_s:
            t = np.linspace(begin_s, end_s, 101)
            for robot in motions:
                travelled = _length(robot.point(t, np.array([0.0, 0.0, 0.08])))
                assert travelled > 1.5 if robot is mover else travelled < 1e-9


def test_apertures_never_overlap():
    every = np.concatenate([motion.aperture_s for motion in _motions()])
    every = every[np.argsort(every[:, 0])]
    assert np.all(every[1:, 0] > every[:-1, 1])


def test_motion_is_continuous_at_about_the_asked_speed():
    for motion in _motions(rounds=3):
        t = np.arange(0.0, motion.end_s, 0.002)
        position = motion.pose(t)[:, :3, 3]
        step = np.linalg.norm(np.diff(position, axis=0), axis=1)
        assert step.max() < 0.002 * 3.0
        touring = np.all([(t < begin) | (t > end) for begin, end in motion.aperture_s], axis=0)[1:]
        cruising = step[touring & (step > 0.5 * 0.002)]
        assert np.median(cruising) / 0.002 == pytest.approx(1.0, abs=0.15)


def test_sample_clock_is_increasing_and_contains_every_exposure():
    for motion in _motions():
        ticks = motion.sample_times()
        assert np.diff(ticks).min() > 0.001
        assert np.diff(ticks).max() < 0.041
        assert np.all(np.isin(motion.photo_time_s, ticks))


def test_the_aperture_is_three_dimensional_closed_and_of_the_stated_size():
    path = ApertureConfig().displacement(np.linspace(0.0, 1.0, 500))
    assert np.allclose(path[[0, -1]], 0, atol=1e-12)
    assert np.ptp(path, axis=0) == pytest.approx([0.5, 0.5, 0.15], rel=0.01)
    spread = np.linalg.svd(path - path.mean(0), compute_uv=False)
    assert spread[2] > 0.2 * spread[0], "a flat loop could not tell up from down"


def test_a_planar_aperture_stays_level():
    motion = _motions(aperture=ApertureConfig(planar=True))[0]
    t = np.linspace(motion.aperture_s[1, 0], motion.aperture_s[1, 1], 50)
    assert np.ptp(motion.pose(t)[:, 2, 3]) < 1e-12


def test_a_single_view_and_repeated_views_are_fine():
    still = np.repeat(np.eye(4)[None], 3, axis=0)
    motions = plan_motions([view_path(np.eye(4)[None]), view_path(still)], TourConfig(rounds=2))
    assert len(motions[0].photo_time_s) == 1
    assert np.all(np.diff(motions[1].photo_time_s) > 0)
