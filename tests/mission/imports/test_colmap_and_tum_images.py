from pathlib import Path

import numpy as np
import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.export.image_sets import export_colmap
from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.image_sets import read_posed_images
from mulan.mission.imports.colmap_images import read_colmap_images
from mulan.mission.imports.image_times import image_times
from mulan.mission.imports.tum_images import InterpolationConfig, read_tum_images
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.ros_poses import T_OPTICAL_OPENGL
from mulan.mission.tum import read_tum, write_tum
from mulan.mission.types import PoseTrack

from ..conftest import make_poses
from ..image_folder import write_images

CAMERA = PinholeCamera(8, 6, 7.5, 7.25, 4.0, 3.0, k1=0.1)
CALIBRATION = """
[camera]
width = 8
height = 6
fx = 7.5
fy = 7.25
cx = 3.5
cy = 2.5
distortion = [0.1, 0.0, 0.0, 0.0]
"""


def image_set(folder: Path, count: int = 5) -> PosedImageSet:
    names = [f"{i}.png" for i in range(count)]
    write_images(folder, names)
    poses = make_poses(count, np.random.default_rng(1))
    images = tuple(PosedImage(folder / name, CAMERA, T) for name, T in zip(names, poses, strict=True))
    return PosedImageSet(images, (), folder)


def test_a_set_exported_to_colmap_comes_back_with_its_poses(tmp_path):
    images = image_set(tmp_path / "photos")
    export_colmap(images, tmp_path / "colmap", link=False, points=None)
    assert run_command(["import", str(tmp_path / "colmap"), "--out", str(tmp_path / "back")]) == 0
    found = read_transforms(tmp_path / "back" / "transforms.json")
    for before, after in zip(images.train, found.train, strict=True):
        assert after.camera == before.camera
        assert after.path.read_bytes() == before.path.read_bytes()
        np.testing.assert_allclose(after.T_world_camera, before.T_world_camera, atol=1e-12)


def test_colmap_units_become_metres(tmp_path):
    images = image_set(tmp_path / "photos")
    export_colmap(images, tmp_path / "colmap", link=True, points=None)
    found = read_colmap_images(tmp_path / "colmap", metres_a_unit=2.5)
    for before, after in zip(images.train, found.train, strict=True):
        np.testing.assert_allclose(after.T_world_camera[:3, 3], 2.5 * before.T_world_camera[:3, 3])
        np.testing.assert_allclose(after.T_world_camera[:3, :3], before.T_world_camera[:3, :3], atol=1e-12)


def test_a_missing_photograph_of_a_model_is_named(tmp_path):
    export_colmap(image_set(tmp_path / "photos"), tmp_path / "colmap", link=False, points=None)
    (tmp_path / "colmap" / "images" / "3.png").unlink()
    with pytest.raises(InputError, match=r"3\.png.*--images"):
        read_colmap_images(tmp_path / "colmap")


@pytest.mark.data
def test_fox_goes_to_colmap_and_back(data, tmp_path):
    images = read_posed_images(data / "fox", None)
    export_colmap(images, tmp_path, link=False, points=None)
    found = read_colmap_images(tmp_path)
    by_name = {image.path.name: image for image in images.train}
    assert len(found.train) == len(images.train)
    for image in found.train:
        before = by_name[image.path.name]
        np.testing.assert_allclose(image.T_world_camera, before.T_world_camera, atol=1e-9)
        assert image.camera == before.camera


@pytest.fixture
def straight(tmp_path) -> Path:
    """A body moving along x at one metre a second, from 100 s to 104 s."""
    time_s = np.arange(100.0, 104.01, 0.25)
    T = np.tile(np.eye(4), (len(time_s), 1, 1))
    T[:, 0, 3] = time_s - 100
    write_tum(PoseTrack(time_s, T), tmp_path / "path.tum")
    (tmp_path / "camera.toml").write_text(CALIBRATION)
    return tmp_path


def test_poses_are_interpolated_to_the_photographs(straight):
    write_images(straight / "rgb", ["100.6.png", "102.125.png"])
    arguments = ["import", str(straight / "path.tum"), "--images", str(straight / "rgb")]
    arguments += ["--calibration", str(straight / "camera.toml"), "--out", str(straight / "out")]
    assert run_command(arguments) == 0
    found = read_transforms(straight / "out" / "transforms.json")
    assert [image.timestamp_s for image in found.train] == [100.6, 102.125]
    assert found.train[0].camera == CAMERA  # pixel centres moved from OpenCV's convention to ours
    np.testing.assert_allclose([i.T_world_camera[0, 3] for i in found.train], [0.6, 2.125], atol=1e-9)
    np.testing.assert_allclose(found.train[0].T_world_camera[:3, :3], T_OPTICAL_OPENGL[:3, :3], atol=1e-12)


def test_a_mount_carries_the_camera_on_a_tracked_body(straight):
    write_images(straight / "rgb", ["101.png"])
    T_body_optical = make_poses(1, np.random.default_rng(5))[0]
    rows = ", ".join(str(value) for value in T_body_optical.ravel().tolist())
    (straight / "camera.toml").write_text(CALIBRATION + f"[camera_mount]\nmatrix = [{rows}]\n")
    found = read_tum_images(
        straight / "path.tum", straight / "rgb", straight / "camera.toml", None, InterpolationConfig()
    )
    T_world_body = np.eye(4)
    T_world_body[0, 3] = 1.0
    expected = T_world_body @ T_body_optical @ T_OPTICAL_OPENGL
    np.testing.assert_allclose(found.train[0].T_world_camera, expected, atol=1e-9)


@pytest.mark.parametrize("name", ["99.9.png", "104.5.png"])
def test_poses_are_never_extrapolated(straight, name):
    write_images(straight / "rgb", ["101.png", name])
    paths = straight / "path.tum", straight / "rgb", straight / "camera.toml", None
    with pytest.raises(InputError, match="outside the trajectory"):
        read_tum_images(*paths, InterpolationConfig())
    assert len(read_tum_images(*paths, InterpolationConfig(skip_outside=True)).train) == 1


def test_poses_are_not_interpolated_across_a_long_gap(straight):
    track = read_tum(straight / "path.tum")
    keep = (track.time_s < 101) | (track.time_s > 103)
    write_tum(PoseTrack(track.time_s[keep], track.T_world_body[keep]), straight / "path.tum")
    write_images(straight / "rgb", ["102.png"])
    with pytest.raises(InputError, match="gap"):
        read_tum_images(
            straight / "path.tum", straight / "rgb", straight / "camera.toml", None, InterpolationConfig()
        )


def test_lists_of_times_are_found_beside_the_photographs(tmp_path):
    write_images(tmp_path / "rgb", ["a.png", "b.png"])
    (tmp_path / "rgb.txt").write_text("# color images\n2.5 rgb/b.png\n1.25 rgb/a.png\n")
    assert [(t, p.name) for t, p in image_times(tmp_path / "rgb")] == [(1.25, "a.png"), (2.5, "b.png")]


def test_nanoseconds_of_euroc_are_seconds(tmp_path):
    write_images(tmp_path / "cam0" / "data", ["1403636579763555584.png"])
    ((time_s, _),) = image_times(tmp_path / "cam0" / "data")
    assert abs(time_s - 1403636579.763555584) < 1e-6


def test_names_that_are_no_times_are_refused(tmp_path):
    write_images(tmp_path, ["left.png"])
    with pytest.raises(InputError, match=r"left\.png.*is no time"):
        image_times(tmp_path)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[camera]\nwidth = 8\n", "height"),
        (CALIBRATION + "focal = 3\n", "unknown"),
        (CALIBRATION.replace("7.5", "nan"), "fx"),
        ("[camera\n", "TOML"),
        (CALIBRATION.replace("width = 8", "width = 80"), "8x6 pixels"),
        ("", "is missing"),
        (CALIBRATION + "[camera_mount]\nquaternion_xyzw = [0, 0, 0, 2]\n", "quaternion"),
        (CALIBRATION + f"[camera_mount]\nmatrix = {[2.0] * 16}\n", "no rigid transform"),
    ],
)
def test_unusable_calibrations_are_one_sentence(straight, text, sentence):
    write_images(straight / "rgb", ["101.png"])
    (straight / "camera.toml").write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_tum_images(
            straight / "path.tum", straight / "rgb", straight / "camera.toml", None, InterpolationConfig()
        )


@pytest.mark.data
def test_photographs_along_a_real_trajectory_lie_on_it(data, tmp_path):
    trajectory = data / "tum_fr2_desk" / "groundtruth.txt.gz"
    track = read_tum(trajectory)
    middle = (track.time_s[1000:1040:10] + track.time_s[1001:1041:10]) / 2
    write_images(tmp_path / "rgb", [f"{time_s:.6f}.png" for time_s in middle])
    (tmp_path / "camera.toml").write_text(CALIBRATION)
    found = read_tum_images(
        trajectory, tmp_path / "rgb", tmp_path / "camera.toml", None, InterpolationConfig()
    )
    for k, image in enumerate(found.train):
        before, after = track.T_world_body[1000 + 10 * k], track.T_world_body[1001 + 10 * k]
        step = np.linalg.norm(se3.log(se3.inverse(before) @ after))
        moved = se3.log(se3.inverse(before) @ image.T_world_camera @ T_OPTICAL_OPENGL)
        assert abs(np.linalg.norm(moved) - step / 2) < 0.2 * step + 1e-4


def test_a_folder_that_is_nothing_known_is_told_so(tmp_path):
    with pytest.raises(InputError, match="neither a rosbag2 folder"):
        run_command(["import", str(tmp_path), "--out", str(tmp_path / "out")])
