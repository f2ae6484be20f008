"""What photographs say of poses when the scene is unknown too."""

import numpy as np
import pytest

from mulan.reconstruction.refinement.shared_points import SharedPoints, joint_information


def points_seen_by_all(images=4, points=60, seed=0):
    """Cameras without rotation: moving one shows what moving the point the other way would."""
    slope = np.random.default_rng(seed).normal(size=(points, images, 3))
    by_pose = np.concatenate([np.zeros_like(slope), slope], -1)
    seen = np.ones((points, images), dtype=bool)
    return SharedPoints(seen, by_pose, -slope, np.ones(points), np.full(points, 1000.0))


def shifted(information, displacements):
    x = np.concatenate([[np.zeros(3), d] for d in displacements]).reshape(-1)
    return float(x @ information @ x)


def test_photographs_do_not_say_where_all_cameras_and_the_scene_are_together():
    points, sigma = points_seen_by_all(), np.full(4, 0.1)
    free = joint_information(points, sigma, np.arange(4))
    common, apart = np.tile([1.0, 0, 0], (4, 1)), np.eye(4, 3)[[0, 3, 3, 3]]
    assert shifted(free, common) < 1e-3 * shifted(free, apart)
    held = joint_information(points, sigma, np.arange(1, 4))
    assert shifted(held, common[1:]) > 0.1 * shifted(held, np.eye(3))


def test_a_scene_that_follows_the_images_makes_them_say_less_than_one_held_still():
    points, sigma = points_seen_by_all(), np.full(4, 0.1)
    learnt = joint_information(points, sigma, np.arange(4)).reshape(4, 6, 4, 6)
    still = np.einsum("p,pna,pnb->nab", points.weight, points.by_pose, points.by_pose) / 0.1**2
    for i in range(4):
        assert np.linalg.eigvalsh(still[i] - learnt[i, :, i]).min() > -1e-6 * np.trace(still[i])
        assert np.trace(learnt[i, :, i]) < 0.9 * np.trace(still[i])


def test_a_point_that_one_image_sees_says_nothing():
    points = points_seen_by_all(images=1)
    assert joint_information(points, np.full(1, 0.1), np.arange(1)).max() == pytest.approx(0)
