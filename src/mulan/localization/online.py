"""Localization while robots move: every keyframe and every radio measurement updates the poses."""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.initialization import align_robot
from mulan.localization.online_estimate import OnlineEstimate
from mulan.localization.online_hanging import hang_bearing, hang_range, keyframes_of
from mulan.localization.online_robot import OnlineRobot
from mulan.localization.sliding_window import SlidingWindow
from mulan.localization.window_measurements import OnlineMeasurement
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing, Range

_KEYS_PER_ROBOT = 10_000_000
_BIAS_KEYS = 10**15
_ANCHOR_SIGMA = 1e-6
_CLOCK_SAMPLES = 25
_FRESHLY_ALIGNED_M = 0.5  # spread of predictions about a robot the search has just placed


@dataclass(frozen=True)
class OnlineConfig:
    """How the poses follow the measurements."""

    graph: LocalizationConfig = field(default_factory=LocalizationConfig)
    """Factors, shared with the batch solution."""
    horizon_s: float = 40.0
    """Keyframes and measurements of so many last seconds are solved anew at every update."""
    alignment_window_s: float = 300.0
    """A robot is placed by its measurements of so many last seconds."""
    lost_m: float = 1.0
    """A gap in the odometry that may hide a larger drift makes the robot wait for a new alignment."""
    lost_rad: float = 0.3
    """The same for its heading."""
    longest_gap_s: float = 3.0
    """A measurement in a longer gap between keyframes hangs on none and is dropped."""
    silent_updates: int = 30
    """A robot without keyframes for so many updates keeps the covariance it had."""


class OnlineLocalization:
    """Any number of robots in the anchor's start frame, updated as their messages come.

    The first robot added is the anchor. A robot is waiting until its bearings and ranges fix its start frame;
    what it sent until then is kept and joins the graph with it. A robot that falls silent keeps its poses and
    goes on from them when it returns, or, when its odometry may have drifted too far meanwhile, waits for a
    new alignment. Odometry must run on in one start frame: a robot that was switched off and on is a new one.

    Attributes:
        config: Options.
        robots: By name, the anchor first.
        bearings, ranges: All that came.
        dropped: Measurements that fell into gaps between keyframes.
        late: Measurements that came when their keyframes had left the window; the batch solution has them.
    """

    def __init__(self, config: OnlineConfig | None = None) -> None:
        self.config = config or OnlineConfig()
        self.robots: dict[str, OnlineRobot] = {}
        self.bearings: list[Bearing] = []
        self.ranges: list[Range] = []
        self.dropped = 0
        self.late = 0
        self._held: list[Bearing | Range] = []
        self._bias_keys: dict[tuple[str, ...], int] = {}
        self._clock_offset_s: dict[tuple[str, str], deque[float]] = {}
        self._tried: dict[str, int] = {}
        self._why: dict[str, str] = {}
        self._aligned: dict[str, Float[NDArray, "4 4"]] = {}
        self._quiet: dict[str, int] = {}
        self._estimate = OnlineEstimate((), {}, {}, {}, np.zeros((0, 0)), (), {})
        self._updates = 0
        self._window = SlidingWindow(self.config.graph.range_outlier_mass)

    def add_robot(self, log: RobotLog) -> None:
        """Announce a robot: its name, lever arms and calibration; what its log recorded is not read.

        Raises:
            InputError: The name is taken.
        """
        if log.name in self.robots:
            raise InputError(
                f"robot '{log.name}'", "name", "is already there", "give each robot its own name"
            )
        waiting_from = 0 if self.robots else None
        self.robots[log.name] = OnlineRobot(
            log, len(self.robots) * _KEYS_PER_ROBOT, waiting_from=waiting_from
        )
        self._why[log.name] = "there are no bearings or ranges to a placed robot yet"
        self._quiet[log.name] = 0

    def add_keyframe(
        self,
        robot: str,
        time_s: float,
        T_odom_body: Float[NDArray, "4 4"],
        covariance: Float[NDArray, "6 6"] | None = None,
    ) -> None:
        """A robot's dead reckoning at an instant of its clock.

        Args:
            robot: Name.
            time_s: Later than its last keyframe.
            T_odom_body: In its own start frame.
            covariance: Accumulated since the start (right perturbation); None assumes the configured drift.

        Raises:
            InputError: The robot is unknown, or the keyframe is not finite or not after its last one.
        """
        chain = self._robot(robot)
        chain.add(time_s, T_odom_body, covariance, self.config.graph, self._updates)
        self._quiet[robot] = 0
        sigma = np.sqrt(np.diag(chain.step_covariance[-1]))
        if chain.placed and (sigma[3:].max() > self.config.lost_m or sigma[:3].max() > self.config.lost_rad):
            chain.waiting_from = len(chain.time_s) - 1
            self._why[robot] = "its odometry may have drifted too far while it was silent"

    def add_bearing(self, bearing: Bearing) -> None:
        """A direction one robot measured to another.

        Raises:
            InputError: A robot is unknown.
        """
        pair = self._robot(bearing.observer).name, self._robot(bearing.peer).name
        self.bearings.append(bearing)
        self._held.append(bearing)
        offsets = self._clock_offset_s.setdefault(pair, deque(maxlen=_CLOCK_SAMPLES))
        offsets.append(bearing.peer_time_s - bearing.time_s)

    def add_range(self, measurement: Range) -> None:
        """A distance two robots measured.

        Raises:
            InputError: A robot is unknown.
        """
        pair = tuple(sorted((self._robot(measurement.observer).name, self._robot(measurement.peer).name)))
        self._bias_keys.setdefault(pair, _BIAS_KEYS + len(self._bias_keys))
        self.ranges.append(measurement)
        self._held.append(measurement)

    def update(self) -> OnlineEstimate:
        """Take in all that came since the last update; newest poses and covariances of every placed robot."""
        joined = self._place_one()
        self._updates += 1
        for robot in self.robots.values():
            if robot.placed:
                self._extend(robot)
        self._hang_held()
        known = [robot for robot in self.robots.values() if robot.in_graph]
        heard = [robot for robot in known if self._quiet[robot.name] <= self.config.silent_updates]
        for name in self._quiet:
            self._quiet[name] += 1
        if not heard:
            return self._estimate
        keys = tuple(robot.key(robot.in_graph - 1) for robot in heard)
        joint = self._window.settle(keys, joined)
        self._estimate = self._newest(known, heard, keys, joint)
        self._forget_old(known)
        return self._estimate

    @property
    def window_keyframes(self) -> int:
        """Keyframes solved anew at every update."""
        return len(self._window)

    @property
    def estimate(self) -> OnlineEstimate:
        """As the last update left it."""
        return self._estimate

    def trajectories(self) -> dict[str, Float[NDArray, "n 4 4"]]:
        """Poses of every keyframe of the placed robots in the anchor's start frame.

        Those in the window are as the last update left them, older ones as they were when they left it; those
        from before the robot joined follow its odometry back from there.
        """
        found = {}
        for name, robot in self.robots.items():
            if not robot.in_graph:
                continue
            recent = [
                self._window.values.atPose3(robot.key(i)).matrix()
                for i in range(robot.oldest, robot.in_graph)
            ]
            solved = np.array([*robot.T_world_body, *recent])
            first = robot.first_solved
            back = solved[0] @ se3.inverse(robot.T_odom_body[first])
            earlier = [back @ T for T in robot.T_odom_body[:first]]
            found[name] = np.array([*earlier, *solved])
        return found

    def peer_time_s(self, measurement: Bearing | Range) -> float:
        """A measurement's instant on the peer's clock."""
        if isinstance(measurement, Bearing):
            return measurement.peer_time_s
        pair = measurement.observer, measurement.peer
        offsets = list(self._clock_offset_s.get(pair, ()))
        back = measurement.peer, measurement.observer
        offsets += [-offset for offset in self._clock_offset_s.get(back, ())]
        return measurement.time_s + (float(np.median(offsets)) if offsets else 0.0)

    def _robot(self, name: str) -> OnlineRobot:
        if name not in self.robots:
            raise InputError(f"robot '{name}'", "name", "is unknown", "announce it by add_robot first")
        return self.robots[name]

    def _place_one(self) -> bool:
        """Try to align the waiting robot with the most new measurements; one search an update."""
        open_ends = {name: 0 for name, robot in self.robots.items() if not robot.placed and robot.time_s}
        if not open_ends:
            return False
        for m in self._held:
            for name, other in ((m.observer, m.peer), (m.peer, m.observer)):
                if name in open_ends and self.robots[other].placed and self.robots[other].in_graph:
                    open_ends[name] += 1
        news = {name: count - self._tried.get(name, 0) for name, count in open_ends.items()}
        name = max(news, key=lambda n: news[n])
        if news[name] <= 0:
            return False
        self._tried[name] = open_ends[name]
        try:
            self._aligned[name] = self._align(self.robots[name])
        except InputError as error:
            self._why[name] = f"{error.field} {error.problem}"
            return False
        self.robots[name].waiting_from = None
        self._tried.pop(name)
        return True

    def _align(self, robot: OnlineRobot) -> Float[NDArray, "4 4"]:
        assert robot.waiting_from is not None
        since_s = max(robot.time_s[robot.waiting_from], robot.time_s[-1] - self.config.alignment_window_s)

        def recent(m: Bearing | Range) -> bool:
            own_s = m.time_s if m.observer == robot.name else self.peer_time_s(m)
            other = self.robots[m.peer if m.observer == robot.name else m.observer]
            other_s = self.peer_time_s(m) if m.observer == robot.name else m.time_s
            known = other.placed and other.in_graph and other.time_s[0] <= other_s
            return bool(known) and since_s <= own_s

        mine = [m for m in self._held if robot.name in (m.observer, m.peer) and recent(m)]
        used_s: dict[str, float] = {}
        for m in mine:
            for name, time_s in ((m.observer, m.time_s), (m.peer, self.peer_time_s(m))):
                used_s[name] = min(time_s, used_s.get(name, np.inf))
        logs = {}
        for name, time_s in used_s.items():
            chain = self.robots[name]
            logs[name] = chain.recorded(max(bisect_left(chain.time_s, time_s) - 2, 0), len(chain.time_s))
        anchor = next(iter(self.robots.values()))
        config = self.config.graph
        return align_robot(
            logs.pop(robot.name, robot.log),
            anchor.recorded(0, 1),
            {name: (log, self._T_world_odom(self.robots[name])) for name, log in logs.items()},
            [m for m in mine if isinstance(m, Bearing)],
            [m for m in mine if isinstance(m, Range)],
            config.initialization,
            config.gravity_aligned,
            config.common_floor_sigma_m,
        )

    def _T_world_odom(self, robot: OnlineRobot) -> Float[NDArray, "4 4"]:
        """Start frame by the newest pose the solver has."""
        last = robot.in_graph - 1
        T = self._window.values.atPose3(robot.key(last)).matrix()
        return T @ se3.inverse(robot.T_odom_body[last])

    def _extend(self, robot: OnlineRobot) -> None:
        """New keyframes of a placed robot, started where its odometry leads."""
        begin, end = robot.in_graph, len(robot.time_s)
        if begin == end:
            return
        anchor = next(iter(self.robots.values()))
        T_world_odom = self._aligned.pop(robot.name, None)
        if begin == 0:
            if T_world_odom is None:
                T_world_odom = np.eye(4)
            # of a long wait only the end is solved here; the batch solution takes all of it
            begin = bisect_left(robot.time_s, robot.time_s[-1] - self.config.horizon_s)
            robot.first_solved = robot.oldest = begin
        elif T_world_odom is None:
            T_world_odom = self._T_world_odom(robot)
        floor_m = float(anchor.T_odom_body[0][2, 3]) if anchor.time_s else 0.0
        for i in range(begin, end):
            factors = robot.motion_factors(i, self.config.graph, floor_m)
            if robot is anchor and i == 0:
                tight = gtsam.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
                factors.append(gtsam.PriorFactorPose3(robot.key(0), gtsam.Pose3(robot.T_odom_body[0]), tight))
            pose = gtsam.Pose3(T_world_odom @ robot.T_odom_body[i])
            self._window.add_keyframe(robot.key(i), robot.received[i], pose, factors)
        robot.in_graph = end

    def _hang_held(self) -> None:
        """Tie held measurements between placed robots to their keyframes."""
        kept: list[Bearing | Range] = []
        for m in self._held:
            observer, peer = self.robots[m.observer], self.robots[m.peer]
            if not (observer.placed and peer.placed):
                kept.append(m)
                continue
            peer_s = self.peer_time_s(m)
            merge_s = self.config.graph.keyframe_merge_s
            try:
                at = keyframes_of(m, peer_s, self.robots, merge_s, self.config.longest_gap_s)
            except LookupError:
                self.dropped += 1
                continue
            if at is None:
                kept.append(m)
                continue
            if at[0] < observer.oldest or at[1] < peer.oldest:
                self.late += 1
                continue
            if isinstance(m, Bearing):
                node = hang_bearing(m, observer, peer, at)
            else:
                bias_key = self._bias_keys[tuple(sorted((m.observer, m.peer)))]
                node = hang_range(m, peer_s, observer, peer, at, bias_key)
                if not self._window.values.exists(bias_key):
                    sigma_m = max(self.config.graph.range_bias_sigma_m, 1e-6)
                    noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma_m)
                    self._window.add_bias(bias_key, gtsam.PriorFactorVector(bias_key, np.zeros(1), noise))
            self._window.add(OnlineMeasurement(node, self._predicted(m, at)))
        self._held = kept

    def _forget_old(self, known: list[OnlineRobot]) -> None:
        """Keyframes beyond the horizon leave the window; of a silent robot all but the newest."""
        gone = []
        for robot in known:
            newest = robot.in_graph - 1
            end = bisect_left(robot.time_s, robot.time_s[newest] - self.config.horizon_s)
            if self._quiet[robot.name] > self.config.silent_updates:
                end = newest
            for i in range(robot.oldest, min(end, newest)):
                gone.append(robot.key(i))
                robot.T_world_body.append(self._window.values.atPose3(robot.key(i)).matrix())
            robot.oldest = max(robot.oldest, min(end, newest))
        self._window.forget(gone)

    def _predicted(self, m: Bearing | Range, at: tuple[int, int]) -> Float[NDArray, "12 12"]:
        """Joint covariance of a new measurement's two poses, from the last update on by odometry."""
        pair = m.observer, m.peer
        if not set(pair) <= set(self._estimate.names):
            spread = np.array([0.1, 0.1, 0.1] + [_FRESHLY_ALIGNED_M] * 3) ** 2
            return np.diag(np.concatenate([spread, spread]))
        covariance = self._estimate.pair_covariance(*pair)
        carry, added = np.zeros((12, 12)), np.zeros((12, 12))
        for block, name, index in ((slice(0, 6), pair[0], at[0]), (slice(6, 12), pair[1], at[1])):
            robot = self.robots[name]
            last = self._estimate.keys[self._estimate.names.index(name)] - robot.first_key
            carry[block, block], added[block, block] = robot.drift(last, index)
        return carry @ covariance @ carry.T + added

    def _newest(
        self,
        known: list[OnlineRobot],
        heard: list[OnlineRobot],
        keys: tuple[int, ...],
        joint: Float[NDArray, "n n"],
    ) -> OnlineEstimate:
        covariance = dict(self._estimate.covariance)
        for i, robot in enumerate(heard):
            covariance[robot.name] = joint[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        newest = {robot.name: robot.in_graph - 1 for robot in known}
        return OnlineEstimate(
            tuple(robot.name for robot in heard),
            {robot.name: robot.time_s[newest[robot.name]] for robot in known},
            {r.name: self._window.values.atPose3(r.key(newest[r.name])).matrix() for r in known},
            covariance,
            joint,
            keys,
            {name: self._why[name] for name, robot in self.robots.items() if not robot.placed},
        )
