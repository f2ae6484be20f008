from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from mulan.errors import InputError
from mulan.geometry import so3
from mulan.mission import messages
from mulan.mission.bag_reader import read_mission
from mulan.mission.bag_writer import write_mission
from mulan.mission.types import Mission

from .conftest import EPOCH_S


@pytest.fixture
def bag(mission, tmp_path):
    path = tmp_path / "mission.mcap"
    write_mission(mission, path)
    return path


def decoded(data: bytes, msgtype: str) -> Any:
    return messages.typestore().deserialize_cdr(data, msgtype)


def test_photographs_come_back_byte_for_byte(mission, bag):
    found = read_mission(bag)
    for before, after in zip(mission.robots, found.robots, strict=True):
        assert after.photos == before.photos
    assert mission.held_out is not None
    assert found.held_out is not None
    assert found.held_out.photos == mission.held_out.photos


def test_the_first_robot_stays_the_anchor(mission, bag):
    assert [log.name for log in read_mission(bag).robots] == ["zebra", "ant", "bee"]


def test_cameras_and_mounts_come_back(mission, bag):
    found = read_mission(bag)
    for before, after in zip(mission.robots, found.robots, strict=True):
        assert after.camera == before.camera
        np.testing.assert_allclose(after.T_body_camera, before.T_body_camera, atol=1e-14)
        np.testing.assert_array_equal(after.wifi_antenna_body_m, before.wifi_antenna_body_m)
        np.testing.assert_array_equal(after.uwb_antenna_body_m, before.uwb_antenna_body_m)


def test_odometry_and_its_covariance_come_back_and_zeros_mean_none(mission, bag):
    found = read_mission(bag)
    for before, after in zip(mission.robots, found.robots, strict=True):
        np.testing.assert_array_equal(after.odometry.time_s, before.odometry.time_s)
        np.testing.assert_allclose(after.odometry.T_odom_body, before.odometry.T_odom_body, atol=1e-14)
        if before.odometry.covariance is None:
            assert after.odometry.covariance is None
        else:
            assert after.odometry.covariance is not None
            np.testing.assert_allclose(after.odometry.covariance, before.odometry.covariance, atol=1e-15)


def test_csi_comes_back_to_single_precision_and_exactly_in_counter_and_time(mission, bag):
    found = read_mission(bag)
    for before, after in zip(mission.robots, found.robots, strict=True):
        assert set(after.csi) == set(before.csi)
        for peer, track in before.csi.items():
            np.testing.assert_array_equal(after.csi[peer].channel, track.channel)
            np.testing.assert_array_equal(after.csi[peer].frame_counter, track.frame_counter)
            np.testing.assert_array_equal(after.csi[peer].time_s, track.time_s)
            np.testing.assert_array_equal(after.csi[peer].subcarrier_hz, track.subcarrier_hz)


def test_ranges_come_back_exactly(mission, bag):
    for before, after in zip(mission.robots, read_mission(bag).robots, strict=True):
        assert set(after.ranges) == set(before.ranges)
        for peer, track in before.ranges.items():
            np.testing.assert_array_equal(after.ranges[peer].range_m, track.range_m)
            np.testing.assert_array_equal(after.ranges[peer].sigma_m, track.sigma_m)
            np.testing.assert_array_equal(after.ranges[peer].time_s, track.time_s)


def test_true_poses_come_back(mission, bag):
    found = read_mission(bag)
    for before, after in zip(mission.robots, found.robots, strict=True):
        assert (after.ground_truth is None) == (before.ground_truth is None)
        if before.ground_truth is not None and after.ground_truth is not None:
            np.testing.assert_allclose(
                after.ground_truth.T_world_body, before.ground_truth.T_world_body, atol=1e-14
            )
    assert found.held_out is not None
    assert mission.held_out is not None
    np.testing.assert_allclose(found.held_out.T_world_camera, mission.held_out.T_world_camera, atol=1e-14)


def test_plain_mcap_reads_every_message_in_order_of_time(mission, bag):
    with bag.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        logged = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
    assert logged == sorted(logged)
    topics = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert topics["/zebra/csi"] == "mulan_msgs/msg/Csi"
    assert topics["/ant/range"] == "mulan_msgs/msg/Range"
    assert topics["/bee/camera/image/compressed"] == "sensor_msgs/msg/CompressedImage"
    assert topics["/tf_static"] == "tf2_msgs/msg/TFMessage"
    assert "/bee/csi" not in topics


def test_rosbags_opens_the_file_and_logs_each_message_at_its_stamp(bag):
    with Reader(bag) as reader:
        wanted = [c for c in reader.connections if c.topic == "/zebra/camera/image/compressed"]
        for connection, time_ns, data in reader.messages(wanted):
            stamp = decoded(data, connection.msgtype).header.stamp
            assert time_ns == stamp.sec * 10**9 + stamp.nanosec
            assert stamp.sec == int(EPOCH_S) + (time_ns - int(EPOCH_S) * 10**9) // 10**9


def test_camera_frames_in_the_bag_are_ros_optical_frames(mission, bag):
    """A point straight ahead of the camera has positive z in its optical frame."""
    with Reader(bag) as reader:
        wanted = [c for c in reader.connections if c.topic == "/tf_static"]
        _, _, data = next(iter(reader.messages(wanted)))
    mounts = {t.child_frame_id: t for t in decoded(data, messages.TF_STATIC_TYPE).transforms}
    q = mounts["zebra/camera_optical"].transform.rotation
    forward_body = so3.from_quaternion(np.array([q.x, q.y, q.z, q.w]))[:, 2]
    np.testing.assert_allclose(forward_body, -mission.robots[0].T_body_camera[:3, 2], atol=1e-12)
    assert mounts["zebra/wifi_antenna"].header.frame_id == "zebra/base_link"


def test_calibration_in_the_bag_puts_pixel_centres_where_opencv_does(mission, bag):
    with Reader(bag) as reader:
        wanted = [c for c in reader.connections if c.topic == "/ant/camera/camera_info"]
        connection, _, data = next(iter(reader.messages(wanted)))
    info = decoded(data, connection.msgtype)
    camera = mission.robots[1].camera
    assert (info.k[2], info.k[5]) == (camera.cx - 0.5, camera.cy - 0.5)
    assert tuple(info.d) == camera.distortion


def test_messages_recorded_out_of_order_are_sorted(mission, tmp_path):
    log = mission.robots[0]
    shuffled = replace(log, photos=log.photos[::-1])
    path = tmp_path / "shuffled.mcap"
    write_mission(Mission((shuffled,)), path)
    found = read_mission(path)
    assert found.robots[0].photos == log.photos
    assert found.held_out is None


def test_a_robot_without_radio_needs_no_antenna_topics(mission, tmp_path):
    path = tmp_path / "silent.mcap"
    write_mission(Mission((mission.robots[2],)), path)
    found = read_mission(path).robots[0]
    assert found.csi == {}
    assert found.ranges == {}


def test_a_rewritten_bag_replaces_the_old_one_and_leaves_nothing_beside_it(mission, bag):
    write_mission(Mission(mission.robots[:1]), bag)
    assert len(read_mission(bag).robots) == 1
    assert [entry.name for entry in bag.parent.iterdir()] == ["mission.mcap"]


def test_a_failed_write_keeps_the_old_bag(mission, bag):
    broken = replace(mission.robots[0].photos[0], time_s=-1.0)
    with pytest.raises(InputError, match="does not fit a ROS stamp"):
        write_mission(Mission((replace(mission.robots[0], photos=(broken,)),)), bag)
    assert len(read_mission(bag).robots) == 3
    assert [entry.name for entry in bag.parent.iterdir()] == ["mission.mcap"]


@pytest.mark.parametrize("name", ["", "a b", "../x", "7up", "held_out", "r/1"])
def test_names_ros_would_refuse_are_refused(mission, tmp_path, name):
    with pytest.raises(InputError, match="robot name"):
        write_mission(Mission((replace(mission.robots[0], name=name),)), tmp_path / "bag.mcap")


def test_two_robots_of_one_name_and_other_suffixes_are_refused(mission, tmp_path):
    with pytest.raises(InputError, match="not all different"):
        write_mission(Mission(mission.robots[:1] * 2), tmp_path / "bag.mcap")
    with pytest.raises(InputError, match=r"does not end in \.mcap"):
        write_mission(mission, tmp_path / "bag.bag")


def test_a_bag_folder_as_ros2_records_it_is_read_too(mission, bag, tmp_path):
    folder = tmp_path / "recorded"
    with Reader(bag) as reader, Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        copies = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=messages.typestore())
            for c in reader.connections
            if c.topic != messages.ROBOTS
        }
        for connection, time_ns, data in reader.messages():
            if connection.id in copies:
                writer.write(copies[connection.id], time_ns, data)
    # a foreign bag does not name its anchor: robots come by name
    assert [log.name for log in read_mission(folder).robots] == ["ant", "bee", "zebra"]
