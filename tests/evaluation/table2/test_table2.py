from dataclasses import replace

import numpy as np
import pytest

from mulan.evaluation.table2.colmap import _in_the_world
from mulan.evaluation.table2.protocol import order_of
from mulan.geometry import se3

from ...reconstruction.cube_scene import cube_images


def test_the_papers_order_is_checked_of_the_setups_there_are():
    assert order_of({"A": 32, "ours": 31, "D": 28, "C": 26, "B": 31.5}) == {
        "A >= ours": True,
        "ours >= D": True,
        "D >= C": True,
        "ours >= B": False,
    }
    assert order_of({"A": 32, "E": 10}) == {}


def test_a_map_of_another_scale_and_frame_is_carried_to_the_anchor(tmp_path):
    images = cube_images(tmp_path, train=8, test=1, side=8)
    named = [replace(image, robot_id="ab"[i % 2]) for i, image in enumerate(images.train)]
    images = replace(images, train=tuple(named))
    away, scale = se3.exp(np.array([0.3, -0.2, 1.0, 2.0, 1.0, -3.0])), 0.37
    placed = {}
    for i in (0, 1, 2, 4, 5, 6):
        T = away @ images.train[i].T_world_camera
        T[:3, 3] *= scale
        placed[i] = T
    found = _in_the_world(images, "a", placed, 1, 0.0)
    assert found.images is not None
    assert (found.placed, found.of) == (6, 8)
    for image in found.images.train:
        true = next(each for each in images.train if each.path == image.path)
        assert image.T_world_camera == pytest.approx(true.T_world_camera, abs=1e-9)
    few = _in_the_world(images, "a", {i: placed[i] for i in (0, 1, 5)}, 2, 0.0)
    assert few.images is None
    assert few.why_not is not None
    assert "only 1 photographs of a" in few.why_not
