import math

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.mission.blender import read_blender
from mulan.mission.image_sets import read_posed_images

from .image_folder import frame, write_images, write_record


@pytest.fixture
def synthetic(tmp_path):
    write_images(tmp_path, ["train/r_0.png", "train/r_1.png", "test/r_0.png"])
    angle = {"camera_angle_x": 2 * math.atan(0.5)}
    write_record(
        tmp_path / "transforms_train.json", angle | {"frames": [frame("./train/r_0"), frame("./train/r_1")]}
    )
    write_record(tmp_path / "transforms_test.json", angle | {"frames": [frame("./test/r_0")]})
    return tmp_path


@pytest.fixture
def captured(tmp_path):
    names = [f"{i}.png" for i in range(10)]
    write_images(tmp_path, names)
    write_record(tmp_path / "transforms.json", {"fl_x": 7.0, "frames": [frame(name) for name in names]})
    return tmp_path


def test_a_synthetic_scene_has_its_lens_from_the_view_angle(synthetic):
    images = read_blender(synthetic)
    assert (len(images.train), len(images.test)) == (2, 1)
    camera = images.test[0].camera
    assert (camera.width, camera.height, camera.cx, camera.cy) == (8, 6, 4.0, 3.0)
    assert camera.fx == camera.fy == pytest.approx(8.0)
    assert images.train[0].pose_covariance is None


def test_both_formats_are_found_by_folder_or_by_file(synthetic):
    assert len(read_posed_images(synthetic).test) == 1
    assert len(read_posed_images(synthetic / "transforms_train.json").test) == 1


def test_every_nth_frame_is_held_out_where_the_set_names_none(captured):
    images = read_posed_images(captured, hold_out_every=4)
    assert [image.path.name for image in images.test] == ["0.png", "4.png", "8.png"]
    assert len(images.train) == 7
    assert len(read_posed_images(captured / "transforms.json", hold_out_every=None).train) == 10


def test_frames_a_set_holds_out_itself_are_respected(synthetic):
    images = read_posed_images(synthetic, hold_out_every=2)
    assert (len(images.train), len(images.test)) == (2, 1)


def test_a_scene_without_test_file_holds_out_of_its_train_frames(synthetic):
    (synthetic / "transforms_test.json").unlink()
    images = read_posed_images(synthetic, hold_out_every=2)
    assert [image.path.name for image in images.test] == ["r_0.png"]
    assert [image.path.name for image in images.train] == ["r_1.png"]


def test_sets_that_leave_nothing_to_learn_from_are_refused(captured, tmp_path):
    with pytest.raises(InputError, match="hold_out_every"):
        read_posed_images(captured, hold_out_every=1)
    write_record(tmp_path / "transforms.json", {"fl_x": 7.0, "frames": [frame("0.png")]})
    with pytest.raises(InputError, match="none is left to learn from"):
        read_posed_images(tmp_path)


def test_folders_of_neither_kind_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"holds neither transforms_train\.json nor transforms\.json"):
        read_posed_images(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        read_posed_images(tmp_path / "nowhere")


def test_a_synthetic_scene_without_view_angle_is_refused(synthetic):
    write_record(synthetic / "transforms_train.json", {"frames": [frame("./train/r_0")]})
    with pytest.raises(InputError, match="camera_angle_x"):
        read_blender(synthetic)


@pytest.mark.data
def test_the_lego_scene_reads(data):
    images = read_posed_images(data / "nerf_synthetic_lego")
    assert (len(images.train), len(images.test)) == (100, 50)
    assert images.train[0].camera.fx == pytest.approx(555.6, abs=0.1)
    distance = [np.linalg.norm(image.T_world_camera[:3, 3]) for image in images.train]
    np.testing.assert_allclose(distance, 4.03, atol=0.01)
    # every camera looks at the object: the origin projects near the middle of the image
    for image in images.train:
        origin_camera = -image.T_world_camera[:3, :3].T @ image.T_world_camera[:3, 3]
        np.testing.assert_allclose(image.camera.project(origin_camera), [200, 200], atol=2)


@pytest.mark.data
def test_the_fox_photographs_read(data):
    images = read_posed_images(data / "fox")
    assert (len(images.train), len(images.test)) == (43, 7)
    camera = images.train[0].camera
    assert (camera.width, camera.height, camera.fx, camera.k1) == (540, 960, 687.76, 0.0578421)
