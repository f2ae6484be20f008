import json
from importlib import import_module

import numpy as np
import pytest
from PIL import Image

from mulan.mission.image_sets import read_posed_images
from mulan.mission.pixels import load_resized

scene = import_module("scene")


def write_frames(folder, count, mode, lens):
    noise = np.random.default_rng(0)
    frames = []
    for i in range(count):
        pixels = noise.integers(0, 256, (90, 50, len(mode)), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / f"{i}.png")
        pose = np.eye(4)
        pose[:3, 3] = noise.normal(size=3)
        suffix = "" if "camera_angle_x" in lens else ".png"
        frames.append({"file_path": f"{i}{suffix}", "transform_matrix": pose.tolist()})
    return lens | {"frames": frames}


def assert_same(views, images, camera, longest_side):
    assert len(views) == len(images)
    for view, image in zip(views, images, strict=True):
        ours = load_resized(image.path, longest_side)
        alpha = ours[..., 3:] if ours.shape[2] == 4 else np.ones_like(ours[..., :1])
        np.testing.assert_allclose(view.over_white, ours[..., :3] + 1 - alpha, atol=2e-6)
        np.testing.assert_array_equal(view.T_world_camera, image.T_world_camera)
        mine = image.camera.resized(ours.shape[1], ours.shape[0])
        theirs = (camera.fl_x, camera.fl_y, camera.cx, camera.cy, *camera.distortion)
        np.testing.assert_allclose(theirs, (mine.fx, mine.fy, mine.cx, mine.cy, *mine.distortion[:4]))
        assert (camera.width, camera.height) == (mine.width, mine.height)


def test_a_blender_set_reads_as_mulan_reads_it(tmp_path):
    for split in ("train", "test"):
        meta = write_frames(tmp_path, 3, "RGBA", {"camera_angle_x": 0.7})
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps(meta))
    found, ours = scene.read_scene(tmp_path, 32, 8), read_posed_images(tmp_path)
    assert found.is_object
    assert_same(found.train, ours.train, found.camera, 32)
    assert_same(found.test, ours.test, found.camera, 32)


def test_photographs_are_split_and_resized_as_mulan_does(tmp_path):
    lens = {"fl_x": 60.0, "fl_y": 61.0, "cx": 24.0, "cy": 47.0, "w": 50, "h": 90, "k1": 0.05, "p2": 0.001}
    (tmp_path / "transforms.json").write_text(json.dumps(write_frames(tmp_path, 10, "RGB", lens)))
    found, ours = scene.read_scene(tmp_path, 45, 4), read_posed_images(tmp_path, 4)
    assert not found.is_object
    assert_same(found.train, ours.train, found.camera, 45)
    assert_same(found.test, ours.test, found.camera, 45)


def test_an_empty_folder_ends_in_one_sentence(tmp_path):
    with pytest.raises(SystemExit, match="cannot read the image set"):
        scene.read_scene(tmp_path, 32, 8)
