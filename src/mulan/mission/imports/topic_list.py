"""What a bag holds, and a topic map to begin with."""

from collections.abc import Sequence

from mulan.mission.imports.foreign_bag import TopicSummary
from mulan.mission.imports.topic_map import (
    CAMERA_INFO,
    CSI,
    GROUND_TRUTH,
    IMAGE,
    ODOMETRY,
    RANGE,
    TF_TYPES,
    Role,
)
from mulan.mission.messages import HELD_OUT

_TRUE = ("ground_truth", "groundtruth", "gt", "vicon", "mocap", "optitrack", "leica", "truth")
_NO_PHOTOGRAPH = ("depth", "mask", "disparity", "thermal", "theora", "ir")
_CAMERA = """\
[robot.camera]            # the bag has no calibration: fill it in
width = 0
height = 0
fx = 0.0
fy = 0.0
cx = 0.0
cy = 0.0
distortion = [0.0, 0.0, 0.0, 0.0]   # k1, k2, p1, p2
first_pixel = 0           # where the centre of the first pixel lies: 0 in OpenCV, ROS, Kalibr; 0.5 in COLMAP
"""
_NOTES = """\
# Further keys of a robot: clock = "record" (recording times instead of header stamps; or for one topic only:
# clock = { image = "record" }), bag = "its_own.bag", body_frame, camera_frame, wifi_antenna_frame,
# uwb_antenna_frame (names in /tf_static), and where /tf_static lacks them: wifi_antenna_m = [x, y, z],
# uwb_antenna_m = [x, y, z], [robot.camera_mount] with translation_m = [x, y, z] and
# quaternion_xyzw = [x, y, z, w], or matrix = 16 numbers: the camera (x right, y down, z forward) in the body.
# Odometry and ground_truth may be transforms:
# odometry = { topic = "/tf", parent = "odom", child = "base_link" }.
"""


def suggested_topic_map(topics: Sequence[TopicSummary]) -> str:
    """A topic map in TOML for what a bag holds: guesses by type and name, with the other choices beside.

    A robot is the first part of topic names that have both a camera and odometry; where no such part is, all
    topics are one robot's.
    """
    full = [topic for topic in topics if topic.count]
    spaces = list(dict.fromkeys(_space(topic) for topic in full))
    groups = {space: [topic for topic in full if _space(topic) == space] for space in spaces}
    robots = {
        space: group
        for space, group in groups.items()
        if space != HELD_OUT and _fitting(group, IMAGE) and _fitting(group, ODOMETRY)
    }
    if not robots:
        robots = {"robot_1": full}
    parts = [
        "# Which topic is what of which robot; the first robot is the anchor, its start frame the world.\n"
    ]
    parts.append(_NOTES)
    parts += [_robot(name, group) for name, group in robots.items()]
    held_out = groups.get(HELD_OUT, [])
    if _fitting(held_out, IMAGE) and _fitting(held_out, GROUND_TRUTH):
        parts.append(_table("[held_out]", held_out, (IMAGE, CAMERA_INFO, GROUND_TRUTH)))
    return "\n".join(parts)


def _space(topic: TopicSummary) -> str:
    return topic.name.strip("/").split("/")[0]


def _robot(name: str, topics: list[TopicSummary]) -> str:
    safe = "".join(c if c.isalnum() else "_" for c in name)
    head = f'[[robot]]\nname = "{safe if not safe[:1].isdigit() else f"robot_{safe}"}"'
    table = _table(head, topics, (IMAGE, CAMERA_INFO, ODOMETRY, GROUND_TRUTH, CSI, RANGE))
    return table if _fitting(topics, CAMERA_INFO) else table + _CAMERA


def _table(head: str, topics: list[TopicSummary], roles: Sequence[Role]) -> str:
    lines = [head]
    image = _fitting(topics, IMAGE)
    for role in roles:
        choices = _fitting(topics, role)
        if role is CAMERA_INFO and image:
            choices.sort(key=lambda topic: -_common(topic.name, image[0].name))
        if role in (ODOMETRY, IMAGE) and not choices:
            lines.append(f'{role.key} = ""   # nothing in the bag fits: {" or ".join(role.accepts)}')
        if choices:
            chosen, *others = choices
            note = f"   # or {', '.join(topic.name for topic in others)}" if others else ""
            value = f'"{chosen.name}"'
            if chosen.msgtype in TF_TYPES:
                value = f'{{ topic = "{chosen.name}", parent = "odom", child = "base_link" }}'
            lines.append(f"{role.key} = {value}{note}")
    return "\n".join(lines) + "\n"


def _fitting(topics: Sequence[TopicSummary], role: Role) -> list[TopicSummary]:
    """Topics that could have a role, the likeliest first."""
    found = [topic for topic in topics if topic.msgtype in role.accepts]
    if role is IMAGE:
        found = [topic for topic in found if not set(_words(topic)) & set(_NO_PHOTOGRAPH)]
    if role is GROUND_TRUTH:
        found = [topic for topic in found if _is_true(topic) and topic.msgtype not in TF_TYPES]
    if role is ODOMETRY:
        # several robots' transforms share /tf, so it is the last resort
        found = [topic for topic in found if not _is_true(topic) and topic.name.strip("/") != "tf_static"]
    return sorted(found, key=lambda topic: role.accepts.index(topic.msgtype))


def _is_true(topic: TopicSummary) -> bool:
    name = topic.name.lower()
    return any(word in _words(topic) or (len(word) > 2 and word in name) for word in _TRUE)


def _words(topic: TopicSummary) -> list[str]:
    return topic.name.lower().replace("/", " ").replace("_", " ").split()


def _common(a: str, b: str) -> int:
    """Length of what two names begin with alike."""
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
