import json
import math
from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission.nerfstudio import read_transforms, write_transforms
from mulan.mission.posed_images import PosedImage, PosedImageSet

from .conftest import make_covariances, make_poses
from .image_folder import frame, write_images, write_record

LENS = PinholeCamera(8, 6, 7.5, 7.25, 3.9, 3.1, k1=0.1, k2=-0.02, p1=1e-3, p2=-1e-3, k3=0.002)


def image_set(folder, cameras) -> PosedImageSet:
    rng = np.random.default_rng(0)
    names = [f"images/r{i}/{i:06d}.jpg" for i in range(len(cameras))]
    write_images(folder, names)
    poses, covariances = make_poses(len(cameras), rng), make_covariances(len(cameras), rng)
    images = [
        PosedImage(folder / name, camera, poses[i], covariances[i] if i else None, f"r{i}", 1.7e9 + i / 3)
        for i, (name, camera) in enumerate(zip(names, cameras, strict=True))
    ]
    images[1] = replace(images[1], robot_id=None, timestamp_s=None)
    return PosedImageSet(tuple(images[:-1]), tuple(images[-1:]), folder / "transforms.json")


def assert_same(found, expected):
    for split in ("train", "test"):
        for after, before in zip(getattr(found, split), getattr(expected, split), strict=True):
            assert after.path.resolve() == before.path.resolve()
            assert after.camera == before.camera
            assert (after.robot_id, after.timestamp_s) == (before.robot_id, before.timestamp_s)
            np.testing.assert_allclose(after.T_world_camera, before.T_world_camera, atol=1e-14)
            if before.pose_covariance is None:
                assert after.pose_covariance is None
            else:
                np.testing.assert_allclose(after.pose_covariance, before.pose_covariance, rtol=1e-12)


def test_an_image_set_comes_back_as_written(tmp_path):
    images = image_set(tmp_path, [LENS] * 4)
    write_transforms(images, images.source)
    assert_same(read_transforms(images.source), images)
    record = json.loads(images.source.read_text())
    assert record["fl_x"] == 7.5
    assert "fl_x" not in record["frames"][0]
    assert "right perturbation" in record["pose_covariance_convention"]
    assert record["test_filenames"] == ["images/r3/000003.jpg"]


def test_a_joint_covariance_comes_back_and_a_lost_one_is_told(tmp_path):
    images = image_set(tmp_path, [LENS] * 4)
    root = np.random.default_rng(1).normal(size=(12, 12))
    images = replace(images, joint_pose_covariance=root @ root.T)
    write_transforms(images, images.source)
    np.testing.assert_array_equal(
        read_transforms(images.source).joint_pose_covariance, images.joint_pose_covariance
    )
    beside = tmp_path / "transforms_joint_covariance.safetensors"
    write_transforms(replace(images, joint_pose_covariance=np.eye(6)), images.source)
    with pytest.raises(InputError, match=r"6 x 6.*12 x 12 belongs"):
        read_transforms(images.source)
    beside.unlink()
    with pytest.raises(InputError, match=r"cannot be read.*copy it along"):
        read_transforms(images.source)


def test_cameras_that_differ_are_written_a_frame(tmp_path):
    images = image_set(tmp_path, [LENS, replace(LENS, fx=9.0), LENS, replace(LENS, k1=0.0)])
    write_transforms(images, images.source)
    assert_same(read_transforms(images.source), images)
    assert "fl_x" not in json.loads(images.source.read_text())


def test_a_set_written_elsewhere_still_finds_its_images(tmp_path):
    images = image_set(tmp_path, [LENS] * 3)
    elsewhere = tmp_path / "runs" / "one" / "transforms.json"
    write_transforms(images, elsewhere)
    assert_same(read_transforms(elsewhere), images)


@pytest.fixture
def record(tmp_path):
    """A minimal valid set of three frames, to be spoiled."""
    names = ["a.png", "b.png", "c.png"]
    write_images(tmp_path, names)
    return {"fl_x": 7.0, "frames": [frame(name) for name in names]}


def test_what_is_left_out_is_taken_from_the_image(tmp_path, record):
    camera = read_transforms(write_record(tmp_path / "transforms.json", record)).train[0].camera
    assert camera == PinholeCamera(8, 6, 7.0, 7.0, 4.0, 3.0)


def test_focal_length_may_come_from_the_view_angle(tmp_path, record):
    del record["fl_x"]
    record |= {"camera_angle_x": 2 * math.atan(0.5), "camera_angle_y": 2 * math.atan(0.25)}
    camera = read_transforms(write_record(tmp_path / "transforms.json", record)).train[0].camera
    assert (camera.fx, camera.fy) == (pytest.approx(8.0), pytest.approx(12.0))


def test_names_without_an_extension_are_png(tmp_path, record):
    record["frames"][0]["file_path"] = "./a"
    images = read_transforms(write_record(tmp_path / "transforms.json", record))
    assert images.train[0].path.name == "a.png"


def test_without_lists_every_frame_is_for_training(tmp_path, record):
    images = read_transforms(write_record(tmp_path / "transforms.json", record))
    assert (len(images.train), len(images.test)) == (3, 0)


def test_frames_in_neither_list_are_left_out(tmp_path, record):
    record |= {"train_filenames": ["a.png"], "test_filenames": ["c.png"], "val_filenames": ["b.png"]}
    images = read_transforms(write_record(tmp_path / "transforms.json", record))
    assert [image.path.name for image in images.train] == ["a.png"]
    assert [image.path.name for image in images.test] == ["c.png"]


def test_with_a_test_list_alone_the_rest_is_for_training(tmp_path, record):
    record["test_filenames"] = ["b.png"]
    images = read_transforms(write_record(tmp_path / "transforms.json", record))
    assert [image.path.name for image in images.train] == ["a.png", "c.png"]


def test_rotations_off_by_rounding_are_made_exact(tmp_path, record):
    matrix = np.round(np.array(record["frames"][0]["transform_matrix"]), 4)
    record["frames"][0]["transform_matrix"] = matrix[:3].tolist()
    R = read_transforms(write_record(tmp_path / "transforms.json", record)).train[0].T_world_camera[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(R, matrix[:3, :3], atol=1e-4)


def scaled(frame):
    frame["transform_matrix"] = (np.array(frame["transform_matrix"]) * [[1.01]]).tolist()


def mirrored(frame):
    frame["transform_matrix"] = (np.array(frame["transform_matrix"]) * [1, 1, -1, 1]).tolist()


def not_finite(frame):
    frame["transform_matrix"][0][3] = math.nan


def ragged(frame):
    frame["transform_matrix"][1] = [1.0]


def words(frame):
    frame["transform_matrix"][1][1] = "one"


FRAME_FAULTS = {
    scaled: "no rigid transform",
    mirrored: "no rigid transform",
    not_finite: "holds NaN",
    ragged: "is not a 4x4 matrix",
    words: "is not a 4x4 matrix",
    lambda frame: frame.pop("transform_matrix"): "is not a 4x4 matrix",
    lambda frame: frame.update(file_path="gone.png"): "gone.png: image: does not exist",
    lambda frame: frame.update(robot_id=3): "robot_id of b.png",
    lambda frame: frame.update(timestamp="noon"): "timestamp",
    lambda frame: frame.update(pose_covariance=[[1.0]]): "pose_covariance of b.png: is not a 6x6",
    lambda frame: frame.update(pose_covariance=(-np.eye(6)).tolist()): "positive semi-definite",
    lambda frame: frame.update(fl_x=math.inf): "fl_x: is inf",
    lambda frame: frame.update(w=640): "are 640x6 but the image has 8x6 pixels",
    lambda frame: frame.update(camera_model="OPENCV_FISHEYE"): "'OPENCV_FISHEYE' is not supported",
    lambda frame: frame.update(k4=0.1): "fisheye or k4",
}


@pytest.mark.parametrize("spoil", FRAME_FAULTS)
def test_a_frame_that_cannot_be_used_is_named(tmp_path, record, spoil):
    spoil(record["frames"][1])
    path = write_record(tmp_path / "transforms.json", record)
    with pytest.raises(InputError) as caught:
        read_transforms(path)
    text = str(caught.value)
    assert FRAME_FAULTS[spoil] in text
    assert "b.png" in text or "gone.png" in text
    assert "\n" not in text


SET_FAULTS = {
    lambda record: record.pop("frames"): "frames: there are none",
    lambda record: record.update(frames=[]): "frames: there are none",
    lambda record: record.update(frames=["a.png"]): "frames[0].file_path: is missing",
    lambda record: record.pop("fl_x"): "no focal length is given",
    lambda record: record.update(fl_x=-7.0): "no focal length is given",
    lambda record: record.update(test_filenames=["z.png"]): "names z.png, which is no frame",
    lambda record: record.update(test_filenames="a.png"): "is not a list of file names",
}


@pytest.mark.parametrize("spoil", SET_FAULTS)
def test_a_set_that_cannot_be_used_is_refused_in_one_sentence(tmp_path, record, spoil):
    spoil(record)
    path = write_record(tmp_path / "transforms.json", record)
    with pytest.raises(InputError) as caught:
        read_transforms(path)
    assert SET_FAULTS[spoil] in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", "\x00", "[" * 100_000], ids=["empty", "cut", "list", "nul", "deep"]
)
def test_files_that_are_no_json_object_are_refused(tmp_path, text):
    path = tmp_path / "transforms.json"
    path.write_text(text)
    with pytest.raises(InputError, match="JSON"):
        read_transforms(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"transforms\.json: file: does not exist"):
        read_transforms(tmp_path / "transforms.json")


def test_a_damaged_image_is_named(tmp_path, record):
    (tmp_path / "b.png").write_bytes(b"\x89PNG\r\n\x1a\nrubbish")
    with pytest.raises(InputError, match=r"b\.png"):
        read_transforms(write_record(tmp_path / "transforms.json", record))
