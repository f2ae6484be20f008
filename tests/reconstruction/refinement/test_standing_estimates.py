"""Estimates that registration cannot tell from its own poses."""

import numpy as np
import pytest

from mulan.geometry import se3
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.refinement.anchored import anchored_space
from mulan.reconstruction.refinement.gauss_newton import PoseState
from mulan.reconstruction.refinement.pose_prior import PosePrior
from mulan.reconstruction.refinement.standing_estimates import known_as_registered, let_estimates_stand
from tests.reconstruction.cube_scene import cube_images

N = 10
COVARIANCE = np.broadcast_to(0.2**2 * np.eye(6), (N, 6, 6)).copy()


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    return load_captured(cube_images(tmp_path_factory.mktemp("cube"), train=N, test=0, side=40).train, 40)


def registered(images, sigma, covariance=COVARIANCE):
    """Two robots, of which registration moved the second one's images by so much."""
    T = np.stack([image.T_world_camera for image in images])
    state = PoseState.at_prior(np.arange(N), PosePrior(T, np.arange(N) % 2, covariance))
    xi = sigma * np.random.default_rng(0).normal(size=(N, 6))
    xi[::2] = np.repeat([0.1, 0.3], 3)
    state.T = T @ se3.exp(xi)
    return state


def test_only_a_robot_that_was_hardly_moved_is_put_back(images):
    state = registered(images, 0.003)
    moved = state.T.copy()
    let_estimates_stand(images, state, anchored_space(images))
    np.testing.assert_array_equal(state.T[1::2], state.prior.T_world_camera[1::2])
    np.testing.assert_array_equal(state.T[::2], moved[::2])


def test_a_correction_by_pixels_is_kept_whatever_its_robot_believed(images):
    state = registered(images, 0.1)
    moved = state.T.copy()
    let_estimates_stand(images, state, anchored_space(images))
    np.testing.assert_array_equal(state.T, moved)


def test_what_stands_counts_as_known_as_well_as_registration_tells(images):
    space = anchored_space(images)
    state = registered(images, 0.003)
    let_estimates_stand(images, state, space)
    told = known_as_registered(images, state, space)
    before, after = (np.einsum("naa->na", s.prior.covariance) for s in (state, told))
    assert (after[1::2] < 0.1 * before[1::2]).all()
    np.testing.assert_array_equal(after[::2], before[::2])
    np.testing.assert_array_equal(told.T, state.T)


def test_a_joint_prior_is_left_as_it_is(images):
    state = registered(images, 0.003, 0.2**2 * np.eye(6 * N))
    let_estimates_stand(images, state, anchored_space(images))
    assert known_as_registered(images, state, anchored_space(images)) is state
