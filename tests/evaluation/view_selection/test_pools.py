import numpy as np
import pytest

from mulan.errors import InputError
from mulan.evaluation.view_selection.pools import (
    GRADED_SIGMA_M,
    NOISY_SIGMA_M,
    PoolKind,
    PoolSource,
    displaced,
    half_window,
)
from mulan.geometry import se3
from mulan.mission.posed_images import PosedImageSet
from mulan.reconstruction.captured_image import load_captured

from ...reconstruction.cube_scene import cube_images


def test_a_window_shows_what_the_photograph_shows_there(tmp_path):
    image = load_captured(cube_images(tmp_path, train=1, test=1, side=24).train, 24)[0]
    rng = np.random.default_rng(0)
    corners = set()
    for _ in range(20):
        window = half_window(image, rng)
        assert window.colour.shape == (12, 12, 3)
        left, top = (
            round(a - b)
            for a, b in ((image.camera.cx, window.camera.cx), (image.camera.cy, window.camera.cy))
        )
        corners.add((left, top))
        part = slice(top, top + 12), slice(left, left + 12)
        np.testing.assert_array_equal(window.colour, image.colour[part])
        assert image.alpha is not None
        assert window.alpha is not None
        np.testing.assert_array_equal(window.alpha, image.alpha[part])
        np.testing.assert_allclose(
            window.camera.pixel_directions(), image.camera.pixel_directions()[part], atol=1e-12
        )
    assert len(corners) > 10


def test_believed_poses_are_off_by_as_much_as_they_admit(tmp_path):
    image = load_captured(cube_images(tmp_path, train=1, test=1).train, 24)[0]
    rng = np.random.default_rng(0)
    drawn = [displaced(image, 0.15, rng) for _ in range(400)]
    errors = [se3.log(se3.inverse(believed.T_world_camera) @ image.T_world_camera) for believed in drawn]
    assert np.std(np.array(errors)[:, 3:]) == pytest.approx(0.15, rel=0.06)
    np.testing.assert_allclose(np.array(errors)[:, :3], 0, atol=1e-9)
    covariance = drawn[0].posed.pose_covariance
    assert covariance is not None
    np.testing.assert_allclose(covariance, np.diag([0] * 3 + [0.15**2] * 3))


def test_half_of_a_noisy_pool_is_exact_and_all_of_a_graded_one_is_not(tmp_path):
    images = cube_images(tmp_path, train=12, test=1)
    noisy = [view.sigma_m for view in PoolSource(images, PoolKind.NOISY, 24).pool(3).views]
    assert sorted(noisy) == pytest.approx([0.0] * 6 + [NOISY_SIGMA_M] * 6)
    graded = np.array([view.sigma_m for view in PoolSource(images, PoolKind.GRADED, 24).pool(3).views])
    assert (graded > GRADED_SIGMA_M[0]).all()
    assert (graded < GRADED_SIGMA_M[1]).all()
    assert len(set(graded)) == 12


def test_a_seed_gives_the_same_pool_and_first_views_each_time_and_the_first_views_are_certain(tmp_path):
    source = PoolSource(cube_images(tmp_path, train=12, test=1), PoolKind.NOISY, 24)
    a, b, other = source.pool(1), source.pool(1), source.pool(2)
    for one, two in zip(a.views, b.views, strict=True):
        np.testing.assert_array_equal(one.T_world_camera, two.T_world_camera)
    assert a.first_views(4, 1) == b.first_views(4, 1)
    assert any((x.sigma_m > 0) != (y.sigma_m > 0) for x, y in zip(a.views, other.views, strict=True))
    assert all(a.views[i].sigma_m == 0 for i in a.first_views(4, 1))


def test_a_set_without_test_views_is_refused(tmp_path):
    images = cube_images(tmp_path, train=3, test=1)
    with pytest.raises(InputError, match="test images"):
        PoolSource(PosedImageSet(images.train, (), tmp_path), PoolKind.STANDARD, 24)
