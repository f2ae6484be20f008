import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mulan.planning.candidates import CandidateConfig, free_candidates, look_at, ring_of_candidates

from .analytic_engine import BallEngine

coordinate = st.floats(-3, 3)


@given(coordinate, coordinate, coordinate)
def test_look_at_is_an_upright_rotation_whose_axis_meets_the_target(x, y, z):
    position, target = np.array([x, y, z]), np.array([0.1, -0.2, 0.3])
    T = look_at(position, target, np.array([1.0, 0.0, 0.0]))
    R = T[:3, :3]
    assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1)
    distance = np.linalg.norm(target - position)
    assert_allclose(position - distance * R[:, 2], target, atol=1e-8)
    assert R[2, 1] >= -1e-9  # the top of the image points up


def test_eight_candidates_stand_half_a_metre_away_all_about_looking_at_the_centre(T_world_camera):
    centre = np.array([0.0, 0.0, 0.1])
    ring = ring_of_candidates(T_world_camera, centre, CandidateConfig())
    step = ring[:, :3, 3] - T_world_camera[:3, 3]
    assert len(ring) == 8
    assert_allclose(np.linalg.norm(step, axis=1), 0.5)
    assert_allclose(step[:, 2], 0, atol=1e-12)
    assert_allclose(step.sum(0), 0, atol=1e-12)
    assert_allclose(step[0], [-0.5, 0, 0], atol=1e-12)  # straight ahead
    to_centre = centre - ring[:, :3, 3]
    assert_allclose(-ring[:, :3, 2], to_centre / np.linalg.norm(to_centre, axis=1, keepdims=True), atol=1e-12)


def test_keeping_the_heading_changes_position_only(T_world_camera):
    ring = ring_of_candidates(T_world_camera, np.zeros(3), CandidateConfig(look_at_centre=False))
    assert_allclose(ring[:, :3, :3], np.broadcast_to(T_world_camera[:3, :3], (8, 3, 3)))


def test_no_candidate_is_inside_matter_or_beyond_it():
    T = look_at(np.array([0.9, 0.0, 0.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    config = CandidateConfig(distance_m=1.6, clearance_m=0.1)
    poses = free_candidates(BallEngine(), T, np.zeros(3), config)
    ahead = T[:3, 3] + [-1.6, 0, 0]  # on the far side, through the ball
    assert 0 < len(poses) < 8
    assert np.linalg.norm(poses[:, :3, 3] - ahead, axis=1).min() > 0.1
    assert np.linalg.norm(poses[:, :3, 3], axis=1).min() > 0.5 + 0.1


def test_a_walled_in_robot_has_no_candidate(T_world_camera):
    poses = free_candidates(BallEngine(radius_m=5.0), T_world_camera, np.zeros(3), CandidateConfig())
    assert poses.shape == (0, 4, 4)
