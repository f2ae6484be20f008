"""The TOML file that says which foreign topic is what of which robot."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera
from mulan.mission import messages
from mulan.mission.bag_writer import ROBOT_NAME
from mulan.mission.imports.toml_fields import Table, camera_of, load_toml, transform_of
from mulan.mission.messages import Topic

_ODOMETRY, _POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSE_TYPES = (
    _ODOMETRY,
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    _POSE,
    "geometry_msgs/msg/TransformStamped",
    *TF_TYPES,
)


@dataclass(frozen=True)
class Role:
    """What a topic can be for a robot.

    Attributes:
        key: Its key in the TOML file.
        target: The topic it becomes.
        accepts: Message types it can be made from.
    """

    key: str
    target: Topic
    accepts: tuple[str, ...]


IMAGE = Role("image", messages.IMAGE, ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"))
CAMERA_INFO = Role("camera_info", messages.CAMERA_INFO, (messages.CAMERA_INFO.msgtype,))
ODOMETRY = Role("odometry", messages.ODOMETRY, POSE_TYPES)
GROUND_TRUTH = Role("ground_truth", messages.GROUND_TRUTH, POSE_TYPES)
CSI = Role("csi", messages.CSI, (messages.CSI_TYPE,))
RANGE = Role("range", messages.RANGE, (messages.RANGE_TYPE,))
ROLES = (IMAGE, CAMERA_INFO, ODOMETRY, GROUND_TRUTH, CSI, RANGE)

Clock = Literal["header", "record"]


@dataclass(frozen=True)
class ForeignTopic:
    """One topic of the bag, as one role of one robot.

    Attributes:
        name: The topic.
        role: What it is.
        clock: Whose time counts: the message header's, or when it was recorded.
        parent, child: Frames of a transform topic that holds several.
    """

    name: str
    role: Role
    clock: Clock
    parent: str | None = None
    child: str | None = None


@dataclass(frozen=True)
class RobotTopics:
    """Where everything of one robot is.

    Attributes:
        name: The robot.
        bag: Its own bag; None = the one named on the command line.
        topics: By role.
        body_frame, camera_frame, wifi_antenna_frame, uwb_antenna_frame: Names in ``/tf_static``; None = as
            the messages say.
        camera: Calibration, where the bag has none.
        T_body_optical: Where the camera (optical axes) sits, where ``/tf_static`` does not say.
        wifi_antenna_m, uwb_antenna_m: Antennas on the body, likewise.
    """

    name: str
    bag: Path | None
    topics: Mapping[Role, ForeignTopic]
    body_frame: str | None = None
    camera_frame: str | None = None
    wifi_antenna_frame: str | None = None
    uwb_antenna_frame: str | None = None
    camera: PinholeCamera | None = None
    T_body_optical: Float[NDArray, "4 4"] | None = None
    wifi_antenna_m: Float[NDArray, "3"] | None = None
    uwb_antenna_m: Float[NDArray, "3"] | None = None


@dataclass(frozen=True)
class TopicMap:
    """The whole file.

    Attributes:
        path: The file.
        robots: In order, the first being the anchor.
        held_out: Test photographs with true poses of their camera (optical axes), if any; a "robot" whose
            ``ground_truth`` is the camera's.
        tf_static: Topics with static transforms.
    """

    path: Path
    robots: tuple[RobotTopics, ...]
    held_out: RobotTopics | None
    tf_static: tuple[str, ...]


_FRAMES = ("body_frame", "camera_frame", "wifi_antenna_frame", "uwb_antenna_frame")
_KEYS = {
    *(role.key for role in ROLES),
    *_FRAMES,
    "name",
    "bag",
    "clock",
    "camera",
    "camera_mount",
    "wifi_antenna_m",
    "uwb_antenna_m",
}


def read_topic_map(path: Path) -> TopicMap:
    """Read a topic map; ``mulan import BAG --list`` prints one to begin with.

    Raises:
        InputError: The file is missing, is no TOML, or a key is unknown, missing or cannot be used.
    """
    record = load_toml(path)
    record.only({"robot", "held_out", "tf_static"})
    tables = record.values.get("robot")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise record.error("robot", "there is none", "write one [[robot]] table for each, the anchor first")
    robots = tuple(
        _robot(Table(path, f"robot {number}", table)) for number, table in enumerate(tables, start=1)
    )
    names = [robot.name for robot in robots]
    if len(set(names)) < len(names):
        raise record.error("robot", "two have one name", "give every robot its own name")
    held_out = record.table("held_out")
    tf_static = record.values.get("tf_static", ["/tf_static"])
    if not isinstance(tf_static, list) or not all(isinstance(name, str) for name in tf_static):
        raise record.error("tf_static", f"is {tf_static!r}", "list topic names")
    return TopicMap(path, robots, None if held_out is None else _held_out(held_out), tuple(tf_static))


def _robot(table: Table) -> RobotTopics:
    table.only(_KEYS)
    name = table.text("name")
    if name is None or not ROBOT_NAME.fullmatch(name) or name == messages.HELD_OUT:
        raise table.error("name", f"is {name!r}", "give a name of letters, digits and underscores")
    topics = _topics(table)
    for role in (IMAGE, ODOMETRY):
        if role not in topics:
            raise table.error(role.key, "is missing", f"name the topic, e.g. {role.key} = '/{name}/...'")
    mount = table.table("camera_mount")
    return RobotTopics(
        name,
        _bag(table),
        topics,
        *(table.text(key) for key in _FRAMES),
        camera=_camera(table),
        T_body_optical=None if mount is None else transform_of(mount),
        wifi_antenna_m=table.numbers("wifi_antenna_m", 3),
        uwb_antenna_m=table.numbers("uwb_antenna_m", 3),
    )


def _held_out(table: Table) -> RobotTopics:
    table.only({"bag", "image", "camera_info", "ground_truth", "camera", "clock"})
    topics = _topics(table)
    for role in (IMAGE, GROUND_TRUTH):
        if role not in topics:
            raise table.error(role.key, "is missing", "name the topic, or leave the table out")
    return RobotTopics(messages.HELD_OUT, _bag(table), topics, camera=_camera(table))


def _bag(table: Table) -> Path | None:
    bag = table.text("bag")
    return None if bag is None else table.path.parent / bag


def _camera(table: Table) -> PinholeCamera | None:
    camera = table.table("camera")
    return None if camera is None else camera_of(camera)


def _topics(table: Table) -> dict[Role, ForeignTopic]:
    found = {}
    for role in ROLES:
        value = table.values.get(role.key)
        if value is None:
            continue
        clock = _clock(table, role)
        if isinstance(value, dict):
            inner = Table(table.path, f"{table.where}.{role.key}", value)
            inner.only({"topic", "parent", "child"})
            name, parent, child = (inner.text(key) for key in ("topic", "parent", "child"))
            if name is None:
                raise inner.error("topic", "is missing", "name the topic")
            found[role] = ForeignTopic(name, role, clock, parent, child)
        else:
            name = table.text(role.key)
            assert name is not None  # absent ones were passed over
            found[role] = ForeignTopic(name, role, clock)
    return found


def _clock(table: Table, role: Role) -> Clock:
    """``clock = "record"`` for all of a robot's topics, or ``clock = { image = "record" }`` for some."""
    value = table.values.get("clock", "header")
    if isinstance(value, dict):
        inner = Table(table.path, f"{table.where}.clock", value)
        inner.only({each.key for each in ROLES})
        value = value.get(role.key, "header")
    if value == "header" or value == "record":
        return value
    raise table.error("clock", f"is {value!r}", "give 'header' or 'record'")
