"""What of a robot's messages is sent: thinned odometry, photographs within a budget, all else as it is."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.fleet.image_budget import ImageBudget, ImageConfig
from mulan.fleet.odometry_thinning import OdometryConfig, OdometryThinning
from mulan.fleet.spool import Unsent
from mulan.fleet.wire_topics import WIRE_TOPICS, Importance
from mulan.mission import messages, ros_poses
from mulan.mission.ros_stamps import NANOSECONDS


@dataclass(frozen=True)
class ChoiceConfig:
    """What of a robot's messages is sent."""

    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    """Dead reckoning sent."""
    images: ImageConfig = field(default_factory=ImageConfig)
    """Photographs sent."""


class MessageChoice:
    """Decides message by message, knowing only the past.

    Attributes:
        images: What became of the photographs.
        last_pose: Newest dead reckoning seen, sent or not; None before any.
    """

    def __init__(self, config: ChoiceConfig) -> None:
        self.images = ImageBudget(config.images)
        self.last_pose: Float[NDArray, "4 4"] | None = None
        self._thinning: OdometryThinning[bytes] = OdometryThinning(config.odometry)
        self._truth_thinning: OdometryThinning[bytes] = OdometryThinning(config.odometry)

    def of(self, suffix: str, record_ns: int, message: Any, payload: bytes) -> list[Unsent]:
        """What to send now that this was recorded; it may be an earlier pose as well.

        Args:
            suffix: Of its topic.
            record_ns: The time in its header.
            message: Decoded.
            payload: Its CDR bytes.

        Raises:
            InputError: It is a photograph that cannot be read.
        """
        own = Unsent(WIRE_TOPICS[suffix].importance, suffix, record_ns, payload)
        if suffix == messages.ODOMETRY.suffix:
            self.last_pose = _pose(message)
            return _poses(suffix, self._thinning.odometry(record_ns, payload))
        if suffix == messages.GROUND_TRUTH.suffix:
            return _poses(suffix, self._truth_thinning.odometry(record_ns, payload))
        if suffix == messages.CSI.suffix:
            return [*_poses(messages.ODOMETRY.suffix, self._thinning.packet(record_ns)), own]
        if suffix == messages.IMAGE.suffix:
            return self._photograph(record_ns, message, payload)
        return [own]

    def _photograph(self, record_ns: int, message: Any, payload: bytes) -> list[Unsent]:
        fitted = self.images.fit(message.data.tobytes(), record_ns / NANOSECONDS, self.last_pose)
        if fitted is None:
            return []
        payload = payload if len(fitted) == len(message.data) else _image(message, fitted)
        poses = _poses(messages.ODOMETRY.suffix, self._thinning.photograph())
        truth = _poses(messages.GROUND_TRUTH.suffix, self._truth_thinning.photograph())
        return [*poses, *truth, Unsent(Importance.IMAGE, messages.IMAGE.suffix, record_ns, payload)]


def own_mounts(message: Any, robot: str) -> Any | None:
    """A robot's own frames out of the topic all robots share; None without any."""
    mine = [t for t in message.transforms if t.child_frame_id.startswith(f"{robot}/")]
    return type(message)(mine) if mine else None


def _poses(suffix: str, found: list[tuple[int, bytes, Importance]]) -> list[Unsent]:
    truth = suffix == messages.GROUND_TRUTH.suffix
    return [Unsent(Importance.EVALUATION if truth else i, suffix, t, data) for t, data, i in found]


def _pose(message: Any) -> Float[NDArray, "4 4"]:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return ros_poses.to_matrices(np.array([[p.x, p.y, p.z]]), np.array([[q.x, q.y, q.z, q.w]]))[0]


def _image(message: Any, data: bytes) -> bytes:
    made = type(message)(message.header, "jpeg", np.frombuffer(data, np.uint8))
    return bytes(messages.typestore().serialize_cdr(made, messages.IMAGE.msgtype))
