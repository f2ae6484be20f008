"""A robot's messages, a free port, and the envelopes a base station judges."""

import socket
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.fleet.envelope import Envelope
from mulan.fleet.names import RobotKey
from mulan.fleet.wire_topics import MOUNTS, WIRE_TOPICS, Importance, type_hash
from mulan.fleet.zenoh_session import LinkConfig
from mulan.mission import messages, robot_messages
from mulan.mission.ros_stamps import to_stamp
from tests.mission.conftest import EPOCH_S, make_robot

EPOCH_NS = int(EPOCH_S) * 1_000_000_000
SENT_NS = EPOCH_NS + 60 * 1_000_000_000
INCARNATION, SESSION = 77, 88


@dataclass(frozen=True)
class Recorded:
    """One message as a robot records it."""

    suffix: str
    record_ns: int
    payload: bytes


@pytest.fixture(scope="session")
def recorded() -> list[Recorded]:
    return recorded_by("ant", ["zebra"])


def recorded_by(robot: str, peers: list[str]) -> list[Recorded]:
    """Every message of a small log: calibration first, then in order of topics."""
    log = make_robot(robot, peers, np.random.default_rng(3))
    stamp = to_stamp(EPOCH_NS)
    found = [
        (messages.CAMERA_INFO.suffix, EPOCH_NS, robot_messages.calibration(robot, log.camera, stamp)),
        (MOUNTS.suffix, EPOCH_NS, ros.tf2_msgs__msg__TFMessage(robot_messages.mounts(log, stamp))),
    ]
    for topic, stamped in robot_messages.of_robot(log).items():
        found += [(topic.suffix, time_ns, message) for time_ns, message in stamped]
    store = messages.typestore()
    return [Recorded(s, t, bytes(store.serialize_cdr(m, WIRE_TOPICS[s].topic.msgtype))) for s, t, m in found]


def key_of(suffix: str, robot: str = "ant", mission: str = "m") -> str:
    return str(RobotKey(mission, robot, suffix))


def envelope_of(message: Recorded, sequence: int, **changes: Any) -> bytes:
    fields: dict[str, Any] = {
        "sender": "ant",
        "incarnation": INCARNATION,
        "session": SESSION,
        "sequence": sequence,
        "settled_below": 0,
        "type_hash": type_hash(WIRE_TOPICS[message.suffix].topic.msgtype),
        "record_ns": message.record_ns,
        "sent_ns": SENT_NS,
    }
    return Envelope(**(fields | changes)).encode()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def free_endpoint() -> LinkConfig:
    return LinkConfig(f"tcp/127.0.0.1:{free_port()}")


def of_importance(recorded: list[Recorded], importance: Importance) -> list[Recorded]:
    return [m for m in recorded if WIRE_TOPICS[m.suffix].importance is importance]


def first_of(recorded: list[Recorded], suffix: str) -> Recorded:
    return next(m for m in recorded if m.suffix == suffix)
