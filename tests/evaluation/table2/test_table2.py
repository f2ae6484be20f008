import json
from dataclasses import replace

import numpy as np
import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.evaluation.table2.colmap import ColmapConfig, ColmapMap, colmap_map
from mulan.evaluation.table2.colmap_alignment import AlignmentFailedError, between_robots, by_colmap_alone
from mulan.evaluation.table2.hardware import HardwareSource, at_own_odometry
from mulan.evaluation.table2.protocol import Table2Config, order_of, table2
from mulan.geometry import se3
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.run_folder import RunFolder
from mulan.simulation.timeline import TourConfig

from ...reconstruction.cube_scene import cube_images


def ignore(*_):
    pass


def hardware(folder, **options):
    return HardwareSource(
        cube_images(folder, train=12, test=2, side=12), tour=TourConfig(rounds=2), **options
    )


def named(images):
    return replace(
        images, train=tuple(replace(image, robot_id="ab"[i % 2]) for i, image in enumerate(images.train))
    )


def made_map(images, which, scale=0.37):
    away = se3.exp(np.array([0.3, -0.2, 1.0, 2.0, 1.0, -3.0]))
    placed = {}
    for i in which:
        placed[i] = away @ images.train[i].T_world_camera
        placed[i][:3, 3] *= scale
    return ColmapMap(placed, len(images.train), 1, 0.0)


def test_the_papers_order_is_checked_of_the_setups_there_are():
    assert order_of({"A": 32, "ours": 31, "D": 28, "C": 28, "B": 31.5}) == {
        "A >= ours": True,
        "ours >= D": True,
        "D > C": False,
        "ours >= B": False,
    }
    assert order_of({"A": 32, "E": 10}) == {}


def test_motion_capture_replaces_drift_and_nothing_else(tmp_path):
    source = hardware(tmp_path)
    drifting, steady = source.mission(0), replace(source, motion_captured=1).mission(0)
    for log, other in zip(drifting.robots, steady.robots, strict=True):
        assert all(np.array_equal(log.csi[peer].channel, other.csi[peer].channel) for peer in log.csi)
    images = cube_images(tmp_path, train=12, test=2, side=12)
    errors_m = []
    for mission in (drifting, steady):
        robot = mission.robots[0]
        truth = se3.interpolate(robot.odometry.time_s, robot.odometry.T_odom_body, robot.photo_time_s)
        assert robot.ground_truth is not None
        true = se3.interpolate(robot.ground_truth.time_s, robot.ground_truth.T_world_body, robot.photo_time_s)
        errors_m.append(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))
        errors_m[-1] -= np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1)
    assert np.abs(errors_m[1]).max() < 1e-3 < np.abs(errors_m[0]).max()
    second = (drifting.robots[1].odometry.T_odom_body, steady.robots[1].odometry.T_odom_body)
    np.testing.assert_array_equal(*second)
    own = at_own_odometry(drifting, images)
    assert own.train[0].pose_covariance is None


def test_a_map_of_another_scale_and_frame_is_carried_to_the_anchor(tmp_path):
    images = named(cube_images(tmp_path, train=8, test=1, side=8))
    found = by_colmap_alone(made_map(images, (0, 1, 2, 4, 5, 6)), images, "a")
    assert len(found.train) == 6
    for image in found.train:
        true = next(each for each in images.train if each.path == image.path)
        assert image.T_world_camera == pytest.approx(true.T_world_camera, abs=1e-9)


def test_the_map_joins_robots_whose_odometry_knows_nothing_of_each_other(tmp_path):
    images = named(cube_images(tmp_path, train=10, test=1, side=8))
    elsewhere = se3.exp(np.array([0.0, 0.0, 2.0, 5.0, -4.0, 1.0]))
    odometry = replace(
        images,
        train=tuple(
            replace(i, T_world_camera=elsewhere @ i.T_world_camera) if i.robot_id == "b" else i
            for i in images.train
        ),
    )
    joined = between_robots(made_map(images, (0, 1, 2, 3, 4, 5, 6)), odometry, "a")
    assert len(joined.train) == 10  # those COLMAP did not place are where odometry has them
    for image, true in zip(joined.train, images.train, strict=True):
        assert image.T_world_camera == pytest.approx(true.T_world_camera, abs=1e-9)


def test_a_map_without_enough_of_a_robot_is_told_in_words(tmp_path):
    images = named(cube_images(tmp_path, train=8, test=1, side=8))
    with pytest.raises(AlignmentFailedError, match=r"map of 4 of 8 photographs holds 1 of b's"):
        between_robots(made_map(images, (0, 2, 4, 5)), images, "a")
    with pytest.raises(AlignmentFailedError, match="found no map"):
        by_colmap_alone(ColmapMap({}, 8, 0, 0.0, "COLMAP found no map"), images, "a")


def test_a_colmap_that_is_stopped_or_dies_has_failed_in_words(tmp_path):
    images = named(cube_images(tmp_path, train=4, test=1, side=8))
    stopped = colmap_map(images, tmp_path / "stopped", ColmapConfig(1, 1, 0.01), 0, ignore)
    assert stopped.why_not == "COLMAP was stopped after 0.01 s"
    images.train[0].path.write_bytes(b"no picture")
    broken = colmap_map(images, tmp_path / "broken", ColmapConfig(100, 1), 0, ignore)
    assert broken.why_not is not None
    assert broken.record()["placed"] == 0


def test_unknown_setups_and_no_seeds_are_one_sentence(tmp_path):
    source = hardware(tmp_path)
    for config, words in ((Table2Config(only=("F",)), "setup 'F'"), (Table2Config(0), "--seeds")):
        with pytest.raises(InputError, match=words):
            table2(source, config, RunFolder(tmp_path), lambda _: ignore, ignore)


def test_the_command_writes_every_setup_and_says_why_colmap_found_nothing(tmp_path, capsys):
    images = cube_images(tmp_path, train=12, test=2, side=24)
    write_transforms(images, tmp_path / "transforms.json")
    out = tmp_path / "out"
    command = ["evaluate", "table2", "--data", str(tmp_path), "--out", str(out), "--seeds", "1"]
    more = ["--image-size", "12", "--steps", "3", "--tour.rounds", "2", "--colmap.threads", "1"]
    assert run_command([*command, *more, "--only", "A,D,E,E_poses", "--drift", "second"]) == 0
    metrics = json.loads((out / "metrics.json").read_text())
    assert list(metrics["setups"]) == ["A", "D"]
    assert metrics["setups"]["A"]["camera_rms_m"] == 0
    assert set(metrics["setups"]["D"]["psnr_db"]) == {"mean", "std"}
    assert set(metrics["failed"]) == {"E", "E_poses"}
    assert metrics["colmap"]["0"]["placed"] == 0
    assert metrics["colmap"]["0"]["why_not"] == metrics["failed"]["E"]["0"]
    assert metrics["provenance"]["drift"] == "second"
    assert "failed, COLMAP found no map" in " ".join(capsys.readouterr().out.split())
    assert (out / "psnr.png").is_file()
    assert (out / "views.png").is_file()
