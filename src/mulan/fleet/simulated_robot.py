"""A robot of a simulated world: it goes where the base station wants it, and sends what it records."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mulan.errors import InputError
from mulan.fleet.message_choice import MessageChoice
from mulan.fleet.orders import goal_of
from mulan.fleet.replay import RecordingClock, Replay, ReplayConfig
from mulan.fleet.robot_link import RobotLink
from mulan.fleet.world_folder import WorldFolder
from mulan.geometry import se3
from mulan.mission.run_folder import write_json

_LOOK_EVERY_S = 0.05


class GoalInbox:
    """The goal a robot has not gone to yet.

    Attributes:
        received: Different goals that came.
    """

    def __init__(self) -> None:
        self.received = 0
        self._lock = threading.Lock()
        self._waiting: Any | None = None
        self._last_stamp: tuple[int, int] | None = None

    def put(self, message: Any) -> None:
        """Take a goal in; one that is repeated is no new one."""
        stamp = int(message.header.stamp.sec), int(message.header.stamp.nanosec)
        with self._lock:
            if stamp != self._last_stamp:
                self._last_stamp, self._waiting = stamp, message
                self.received += 1

    def take(self) -> Any | None:
        """The newest goal nobody took; None without one."""
        with self._lock:
            message, self._waiting = self._waiting, None
            return message


class RequestInbox:
    """Whether the robot should move its antenna now.

    Attributes:
        received: Different requests that came.
    """

    def __init__(self) -> None:
        self.received = 0
        self._lock = threading.Lock()
        self._peers: tuple[str, ...] = ()
        self._last_stamp: tuple[int, int] | None = None

    def put(self, message: Any) -> None:
        """Take a request in; one that is repeated is no new one."""
        stamp = int(message.header.stamp.sec), int(message.header.stamp.nanosec)
        with self._lock:
            if stamp != self._last_stamp:
                self._last_stamp, self._peers = stamp, tuple(message.peers)
                self.received += 1

    def take(self) -> bool:
        """Whether to measure; a request is answered once. Who was never told anything always measures."""
        with self._lock:
            asked = self._last_stamp is None or bool(self._peers)
            self._peers = ()
            return asked


class SimulatedRobot(Replay):
    """Sends what its sensors record leg by leg; between two legs it says where it wants to go.

    Goals come in its odometry frame, and it goes there by its odometry, as a robot on real wheels would.
    Started again, it sends on where it was and takes part in the leg that comes next.
    """

    def __init__(
        self,
        world: Path,
        config: ReplayConfig,
        choice: MessageChoice,
        link: RobotLink,
        clock: RecordingClock,
        goals: GoalInbox,
        requests: RequestInbox,
    ) -> None:
        """Prepare.

        Args:
            world: Folder of the world.
            config: Pace.
            choice: What of the recordings is sent.
            link: Link to the base station.
            clock: The mission's time.
            goals: Where the link puts goals.
            requests: Where it puts requests to measure.
        """
        super().__init__(config, choice, link, clock)
        self._world, self._goals, self._requests = WorldFolder(world), goals, requests

    def _bags(self, stop: Callable[[], bool]) -> Iterator[Path]:
        name, number, said = self._link.config.name, 0, -1
        while not stop():
            leg = self._world.leg(number)
            if leg.exists():
                bag = leg / f"{name}.mcap"
                number += 1
                if bag.exists():
                    yield bag
            elif self._world.over.exists():
                return
            else:
                if said != number and number:
                    said = number
                    wish = {"T_here_body": self._wanted(), "measures": self._requests.take()}
                    write_json(self._world.wish(name, number), wish)
                time.sleep(_LOOK_EVERY_S)

    def _wanted(self) -> list[list[float]] | None:
        """The goal's pose in the body's frame; None without a goal that can be understood."""
        message = self._goals.take()
        if message is None or self.choice.last_pose is None:
            return None
        try:
            return (se3.inverse(self.choice.last_pose) @ goal_of(message)).tolist()
        except ValueError:
            return None


class WorldClock:
    """Mission time, which begins with this process's robot in the world and goes as fast as told.

    Messages are stamped when they were recorded; a world that computes slower than the clock makes them late,
    never early.
    """

    def __init__(self, world: Path, speed: float) -> None:
        """Read when the world began.

        Raises:
            InputError: There is no world, or the speed is not positive.
        """
        path = WorldFolder(world).world
        if not path.is_file():
            raise InputError(path, "file", "does not exist", "start 'mulan fleet world' and wait for it")
        if speed <= 0:
            raise InputError("robot", "speed", "is not positive", "give 1 for real time")
        self._speed, self._began_ns = speed, path.stat().st_mtime_ns

    def now_ns(self) -> int:
        """Mission time now."""
        return int((time.time_ns() - self._began_ns) * self._speed)

    def wait_until(self, log_ns: int, stop: Callable[[], bool]) -> None:
        """Sleep until mission time has come to a message's."""
        while not stop():
            left_s = (log_ns - self.now_ns()) * 1e-9 / self._speed
            if left_s <= 0:
                return
            time.sleep(min(left_s, 0.2))
