"""Poses found before a field that knows the scene."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.linalg import block_diag

from mulan.geometry import se3
from mulan.geometry.alignment import umeyama
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.torch_engine import TorchEngine
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.refinement.blurred_images import blurred
from mulan.reconstruction.refinement.compared_pixels import ComparedPixels
from mulan.reconstruction.refinement.gauss_newton import PoseState, gauss_newton_step
from mulan.reconstruction.refinement.multi_start import MultiStartConfig, correlation, spread_starts
from mulan.reconstruction.refinement.photometric import photometric_cost, photometric_terms
from mulan.reconstruction.refinement.pose_prior import PosePrior
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.trainer import next_rays
from tests.reconstruction.cube_scene import cube_images

native = pytest.mark.skipif(find_native_library()[0] is None, reason="no native library")
SIGMA = np.array([0.03, 0.03, 0.03, 0.08, 0.08, 0.08])


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    return load_captured(cube_images(tmp_path_factory.mktemp("cube"), train=24, test=0, side=40).train, 40)


@pytest.fixture(scope="module")
def field_and_data(captured):
    """A field that learnt slightly blurred photographs at their true poses."""
    if find_native_library()[0] is None:
        pytest.skip("no native library")
    data = ImageTensors(blurred(captured, 1))
    config = FieldConfig(levels=6, log2_table_size=12, finest_resolution=24, harmonics_degree=1)
    engine = NativeEngine(config, MarchConfig(steps=128), choose_space(captured), True, 0)
    random, rays = torch.Generator().manual_seed(0), 512
    for step in range(800):
        report = engine.train_step(data.sample(rays, random), 1 - step / 900)
        rays = next_rays(rays, report.samples, 2**13)
    return engine, data


def perturbed(data, rng, sigma=SIGMA, images=8):
    """The first images away from where they are, with the covariance of how far."""
    true = np.stack([image.T_world_camera for image in data.images[:images]])
    xi = sigma * rng.normal(size=(images, 6))
    covariance = np.broadcast_to(np.diag(sigma**2), (images, 6, 6)).copy()
    prior = PosePrior(true @ se3.exp(xi), np.zeros(images, dtype=int), covariance)
    return PoseState.at_prior(np.arange(images), prior), true


def position_errors_m(state, true):
    return np.linalg.norm(state.T[:, :3, 3] - true[:, :3, 3], axis=1)


def shift_px(data, T, true):
    """How far the cube's corners move in each image; a turn may make up for a displacement."""
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    camera = data.images[0].camera
    pixels = []
    for poses in (T, true):
        to_camera = se3.inverse(poses)
        seen = corners @ np.swapaxes(to_camera[:, :3, :3], 1, 2) + to_camera[:, None, :3, 3]
        pixels.append(camera.project(seen))
    return np.linalg.norm(pixels[0] - pixels[1], axis=-1).mean(1)


def test_gradient_is_the_slope_of_the_cost(field_and_data):
    engine, data = field_and_data
    state, _ = perturbed(data, np.random.default_rng(0), 0.3 * SIGMA, images=4)
    draw = ComparedPixels(data).draw(state.image, 1200, 1.0, torch.Generator().manual_seed(1))
    terms = photometric_terms(engine, data, draw, state.T)
    slopes = []
    for axis in range(6):
        step = np.zeros(6)
        step[axis] = 2e-3
        up, down = (
            photometric_cost(engine, data, draw, state.T @ se3.exp(sign * step), terms.sigma)
            for sign in (1, -1)
        )
        slope = (up - down) / 4e-3
        slopes.append(slope)
    slopes = np.array(slopes).T
    both = np.linalg.norm(slopes, axis=1) * np.linalg.norm(terms.gradient, axis=1)
    assert ((slopes * terms.gradient).sum(1) > 0.9 * both).all()


def test_gauss_newton_finds_the_poses(field_and_data):
    engine, data = field_and_data
    state, true = perturbed(data, np.random.default_rng(1))
    before, random = shift_px(data, state.T, true), torch.Generator().manual_seed(2)
    for _ in range(12):
        gauss_newton_step(engine, ComparedPixels(data), state, 400, 9.0, random)
    after = shift_px(data, state.T, true)
    assert np.median(after) < 0.3 * np.median(before)
    assert np.median(after) < 0.7


def test_a_move_that_costs_more_is_not_made(field_and_data):
    engine, data = field_and_data
    state, true = perturbed(data, np.random.default_rng(2))
    state.T = true.copy()
    for _ in range(5):
        gauss_newton_step(engine, ComparedPixels(data), state, 400, 9.0, torch.Generator().manual_seed(3))
    assert np.median(shift_px(data, state.T, true)) < 0.5


def test_a_sure_prior_holds_the_poses(field_and_data):
    engine, data = field_and_data
    state, _ = perturbed(data, np.random.default_rng(3))
    sure = replace(state.prior, covariance=1e-12 * np.broadcast_to(np.eye(6), (8, 6, 6)))
    state = PoseState.at_prior(state.image, sure)
    gauss_newton_step(engine, ComparedPixels(data), state, 200, 1.0, torch.Generator().manual_seed(4))
    assert np.abs(state.T - sure.T_world_camera).max() < 1e-5


def test_joint_prior_moves_a_robot_as_a_whole(field_and_data):
    """Images that show nothing follow those that do."""
    engine, data = field_and_data
    true = np.stack([image.T_world_camera for image in data.images[:8]])
    G = se3.exp(np.array([0.0, 0.0, 0.06, 0.05, -0.05, 0.03]))
    A = se3.adjoint(se3.inverse(G @ true)).reshape(-1, 6)
    covariance = 0.06**2 * A @ A.T + 1e-6 * np.eye(48)
    state = PoseState.at_prior(np.arange(8), PosePrior(G @ true, np.zeros(8, dtype=int), covariance))
    random = torch.Generator().manual_seed(5)
    for _ in range(10):
        gauss_newton_step(engine, ComparedPixels(data), state, 300, 9.0, random)
    relative = se3.inverse(state.T[:-1]) @ state.T[1:]
    assert np.median(shift_px(data, state.T, true)) < 0.3 * np.median(shift_px(data, G @ true, true))
    assert np.abs(relative - se3.inverse(true[:-1]) @ true[1:]).max() < 0.03


def test_a_free_frame_follows_the_one_image_that_is_known(field_and_data):
    """The field lies where all the others believed it; the known one alone says where it belongs."""
    engine, data = field_and_data
    true = np.stack([image.T_world_camera for image in data.images[:8]])
    G = se3.exp(np.array([0.02, 0.0, 0.05, 0.06, -0.04, 0.03]))
    believed, robot = true.copy(), np.array([0] + [1] * 7)
    believed[0] = G @ true[0]
    # the others' path is known but for where it lies as a whole
    A = se3.adjoint(se3.inverse(true[1:])).reshape(-1, 6)
    covariance = np.asarray(block_diag(1e-8 * np.eye(6), 0.3**2 * A @ A.T + 0.01**2 * np.eye(42)))
    off = {}
    for frame_is_free in (False, True):
        state = PoseState.at_prior(np.arange(8), PosePrior(believed, robot, covariance))
        random = torch.Generator().manual_seed(8)
        compared = ComparedPixels(data)
        for _ in range(8):
            gauss_newton_step(engine, compared, state, 300, 9.0, random, frame_is_free=frame_is_free)
        off[frame_is_free] = np.median(shift_px(data, state.T, G @ true))
        assert np.abs(state.T[0] - believed[0]).max() < 1e-2
    assert off[True] < 0.3 * off[False]


def test_a_free_frame_grows_to_the_size_that_is_known(field_and_data):
    """All photographs fit a field learnt 1 % too small; only what is known of the paths tells its size."""
    engine, data = field_and_data
    true = np.stack([image.T_world_camera for image in data.images])
    grown = true.copy()
    grown[:, :3, 3] *= 1.01
    n = len(true)
    # displaced each by itself, known well on average
    covariance = np.broadcast_to(np.diag([1e-4] * 3 + [0.01**2] * 3), (n, 6, 6)).copy()
    size, compared = {}, ComparedPixels(data)
    for frame_is_free in (False, True):
        state = PoseState.at_prior(np.arange(n), PosePrior(grown, np.zeros(n, dtype=int), covariance))
        state.T = true.copy()
        random = torch.Generator().manual_seed(0)
        for _ in range(12):
            gauss_newton_step(engine, compared, state, 300, 9.0, random, frame_is_free=frame_is_free)
        size[frame_is_free] = umeyama(true[:, :3, 3], state.T[:, :3, 3], with_scale=True)[1]
    assert abs(size[True] - 1.01) < 0.001
    assert abs(size[False] - 1.01) > 0.005
    assert state.frame.metres_per_unit == pytest.approx(1.01, abs=0.003)
    np.testing.assert_allclose(state.frame.to_world(state.frame.to_field(state.T)), state.T, atol=1e-12)


def test_starts_come_nearer_where_the_prior_is_wide(field_and_data):
    engine, data = field_and_data
    wide = np.array([0.05, 0.05, 0.05, 0.4, 0.4, 0.4])
    state, true = perturbed(data, np.random.default_rng(6), wide)
    before = position_errors_m(state, true)
    spread_starts(engine, data, state, MultiStartConfig(image_starts=64), np.random.default_rng(7))
    assert np.median(position_errors_m(state, true)) < 0.8 * np.median(before)


def test_correlation_is_highest_at_the_true_pose(field_and_data):
    engine, data = field_and_data
    state, true = perturbed(data, np.random.default_rng(8), 3 * SIGMA)
    at_truth = correlation(engine, data, state.image, true, 20)
    assert (at_truth > correlation(engine, data, state.image, state.T, 20)).all()
    assert at_truth.min() > 0.95


@native
def test_torch_and_native_agree_on_ray_gradients_with_levels_masked(captured):
    config = FieldConfig(levels=4, log2_table_size=10, finest_resolution=32, harmonics_degree=2)
    data, space = ImageTensors(captured), choose_space(captured)
    engines = [cls(config, MarchConfig(steps=64), space, True, 3) for cls in (TorchEngine, NativeEngine)]
    state = engines[0].state()
    state["table"] = 0.3 * torch.randn(state["table"].shape, generator=torch.Generator().manual_seed(0))
    rays = data.image_rays(0)
    axis = torch.nn.functional.normalize(
        torch.randn(rays.colours.shape, generator=torch.Generator().manual_seed(1)), dim=-1
    )
    answers = []
    for engine in engines:
        engine.load_state(state)
        engine.set_level_weights(torch.tensor([1.0, 1.0, 0.0, 0.0]))
        answers.append(engine.ray_gradients(rays.origins, rays.directions, axis))
    (a, of_a), (b, of_b) = answers
    torch.testing.assert_close(a.colour, b.colour, atol=2e-3, rtol=0)
    for x, y in ((of_a.origins, of_b.origins), (of_a.directions, of_b.directions)):
        assert (x - y).norm() < 2e-2 * x.norm()
