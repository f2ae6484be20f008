from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.simulation.course import look_at
from mulan.simulation.from_images import ImageMissionConfig, room_around, share_views, simulate_from_images
from mulan.simulation.recording import body_poses, plan_camera_tours
from mulan.simulation.timeline import TourConfig

CAMERA = PinholeCamera(8, 6, 8.0, 8.0, 4.0, 3.0)
QUICK = ImageMissionConfig(tour=TourConfig(rounds=2))


def _ring(n: int, height_m: float = 1.0):
    azimuth = 2 * np.pi * (np.arange(n) + 0.25) / n
    eye = np.stack([3 * np.cos(azimuth), 3 * np.sin(azimuth), np.full(n, height_m)], -1)
    return look_at(eye, np.zeros((n, 3)))


@pytest.fixture
def images(tmp_path: Path) -> PosedImageSet:
    rng = np.random.default_rng(0)

    def shoot(name: str, T):
        path = tmp_path / name
        Image.fromarray(rng.integers(0, 255, (6, 8, 4), dtype=np.uint8)).save(path)
        return PosedImage(path, CAMERA, T)

    train = tuple(shoot(f"train_{k}.png", T) for k, T in enumerate(_ring(13)))
    test = tuple(shoot(f"test_{k}.png", T) for k, T in enumerate(_ring(4, 1.5)))
    return PosedImageSet(train, test, tmp_path)


def test_every_photograph_is_flown_once_at_its_pose_with_its_own_bytes(images: PosedImageSet):
    mission = simulate_from_images(images, replace(QUICK, metres_per_unit=2.0))
    unseen = {image.path.read_bytes(): image.T_world_camera for image in images.train}
    for robot in mission.robots:
        truth = robot.ground_truth
        assert truth is not None
        T = se3.interpolate(truth.time_s, truth.T_world_body, robot.photo_time_s) @ robot.T_body_camera
        for photo, T_world_camera in zip(robot.photos, T, strict=True):
            expected = unseen.pop(photo.data).copy()
            expected[:3, 3] *= 2.0
            assert photo.encoding == "png"
            assert np.allclose(T_world_camera, expected, atol=1e-7)
    assert not unseen


def test_held_out_views_are_the_test_images_in_the_scaled_world(images: PosedImageSet):
    held_out = simulate_from_images(images, replace(QUICK, metres_per_unit=0.5)).held_out
    assert held_out is not None
    assert [photo.data for photo in held_out.photos] == [image.path.read_bytes() for image in images.test]
    expected = np.stack([image.T_world_camera for image in images.test])
    assert np.allclose(held_out.T_world_camera[:, :3, 3], 0.5 * expected[:, :3, 3])
    assert np.allclose(held_out.T_world_camera[:, :3, :3], expected[:, :3, :3])


def test_pairs_hear_each_other_only_during_antenna_motions_and_range_all_the_time(images: PosedImageSet):
    mission = simulate_from_images(images, replace(QUICK, robots=3))
    assert [robot.name for robot in mission.robots] == ["alpha", "beta", "gamma"]
    for robot in mission.robots:
        assert set(robot.csi) == set(robot.ranges) == {r.name for r in mission.robots} - {robot.name}
        assert robot.ground_truth is not None
        end_s = robot.ground_truth.time_s[-1]
        for peer, track in robot.csi.items():
            # two rounds, two movers a pair, two seconds each, 200 packets a second, 2 % lost each way
            assert len(track.time_s) == pytest.approx(1600, rel=0.07)
            assert np.count_nonzero(np.diff(track.time_s) > 0.2) == 3
            assert robot.ranges[peer].time_s[-1] == pytest.approx(end_s, abs=0.3)
        assert np.array_equal(robot.odometry.time_s, robot.ground_truth.time_s)


def test_azimuth_sectors_are_contiguous_equal_and_begin_behind_the_widest_gap():
    T = _ring(24)[[3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13]]
    shares = share_views(T, 2, "azimuth", np.random.default_rng(0))
    assert [list(share) for share in shares] == [[0, 1, 2, 3, 4, 5], [6, 7, 8, 9, 10]]


@pytest.mark.parametrize("split", ["azimuth", "random", "alternate"])
def test_every_split_deals_all_views_evenly(split):
    shares = share_views(_ring(17), 4, split, np.random.default_rng(1))
    assert sorted(np.concatenate(shares)) == list(range(17))
    assert {len(share) for share in shares} == {4, 5}


def test_the_body_looks_along_x_with_z_up_in_the_image():
    T_camera = _ring(5)
    T_body = body_poses(T_camera)
    assert np.allclose(T_body[:, :3, 0], -T_camera[:, :3, 2])
    assert np.allclose(T_body[:, :3, 2], T_camera[:, :3, 1])


def test_the_room_leaves_two_metres_around_everything(images: PosedImageSet):
    from mulan.simulation.recording import CameraTour

    T = np.stack([image.T_world_camera for image in images.train])
    motions = plan_camera_tours([CameraTour(CAMERA, T, "png", (b"",) * len(T))], TourConfig(rounds=2))
    position = motions[0].pose(motions[0].sample_times())[:, :3, 3]
    room = room_around(motions)
    assert np.allclose(position.min(0) - room.min_corner_m, 2)
    assert np.allclose(room.max_corner_m - position.max(0), 2)


def test_the_same_seed_gives_the_same_mission_and_another_seed_other_noise(images: PosedImageSet):
    first, again, other = (simulate_from_images(images, replace(QUICK, seed=s)) for s in (4, 4, 5))
    for a, b, c in zip(first.robots, again.robots, other.robots, strict=True):
        assert np.array_equal(a.odometry.T_odom_body, b.odometry.T_odom_body)
        assert not np.array_equal(a.odometry.T_odom_body, c.odometry.T_odom_body)
        for peer in a.csi:
            assert np.array_equal(a.csi[peer].channel, b.csi[peer].channel)
            assert np.array_equal(a.ranges[peer].range_m, b.ranges[peer].range_m)


def test_bad_image_sets_are_refused_in_one_sentence(images: PosedImageSet, tmp_path: Path):
    with pytest.raises(InputError, match="robots"):
        simulate_from_images(images, replace(QUICK, robots=0))
    with pytest.raises(InputError, match="cannot be shared by 2 robots"):
        simulate_from_images(replace(images, train=images.train[:1]), QUICK)
    other = replace(images.train[3], camera=replace(CAMERA, fx=9.0))
    with pytest.raises(InputError, match="intrinsics"):
        simulate_from_images(replace(images, train=(*images.train[:3], other)), replace(QUICK, robots=1))
    (tmp_path / "train_2.png").write_bytes(b"GIF89a")
    with pytest.raises(InputError, match=r"train_2\.png: image: is neither PNG nor JPEG"):
        simulate_from_images(images, QUICK)
    (tmp_path / "train_2.png").unlink()
    with pytest.raises(InputError, match=r"train_2\.png"):
        simulate_from_images(images, QUICK)
