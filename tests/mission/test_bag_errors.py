import contextlib
import math

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.errors import InputError
from mulan.mission import messages
from mulan.mission.bag_reader import read_mission
from mulan.mission.bag_writer import write_mission

from .bag_faults import spoiled


@pytest.fixture
def bag(mission, tmp_path):
    path = tmp_path / "mission.mcap"
    write_mission(mission, path)
    return path


def refusal(path) -> str:
    """The sentence a bag is refused with; it names the file and is one line."""
    with pytest.raises(InputError) as caught:
        read_mission(path)
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text
    assert caught.value.remedy
    return text


def refusal_when_changed(bag, topic, change) -> str:
    text = refusal(spoiled(bag, topic, change=change))
    assert f"topic {topic}" in text
    return text


def test_a_missing_file_is_named(tmp_path):
    assert "does not exist" in refusal(tmp_path / "nowhere.mcap")


def test_files_that_are_no_bags_are_refused(tmp_path):
    text = tmp_path / "text.mcap"
    text.write_text("this is not a bag, whatever its name says, and it is long enough to hold a footer")
    assert "is not an MCAP file" in refusal(text)
    empty = tmp_path / "empty.mcap"
    empty.write_bytes(b"")
    assert "is not an MCAP file" in refusal(empty)
    other = tmp_path / "mission.bag"
    other.write_bytes(b"#ROSBAG V2.0")
    assert "is not named .mcap" in refusal(other)
    assert "no metadata.yaml" in refusal(tmp_path)


def test_a_bag_cut_at_any_place_is_refused_in_one_sentence(bag, tmp_path):
    whole = bag.read_bytes()
    cut = tmp_path / "cut.mcap"
    places = {*range(1, 60), *range(len(whole) - 60, len(whole)), *range(60, len(whole), len(whole) // 150)}
    for place in places:
        cut.write_bytes(whole[:place])
        assert "cut short" in refusal(cut)


def test_a_bag_without_its_index_but_with_both_ends_never_crashes(bag, tmp_path):
    whole = bag.read_bytes()
    torn = tmp_path / "torn.mcap"
    for place in range(8, len(whole) - 8, len(whole) // 60):
        torn.write_bytes(whole[:place] + whole[-8:])
        refusal(torn)


def test_flipped_bytes_are_read_or_refused_but_never_crash(bag, tmp_path):
    rng = np.random.default_rng(11)
    whole = np.frombuffer(bag.read_bytes(), np.uint8)
    flipped = tmp_path / "flipped.mcap"
    for _ in range(80):
        damaged = whole.copy()
        # the summary at the end is where a flip does most harm
        damaged[rng.integers(len(whole) * 3 // 4 if rng.random() < 0.7 else 0, len(whole))] ^= rng.integers(
            1, 256
        )
        flipped.write_bytes(damaged.tobytes())
        with contextlib.suppress(InputError):
            read_mission(flipped)


@pytest.mark.parametrize(
    "topic",
    [
        "/zebra/camera/image/compressed",
        "/zebra/camera/camera_info",
        "/zebra/odom",
        "/zebra/csi",
        "/zebra/range",
        "/zebra/ground_truth",
        "/held_out/ground_truth",
        "/tf_static",
    ],
)
def test_messages_that_do_not_decode_name_their_topic(bag, topic):
    text = refusal(spoiled(bag, topic, raw=lambda data: data[: len(data) // 2]))
    assert f"topic {topic}: a message does not decode" in text


def test_a_known_topic_of_another_type_is_refused(bag):
    text = refusal(spoiled(bag, "/ant/range", msgtype="std_msgs/msg/String"))
    assert "topic /ant/range: has type std_msgs/msg/String instead of mulan_msgs/msg/Range" in text


def test_a_bag_without_robots_lists_the_topics_it_has(tmp_path):
    with Writer(tmp_path / "chat", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        store = messages.typestore()
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        data = store.serialize_cdr(ros.std_msgs__msg__String("hello"), "std_msgs/msg/String")
        writer.write(connection, 1, data)
    assert "found: /chatter" in refusal(tmp_path / "chat" / "chat.mcap")


def test_unknown_topics_are_ignored(bag, mission):
    path = bag.parent / "more"
    store = messages.typestore()
    with Reader(bag) as reader, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        copies = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections
        }
        chatter = writer.add_connection("/zebra/chatter", "std_msgs/msg/String", typestore=store)
        writer.write(chatter, 1, b"\x00\x01not decodable")
        for connection, time_ns, data in reader.messages():
            writer.write(copies[connection.id], time_ns, data)
    assert read_mission(path / "more.mcap").robots[0].photos == mission.robots[0].photos


def test_images_without_odometry_beside_them_are_refused(bag):
    assert "topic /bee/odom: is missing" in refusal(spoiled(bag, "/bee/odom", drop_topic=True))


@pytest.mark.parametrize("fault", [{"drop_topic": True}, {"drop_messages": True}])
def test_a_camera_without_calibration_is_refused(bag, fault):
    text = refusal(spoiled(bag, "/ant/camera/camera_info", **fault))
    assert "topic /ant/camera/camera_info: has no message" in text


def test_calibrations_we_cannot_use_are_refused(bag):
    def fisheye(info):
        info.distortion_model = "equidistant"

    assert "lens model 'equidistant'" in refusal_when_changed(bag, "/ant/camera/camera_info", fisheye)


def test_an_uncalibrated_camera_is_refused(bag):
    def uncalibrated(info):
        info.k[:] = 0

    assert "not calibrated" in refusal_when_changed(bag, "/ant/camera/camera_info", uncalibrated)


def test_images_of_another_size_than_calibrated_are_refused(bag):
    def larger(info):
        info.width = 640

    text = refusal(spoiled(bag, "/ant/camera/camera_info", change=larger))
    assert "an image of 32x24 pixels does not fit the 640x24" in text


def test_missing_mounts_name_the_frame(bag):
    assert "from zebra/base_link to zebra/" in refusal(spoiled(bag, "/tf_static", drop_topic=True))


@pytest.mark.parametrize("frame", ["ant/camera_optical", "ant/wifi_antenna", "ant/uwb_antenna"])
def test_one_missing_mount_is_named(bag, frame):
    def without(message):
        message.transforms = [t for t in message.transforms if t.child_frame_id != frame]

    assert frame in refusal_when_changed(bag, "/tf_static", without)


def test_mounts_that_run_in_a_circle_are_refused(bag):
    def circular(message):
        for transform in message.transforms:
            if transform.child_frame_id == "ant/camera_optical":
                transform.header.frame_id = "ant/camera_optical"

    assert "ant/camera_optical" in refusal_when_changed(bag, "/tf_static", circular)


def test_a_mount_through_an_intermediate_frame_is_composed(bag, mission):
    def through_a_link(message):
        for transform in message.transforms:
            if transform.child_frame_id == "ant/camera_optical":
                transform.header.frame_id = "ant/camera_link"
        header = ros.std_msgs__msg__Header(message.transforms[0].header.stamp, "ant/base_link")
        shift = ros.geometry_msgs__msg__Transform(
            ros.geometry_msgs__msg__Vector3(1.0, 2.0, 3.0),
            ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0),
        )
        message.transforms.append(ros.geometry_msgs__msg__TransformStamped(header, "ant/camera_link", shift))

    found = read_mission(spoiled(bag, "/tf_static", change=through_a_link)).robot("ant").T_body_camera
    expected = mission.robot("ant").T_body_camera[:3, 3] + [1, 2, 3]
    np.testing.assert_allclose(found[:3, 3], expected, atol=1e-12)


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("topic", ["/zebra/odom", "/zebra/ground_truth"])
def test_positions_that_are_not_finite_are_refused(bag, topic, value):
    def spoil(message):
        pose = message.pose.pose if topic.endswith("odom") else message.pose
        pose.position.y = value

    assert "holds NaN or infinity" in refusal_when_changed(bag, topic, spoil)


@pytest.mark.parametrize("length", [0.0, 0.5, 1.01])
def test_quaternions_not_of_unit_length_are_refused(bag, length):
    def spoil(message):
        q = message.pose.pose.orientation
        q.x, q.y, q.z, q.w = 0.0, 0.0, 0.0, length

    assert f"has length {length:.4g} instead of 1" in refusal_when_changed(bag, "/zebra/odom", spoil)


def test_covariances_that_are_not_finite_are_refused(bag):
    def spoil(message):
        message.pose.covariance[0] = math.nan

    assert "covariance 0 holds NaN" in refusal_when_changed(bag, "/zebra/odom", spoil)


def test_covariances_with_negative_variance_are_refused(bag):
    def spoil(message):
        message.pose.covariance[0] = -1.0

    assert "not symmetric and positive" in refusal_when_changed(bag, "/zebra/odom", spoil)


def test_odometry_without_messages_is_refused(bag):
    assert "topic /ant/odom: has no messages" in refusal(spoiled(bag, "/ant/odom", drop_messages=True))


def test_a_zero_length_csi_log_is_refused(bag):
    assert "topic /ant/csi: is a zero-length CSI log" in refusal(spoiled(bag, "/ant/csi", drop_messages=True))


def test_csi_packets_without_numbers_are_refused(bag):
    def spoil(message):
        message.real = message.imag = np.zeros(0, np.float32)
        message.subcarrier_hz = np.zeros(0)

    assert "zero-length channel" in refusal_when_changed(bag, "/ant/csi", spoil)


def test_a_channel_that_is_zero_throughout_is_refused(bag):
    def spoil(message):
        message.real[:] = message.imag[:] = 0

    assert "zero throughout" in refusal_when_changed(bag, "/ant/csi", spoil)


@pytest.mark.parametrize("name", ["real", "imag", "subcarrier_hz"])
def test_csi_arrays_whose_lengths_disagree_are_refused(bag, name):
    def spoil(message):
        setattr(message, name, getattr(message, name)[:-1])

    assert "antennas x" in refusal_when_changed(bag, "/ant/csi", spoil)


def test_csi_that_is_not_finite_is_refused(bag):
    def spoil(message):
        message.imag[3] = math.nan

    assert "holds NaN" in refusal_when_changed(bag, "/ant/csi", spoil)


def test_csi_whose_frequencies_change_is_refused(bag):
    def spoil(message):
        message.subcarrier_hz = message.subcarrier_hz + message.frame_counter % 2

    assert "subcarriers change" in refusal_when_changed(bag, "/ant/csi", spoil)


def test_ranges_that_are_not_finite_or_have_no_sigma_are_refused(bag):
    def nan(message):
        message.range_m = math.nan

    assert "holds NaN" in refusal_when_changed(bag, "/ant/range", nan)


def test_ranges_without_sigma_are_refused(bag):
    def zero(message):
        message.sigma_m = 0.0

    assert "sigma_m to 'zebra' is not positive" in refusal_when_changed(bag, "/ant/range", zero)


def test_images_that_are_neither_png_nor_jpeg_are_refused(bag):
    def spoil(message):
        message.format, message.data = "webp", np.frombuffer(b"RIFF....WEBP", np.uint8)

    text = refusal_when_changed(bag, "/ant/camera/image/compressed", spoil)
    assert "format 'webp' is neither PNG nor JPEG" in text


def test_a_jpeg_of_nothing_but_its_first_bytes_is_refused(bag):
    def spoil(message):
        message.data = message.data[:4]

    refusal_when_changed(bag, "/ant/camera/image/compressed", spoil)


def test_held_out_photographs_without_poses_are_refused(bag):
    text = refusal(spoiled(bag, "/held_out/ground_truth", drop_messages=True))
    assert "topic /held_out/ground_truth: has not one pose" in text
