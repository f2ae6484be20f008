import struct
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission.colmap.camera_models import BY_ID, to_camera
from mulan.mission.colmap.model import ColmapImage, ColmapModel
from mulan.mission.colmap.read_model import find_model, read_model
from mulan.mission.colmap.write_model import camera_from_world, write_model
from mulan.mission.coloured_points import ColouredPoints

from ..conftest import make_poses

CAMERAS = {
    1: PinholeCamera(640, 480, 500.25, 501.5, 320.5, 239.25),
    2: PinholeCamera(752, 480, 458.6, 457.3, 367.7, 248.9, k1=-0.28, k2=0.07, p1=1e-4, p2=2e-5),
    5: PinholeCamera(32, 24, 30.5, 31.25, 15.75, 12.5, k1=-0.21, k2=0.03, p1=1e-3, p2=-2e-3, k3=0.004),
}


@pytest.fixture
def model() -> ColmapModel:
    poses = make_poses(6, np.random.default_rng(3))
    ids = [1, 2, 5, 5, 2, 1]
    return ColmapModel(CAMERAS, tuple(ColmapImage(f"alpha_{i}.jpg", ids[i], T) for i, T in enumerate(poses)))


@pytest.fixture
def points() -> ColouredPoints:
    rng = np.random.default_rng(4)
    return ColouredPoints(rng.normal(size=(40, 3)), rng.integers(0, 256, (40, 3), np.uint8), np.zeros(40))


def same(model: ColmapModel, found: ColmapModel) -> None:
    assert found.cameras == model.cameras
    assert [(i.name, i.camera_id) for i in found.images] == [(i.name, i.camera_id) for i in model.images]
    for before, after in zip(model.images, found.images, strict=True):
        np.testing.assert_allclose(after.T_world_camera, before.T_world_camera, atol=1e-12)


@pytest.mark.parametrize("as_text", [False, True])
def test_a_model_comes_back(model, points, tmp_path, as_text):
    write_model(model, points, tmp_path, as_text)
    same(model, read_model(tmp_path))


def test_rewriting_as_text_leaves_no_binary_model_to_be_read_instead(model, tmp_path):
    write_model(model, None, tmp_path)
    write_model(model, None, tmp_path, as_text=True)
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".txt"] * 3


@pytest.mark.parametrize("as_text", [False, True])
def test_pycolmap_reads_what_we_write(model, points, tmp_path, as_text):
    pycolmap = pytest.importorskip("pycolmap")
    write_model(model, points, tmp_path, as_text)
    found = pycolmap.Reconstruction(str(tmp_path))
    assert found.num_images() == 6
    assert found.num_points3D() == 40
    by_name = {image.name: image for image in found.images.values()}
    for image in model.images:
        theirs, ours = by_name[image.name], CAMERAS[image.camera_id]
        pose: Any = theirs.cam_from_world  # a property before pycolmap 3.12
        pose = pose() if callable(pose) else pose
        matrix = cast(Any, pose).matrix()
        point_world = image.T_world_camera[:3] @ [0.2, -0.1, -3.0, 1.0]
        # what is seen where: theirs on optical axes, ours on OpenGL axes
        seen = theirs.camera.img_from_cam((matrix @ [*point_world, 1.0]).reshape(1, 3))
        np.testing.assert_allclose(
            np.ravel(seen), ours.project(np.array([0.2, -0.1, -3.0])), atol=1e-6, rtol=1e-9
        )
    position_m = np.array([found.points3D[key].xyz for key in sorted(found.points3D)])
    np.testing.assert_allclose(position_m, points.position_m)


@pytest.mark.parametrize("as_text", [False, True])
def test_we_read_what_pycolmap_writes(model, points, tmp_path, as_text):
    pycolmap = pytest.importorskip("pycolmap")
    write_model(model, points, tmp_path / "ours")
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    found = pycolmap.Reconstruction(str(tmp_path / "ours"))
    (found.write_text if as_text else found.write)(str(theirs))
    again = read_model(theirs)
    same(model, ColmapModel(again.cameras, tuple(sorted(again.images, key=lambda image: image.name))))


def test_a_model_is_found_where_colmap_puts_it(model, tmp_path):
    assert find_model(tmp_path) is None
    write_model(model, None, tmp_path / "sparse" / "0")
    assert find_model(tmp_path) == tmp_path / "sparse" / "0"


def test_single_focal_lengths_count_for_both_axes():
    camera = to_camera(BY_ID[3], 100, 80, (90.0, 50.0, 40.0, 0.1, -0.02))
    assert (camera.fx, camera.fy, camera.k1, camera.k2) == (90.0, 90.0, 0.1, -0.02)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_a_file_cut_anywhere_is_one_sentence(model, tmp_path, name):
    write_model(model, None, tmp_path)
    whole = (tmp_path / name).read_bytes()
    for length in range(0, len(whole) - 1, 7):
        (tmp_path / name).write_bytes(whole[:length])
        with pytest.raises(InputError, match=name):
            read_model(tmp_path)


def test_random_damage_never_escapes_as_anything_but_one_sentence(model, tmp_path):
    write_model(model, None, tmp_path)
    rng = np.random.default_rng(0)
    whole = {name: (tmp_path / name).read_bytes() for name in ("cameras.bin", "images.bin")}
    for _ in range(80):
        for name, data in whole.items():
            spoiled = bytearray(data)
            for _ in range(rng.integers(1, 6)):
                spoiled[rng.integers(len(spoiled))] = rng.integers(256)
            (tmp_path / name).write_bytes(bytes(spoiled))
        try:
            found = read_model(tmp_path)
        except InputError:
            continue
        assert all(np.isfinite(image.T_world_camera).all() for image in found.images)


def set_count(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(struct.pack("<Q", 2**60) + data[8:])


def test_a_count_beyond_the_file_is_refused_before_memory_is_taken(model, tmp_path):
    write_model(model, None, tmp_path)
    set_count(tmp_path / "images.bin")
    with pytest.raises(InputError, match="more than the file holds"):
        read_model(tmp_path)


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd"])
def test_names_that_leave_the_image_folder_are_refused(model, tmp_path, name):
    write_model(ColmapModel(CAMERAS, (ColmapImage(name, 1, np.eye(4)),)), None, tmp_path)
    with pytest.raises(InputError, match="leads out of the image folder"):
        read_model(tmp_path)


def test_fisheye_lenses_are_told_to_be_undistorted(model, tmp_path):
    write_model(model, None, tmp_path, as_text=True)
    (tmp_path / "cameras.txt").write_text("1 OPENCV_FISHEYE 640 480 500 500 320 240 0.1 0 0 0\n")
    with pytest.raises(InputError, match=r"OPENCV_FISHEYE is not supported.*image_undistorter"):
        read_model(tmp_path)


def test_the_written_pose_is_the_inverse_on_optical_axes():
    # a camera one metre up that looks along world +x
    T = np.array([[0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 1.0], [0, 0, 0, 1]], float)
    w, x, y, z, *t = camera_from_world(ColmapImage("a", 1, T))
    np.testing.assert_allclose(t, [0, 1, 0], atol=1e-12)  # the world's origin is one metre below: y down
    assert abs(w * w + x * x + y * y + z * z - 1) < 1e-12
