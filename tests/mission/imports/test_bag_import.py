from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.geometry import se3
from mulan.mission import pixels
from mulan.mission.bag_reader import read_mission
from mulan.mission.bag_writer import write_mission
from mulan.mission.imports.bag_import import ImportedMission, import_bag
from mulan.mission.imports.foreign_bag import open_bag
from mulan.mission.imports.foreign_messages import BagImportConfig
from mulan.mission.imports.topic_list import suggested_topic_map
from mulan.mission.imports.topic_map import read_topic_map
from mulan.mission.ros_poses import T_OPTICAL_OPENGL
from mulan.mission.types import Mission

from . import foreign_bags
from .foreign_bags import drone, write_ros2

CAMERA = """
[robot.camera]
width = 8
height = 6
fx = 7.5
fy = 7.25
cx = 3.5
cy = 2.5
"""
DRONE = (
    """
[[robot]]
name = "drone"
image = "/cam0/image_raw"
odometry = "/vio/odometry"
ground_truth = "/vicon/drone"
"""
    + CAMERA
)


def silent(done: float, total: float, text: str) -> None:
    pass


def imported(bag: Path, text: str) -> ImportedMission:
    path = bag.parent / "topics.toml"
    path.write_text(text)
    return import_bag(bag, read_topic_map(path), BagImportConfig("png"), silent)


def refusal(bag: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        imported(bag, text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def same_missions(before: Mission, after: Mission) -> None:
    assert [log.name for log in after.robots] == [log.name for log in before.robots]
    for a, b in zip(before.robots, after.robots, strict=True):
        assert b.photos == a.photos
        assert b.camera == a.camera
        np.testing.assert_allclose(b.T_body_camera, a.T_body_camera, atol=1e-12)
        np.testing.assert_allclose(b.wifi_antenna_body_m, a.wifi_antenna_body_m, atol=1e-12)
        np.testing.assert_allclose(b.uwb_antenna_body_m, a.uwb_antenna_body_m, atol=1e-12)
        np.testing.assert_array_equal(b.odometry.time_s, a.odometry.time_s)
        np.testing.assert_allclose(b.odometry.T_odom_body, a.odometry.T_odom_body, atol=1e-12)
        assert (b.odometry.covariance is None) == (a.odometry.covariance is None)
        if a.odometry.covariance is not None and b.odometry.covariance is not None:
            np.testing.assert_allclose(b.odometry.covariance, a.odometry.covariance, atol=1e-12)
        assert set(b.csi) == set(a.csi)
        for peer, track in a.csi.items():
            np.testing.assert_array_equal(b.csi[peer].channel, track.channel)
            np.testing.assert_array_equal(b.csi[peer].frame_counter, track.frame_counter)
        assert set(b.ranges) == set(a.ranges)
        for peer, track in a.ranges.items():
            np.testing.assert_array_equal(b.ranges[peer].range_m, track.range_m)
        assert (b.ground_truth is None) == (a.ground_truth is None)
    assert before.held_out is not None
    assert after.held_out is not None
    assert after.held_out.photos == before.held_out.photos
    np.testing.assert_allclose(after.held_out.T_world_camera, before.held_out.T_world_camera, atol=1e-12)


@pytest.mark.parametrize("kind", ["ros1", "db3 folder", "db3 file", "mcap folder"])
def test_a_mission_carried_to_another_bag_format_is_imported_whole(mission, tmp_path, kind, capsys):
    original = tmp_path / "mission.mcap"
    write_mission(mission, original)
    if kind == "ros1":
        foreign = foreign_bags.as_ros1(original, tmp_path / "foreign.bag")
    else:
        plugin = StoragePlugin.MCAP if kind.startswith("mcap") else StoragePlugin.SQLITE3
        foreign = foreign_bags.as_ros2(original, tmp_path / "foreign", plugin)
        if kind == "db3 file":
            foreign = foreign / "foreign.db3"
    assert run_command(["import", str(foreign), "--list"]) == 0
    topics = tmp_path / "topics.toml"
    # the list begins with the first robot by name; whoever edits it puts the anchor first
    head, *robots = capsys.readouterr().out.split("[[robot]]")
    robots[-1], _, held_out = robots[-1].partition("[held_out]")
    robots.sort(key=lambda table: '"zebra"' not in table)
    topics.write_text("[[robot]]".join([head, *robots]) + "[held_out]" + held_out)
    out = tmp_path / "back.mcap"
    arguments = ["import", str(foreign), "--topics", str(topics), "--out", str(out)]
    assert run_command(arguments) == 0
    same_missions(mission, read_mission(out))


def test_a_flown_camera_becomes_a_robot(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone())
    result = imported(bag, DRONE)
    (robot,) = result.mission.robots
    assert result.remarks == ()
    assert robot.camera.cx == 4.0
    np.testing.assert_allclose(robot.photo_time_s, [1000.25, 1000.75, 1001.25])
    # the camera sits on the body the odometry moves, by way of a frame above both
    expected = se3.from_parts(np.eye(3), np.array([0.2, 0.0, -0.1])) @ T_OPTICAL_OPENGL
    np.testing.assert_allclose(robot.T_body_camera, expected, atol=1e-12)
    np.testing.assert_allclose(robot.odometry.T_odom_body[:, 0, 3], 0.1 * np.arange(20))
    assert robot.ground_truth is not None
    np.testing.assert_allclose(robot.ground_truth.T_world_body[:, 0, 3], 0.1 * np.arange(20))


def test_odometry_may_be_a_transform(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone())
    tf = '{ topic = "/tf", parent = "odom", child = "imu" }'
    result = imported(bag, DRONE.replace('"/vio/odometry"', tf))
    np.testing.assert_allclose(
        result.mission.robots[0].odometry.T_odom_body[:, 0, 3], 0.1 * np.arange(20), atol=1e-12
    )
    message = refusal(bag, DRONE.replace('"/vio/odometry"', tf.replace("imu", "nobody")))
    assert "no transform from odom to nobody" in message


def test_poses_without_a_body_frame_need_it_named(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone())
    text = DRONE.replace("/vio/odometry", "/vicon/drone").replace('ground_truth = "/vicon/drone"\n', "")
    assert "'unnamed'" in refusal(bag, text)
    named = text.replace('name = "drone"', 'name = "drone"\nbody_frame = "imu"')
    assert len(imported(bag, named).mission.robots[0].odometry.time_s) == 20


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8", "mono8"])
def test_raw_images_keep_their_colours(tmp_path, encoding):
    recorded = drone(1, encoding=encoding)
    topic, time_s, image = recorded[-1]
    raw = np.asarray(image.data).reshape(6, 8, -1)
    recorded[-1] = (topic, time_s, foreign_bags.raw_image(1000.25, encoding, raw, padding=5))
    (robot,) = imported(write_ros2(tmp_path / "flight", recorded), DRONE).mission.robots
    found = pixels.decode(robot.photos[0].data, "test")
    expected = raw[..., 2::-1] if encoding.startswith("bgr") else raw[..., :3]
    np.testing.assert_array_equal(found, np.broadcast_to(expected, (6, 8, 3)))


def test_unknown_encodings_and_short_data_are_one_sentence(tmp_path):
    bag = write_ros2(tmp_path / "bayer", drone(1, encoding="bayer_rggb8"))
    assert "bayer_rggb8" in refusal(bag, DRONE)
    recorded = drone(1)
    recorded[-1][2].data = recorded[-1][2].data[:50]
    assert "too few" in refusal(write_ros2(tmp_path / "short", recorded), DRONE)


def test_an_absent_topic_is_told_with_its_neighbours_and_the_bags_list(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone())
    message = refusal(bag, DRONE.replace("/cam0/image_raw", "/cam0/image"))
    assert "did you mean /cam0/image_raw" in message
    assert "/vio/odometry (nav_msgs/Odometry)" in message
    assert "image of drone" in message


def test_a_topic_of_another_type_is_told_with_what_would_do(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone())
    message = refusal(bag, DRONE.replace("/cam0/image_raw", "/vio/odometry"))
    assert "is of type nav_msgs/Odometry" in message
    assert "sensor_msgs/CompressedImage or sensor_msgs/Image" in message


def test_without_calibration_the_sentence_says_how_to_give_it(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone())
    message = refusal(bag, DRONE.replace(CAMERA, ""))
    assert "has no calibration" in message
    assert "[robot.camera]" in message


def test_clocks_apart_are_refused_and_recording_times_are_the_way_out(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone(image_offset_s=-900.0))
    message = refusal(bag, DRONE)
    assert "clocks apart" in message
    assert "/cam0/image_raw" in message
    by_record = imported(bag, DRONE.replace("image =", 'clock = { image = "record" }\nimage ='))
    np.testing.assert_allclose(by_record.mission.robots[0].photo_time_s, [1000.27, 1000.77, 1001.27])


def test_headers_that_were_never_stamped_are_refused(tmp_path):
    recorded = drone()
    for topic, _, message in recorded:
        if topic == "/vio/odometry":
            message.header = foreign_bags.header(0.0, "odom")
    message = refusal(write_ros2(tmp_path / "flight", recorded), DRONE)
    assert "every header has the stamp 0.000 s" in message
    assert "odometry = 'record'" in message


def test_robots_that_never_met_are_remarked_on(tmp_path):
    first = write_ros2(tmp_path / "first", drone())
    later = [(topic, time_s + 500, message) for topic, time_s, message in drone()]
    for _, _, message in later:
        if hasattr(message, "header"):
            message.header.stamp.sec += 500
    write_ros2(tmp_path / "second", later)
    second = DRONE.replace('"drone"', '"late"').replace("image =", 'bag = "second"\nimage =')
    result = imported(first, DRONE + second)
    assert [robot.name for robot in result.mission.robots] == ["drone", "late"]
    assert any("never recorded at the same time" in remark for remark in result.remarks)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("image =", "imagee ="), "did you mean image"),
        (('name = "drone"', 'name = "a b"'), "letters, digits"),
        (('odometry = "/vio/odometry"\n', ""), "odometry: is missing"),
        (("[[robot]]", "[robot]"), "there is none"),
        (('name = "drone"', 'name = "drone"\nclock = "sun"'), "'header' or 'record'"),
        (('name = "drone"', 'name = "drone"\nwifi_antenna_m = [1, 2]'), "give 3 numbers"),
        (("fx = 7.5", "fx = 0.0"), "fx"),
        (('"/vio/odometry"', "{ parent = 'a' }"), "name the topic"),
        (("[[robot]]", "tf_static = 3\n[[robot]]"), "tf_static"),
    ],
)
def test_mistakes_in_a_topic_map_are_one_sentence(tmp_path, change, sentence):
    bag = write_ros2(tmp_path / "flight", drone())
    assert sentence in refusal(bag, DRONE.replace(*change))


def test_damaged_bags_are_one_sentence(mission, tmp_path):
    original = tmp_path / "mission.mcap"
    write_mission(mission, original)
    whole = foreign_bags.as_ros1(original, tmp_path / "whole.bag").read_bytes()
    rng = np.random.default_rng(0)
    (tmp_path / "topics.toml").write_text(DRONE)
    topics = read_topic_map(tmp_path / "topics.toml")
    spoiled = tmp_path / "spoiled.bag"
    for k in range(25):
        data = bytearray(whole[: rng.integers(1, len(whole))] if k % 2 else whole)
        for _ in range(20):
            data[rng.integers(len(data))] = rng.integers(256)
        spoiled.write_bytes(bytes(data))
        with pytest.raises(InputError):
            import_bag(spoiled, topics, BagImportConfig(), silent)


def test_the_list_of_a_foreign_bag_is_a_map_that_needs_only_the_calibration(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone())
    with open_bag(bag) as opened:
        text = suggested_topic_map(opened.topics)
    assert 'image = "/cam0/image_raw"' in text
    assert 'odometry = "/vio/odometry"' in text
    assert 'ground_truth = "/vicon/drone"' in text
    filled = text.replace("width = 0", "width = 8").replace("height = 0", "height = 6")
    filled = filled.replace("fx = 0.0", "fx = 7.5").replace("fy = 0.0", "fy = 7.5")
    assert len(imported(bag, filled).mission.robots[0].photos) == 3


def test_import_asks_for_a_topic_map_and_names_the_command_that_makes_one(tmp_path):
    bag = write_ros2(tmp_path / "flight", drone())
    with pytest.raises(InputError, match="--list"):
        run_command(["import", str(bag), "--out", str(tmp_path / "out.mcap")])


@pytest.mark.data
def test_a_real_flight_with_its_drifting_estimate_becomes_a_robot(data, tmp_path):
    """EuRoC: VIO as odometry, motion capture as truth, both real; the pictures are drawn."""
    from mulan.mission.tum import read_tum

    vio = read_tum(data / "euroc_vio" / "MH_01" / "vio_mono.txt.gz")
    truth = read_tum(data / "euroc_vio" / "MH_01" / "groundtruth.txt.gz")
    recorded = [each for each in drone() if each[0] == "/tf_static"]
    for k in range(0, 200, 4):
        recorded.append(
            ("/vio/odometry", vio.time_s[k], with_pose(vio.time_s[k], vio.T_world_body[k], "odometry"))
        )
    within = (truth.time_s >= vio.time_s[0]) & (truth.time_s <= vio.time_s[196])
    for time_s, T in zip(truth.time_s[within][::40], truth.T_world_body[within][::40], strict=True):
        recorded.append(("/vicon/drone", float(time_s), with_pose(float(time_s), T, "pose")))
    grey = np.full((6, 8, 1), 128, np.uint8)
    for k in (20, 60):
        recorded.append(
            ("/cam0/image_raw", vio.time_s[k], foreign_bags.raw_image(vio.time_s[k], "mono8", grey))
        )
    bag = foreign_bags.as_ros1(write_ros2(tmp_path / "flight", recorded), tmp_path / "MH_01.bag")
    (robot,) = imported(bag, DRONE).mission.robots
    np.testing.assert_allclose(robot.odometry.T_odom_body, vio.T_world_body[0:200:4], atol=1e-9)
    assert robot.ground_truth is not None
    assert len(robot.ground_truth.time_s) > 3


def with_pose(time_s: float, T: np.ndarray, kind: str):
    from mulan.mission import ros_poses

    message = foreign_bags.odometry(time_s, 0.0) if kind == "odometry" else foreign_bags.posed(time_s, 0.0)
    if kind == "odometry":
        message.pose.pose = ros_poses.to_pose(T)
    else:
        message.pose = ros_poses.to_pose(T)
    return message
