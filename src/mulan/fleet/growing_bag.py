"""The mission in a bag that is still being written, as far as it has come."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mulan.fleet.journal_scan import MAGIC, JournalScan, scan
from mulan.mission import messages
from mulan.mission.bag_reader import mission_of
from mulan.mission.bag_topics import BagTopics
from mulan.mission.bag_writer import ROBOT_NAME
from mulan.mission.ros_stamps import stamp_s
from mulan.mission.types import Mission, RobotLog

_UNSTAMPED = (messages.ROBOTS, messages.TF_STATIC)


class GrowingBag:
    """Reads what a base station has written since the last look; the base station is not asked.

    Attributes:
        path: The bag.
        received: Messages of a mission read so far.
    """

    def __init__(self, path: Path) -> None:
        """Follow a bag, which need not exist yet."""
        self.path = path
        self.received = 0
        self._scan = JournalScan()
        self._found: dict[str, list[Any]] = {}
        self._unsorted: set[str] = set()

    @property
    def finished(self) -> bool:
        """Whether a base station has closed it and none has opened it again."""
        if not self.path.exists() or self.path.stat().st_size < 2 * len(MAGIC):
            return False
        with self.path.open("rb") as file:
            file.seek(-len(MAGIC), 2)
            return file.read() == MAGIC

    def read(self) -> int:
        """Take in what is new; returns how many messages of a mission that was.

        Raises:
            InputError: The file is not one a base station writes.
        """
        if not self.path.exists() or (size := self.path.stat().st_size) < len(MAGIC):
            return 0
        if size < self._scan.end:
            # a full disk made the base station take back what it had begun to write
            self._scan, self._found, self._unsorted = JournalScan(), {}, set()
            self.received = 0
        before, store = self.received, messages.typestore()
        for recorded in scan(self.path, self._scan):
            topic = recorded.channel.topic
            msgtype = self._scan.schemas[recorded.channel.schema_id].name
            if _type_of(topic) != msgtype:
                continue
            self._found.setdefault(topic, []).append(store.deserialize_cdr(recorded.payload, msgtype))
            self._unsorted.add(topic)
            self.received += 1
        return self.received - before

    def mission(self, margin_s: float = 0.0) -> Mission | None:
        """What the robots have recorded up to a margin before their newest odometry; None before any.

        A robot is left out until its calibration, two poses and a photograph among them have come. What one
        heard of others left out is left out too.

        Raises:
            InputError: A topic holds something that cannot be used, which no base station lets in.
        """
        for topic in self._unsorted.difference(_UNSTAMPED):
            self._found[topic].sort(key=stamp_s)
        self._unsorted.clear()
        bag = BagTopics(self.path, self._found)
        names = [name for name in self._robots() if self._is_complete(name)]
        if not names:
            return None
        logs = [_until_odometry(log, margin_s) for log in mission_of(bag, names).robots]
        logs = [log for log in logs if len(log.odometry.time_s) > 1 and log.photos]
        anchor = next(iter(self._ordered()), None)
        # without the anchor there is no world yet
        if not logs or (anchor is not None and logs[0].name != anchor):
            return None
        by_name = {log.name: log for log in logs}
        return Mission(tuple(_among(log, by_name) for log in logs))

    def _ordered(self) -> list[str]:
        return [name for message in self._found.get(messages.ROBOTS, [])[:1] for name in message.data.split()]

    def _robots(self) -> list[str]:
        suffix = f"/{messages.ODOMETRY.suffix}"
        names = [topic.removesuffix(suffix)[1:] for topic in self._found if topic.endswith(suffix)]
        return sorted(name for name in names if ROBOT_NAME.fullmatch(name))

    def _is_complete(self, name: str) -> bool:
        frames = messages.RobotFrames(name)
        mounted = {
            transform.child_frame_id.lstrip("/")
            for message in self._found.get(messages.TF_STATIC, [])
            for transform in message.transforms
        }
        wanted = {frames.camera_optical}
        for topic, frame in ((messages.CSI, frames.wifi_antenna), (messages.RANGE, frames.uwb_antenna)):
            if any(known.endswith(f"/{topic.suffix}") for known in self._found):
                wanted.add(frame)
        return (
            all(
                self._found.get(topic.of(name))
                for topic in (messages.CAMERA_INFO, messages.IMAGE, messages.ODOMETRY)
            )
            and wanted <= mounted
        )


def _type_of(topic: str) -> str | None:
    """The message type a topic of a mission has."""
    if topic == messages.TF_STATIC:
        return messages.TF_STATIC_TYPE
    if topic == messages.ROBOTS:
        return messages.ROBOTS_TYPE
    _, _, suffix = topic.removeprefix("/").partition("/")
    return next((known.msgtype for known in messages.ROBOT_TOPICS if known.suffix == suffix), None)


def _until_odometry(log: RobotLog, margin_s: float) -> RobotLog:
    """A log without what its odometry does not reach yet: messages overtake one another on the way."""
    begin_s, end_s = float(log.odometry.time_s[0]), float(log.odometry.time_s[-1]) - margin_s

    def cut(time_s: np.ndarray) -> np.ndarray:
        return (time_s >= begin_s) & (time_s <= end_s)

    csi = {}
    for peer, track in log.csi.items():
        kept = cut(track.time_s)
        csi[peer] = replace(
            track,
            time_s=track.time_s[kept],
            frame_counter=track.frame_counter[kept],
            channel=track.channel[kept],
        )
    ranges = {}
    for peer, track in log.ranges.items():
        kept = cut(track.time_s)
        ranges[peer] = replace(
            track,
            time_s=track.time_s[kept],
            range_m=track.range_m[kept],
            sigma_m=track.sigma_m[kept],
        )
    photos = tuple(photo for photo in log.photos if begin_s <= photo.time_s <= end_s)
    return replace(log, photos=photos, csi=csi, ranges=ranges)


def _among(log: RobotLog, present: Mapping[str, RobotLog]) -> RobotLog:
    """A log without what it heard of robots that are not there, or of packets none of which was answered."""
    answered = {
        peer: track
        for peer, track in log.csi.items()
        if len(track.time_s) and peer in present and log.name in present[peer].csi
        if len(present[peer].csi[log.name].time_s)
    }
    ranges = {peer: track for peer, track in log.ranges.items() if peer in present and len(track.time_s)}
    return replace(log, csi=answered, ranges=ranges)
