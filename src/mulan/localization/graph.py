"""The factor graph over all robots' keyframes: odometry, gravity, bearings, ranges."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.localization.factors import Sight, bearing_factor, line_of_sight, observed_basis, range_factor
from mulan.localization.initialization import InitializationConfig
from mulan.localization.keyframes import (
    Keyframes,
    OdometryNoise,
    keyframe_times,
    make_keyframes,
    measurement_times,
)
from mulan.localization.lies import TrustConfig
from mulan.localization.odometry_correction import OdometryLearningConfig
from mulan.localization.relative_measurements import bearing_origin, bearing_targets, range_endpoints
from mulan.mission.types import RobotLog
from mulan.wireless.ranging import RangingConfig
from mulan.wireless.types import Bearing, Range

_KEYS_PER_ROBOT = 10_000_000
_BIAS_KEYS = 10**15
_ANCHOR_SIGMA = 1e-6


@dataclass(frozen=True)
class LocalizationConfig:
    """How bearings, ranges and odometry become poses."""

    gravity_aligned: bool = True
    """Odometry knows the vertical (visual-inertial): 4 unknowns a robot; off gives 6."""
    gravity_sigma_deg: float = 0.05
    """Agreement of two robots' verticals, one sigma."""
    common_floor_sigma_m: float | None = None
    """All robots' bodies share one height within this (ground robots); none means they may fly."""
    range_bias_sigma_m: float = 0.03
    """Constant offset of each pair of UWB radios, one sigma."""
    range_outlier_mass: float = 0.05
    """Prior probability that a range took a detour."""
    keyframe_merge_s: float = 0.25
    """A measurement this close to a keyframe hangs on it instead of making its own."""
    ranging: RangingConfig = field(default_factory=RangingConfig)
    """How ranges are thinned."""
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Drift assumed where the odometry reports none."""
    initialization: InitializationConfig = field(default_factory=InitializationConfig)
    """How start frames are found."""
    trust: TrustConfig = field(default_factory=TrustConfig)
    """When a robot is called a liar."""
    odometry_learning: OdometryLearningConfig = field(default_factory=OdometryLearningConfig)
    """Whether the odometry's scale and noise are learned."""
    photo_keyframe_every_m: float = 0.0
    """Photographs nearer than this (and than the next) to the last keyframe get interpolated poses."""
    photo_keyframe_every_s: float = 0.0
    """The same in seconds; zero in either makes every photograph a keyframe."""
    most_joint_photographs: int = 400
    """The covariance of all photographs together, which refining their poses needs, is kept up to so many:
    its size grows with their square."""


@dataclass(frozen=True)
class BearingNode:
    """A bearing tied to two poses; directions are in the observer keyframe's body axes."""

    bearing: Bearing
    sight: Sight
    R_body_odom: Float[NDArray, "3 3"]


@dataclass(frozen=True)
class RangeNode:
    """A range tied to two poses and the bias of its pair."""

    measurement: Range
    sight: Sight
    bias_key: int


@dataclass(frozen=True)
class LocalizationGraph:
    """What the graph joins; noise models are added when it is solved.

    Attributes:
        robots: Keyframes by name, the anchor first.
        bearings, ranges: Measurements with their keys.
        bias_keys: One a pair of robots.
        config: Options.
        photographs: What refined photographs say of the keyframes at them, if they were handed in.
    """

    robots: Mapping[str, Keyframes]
    bearings: tuple[BearingNode, ...]
    ranges: tuple[RangeNode, ...]
    bias_keys: tuple[int, ...]
    config: LocalizationConfig
    photographs: gtsam.NonlinearFactor | None = None

    def key(self, robot: str, index: int) -> int:
        """Key of a keyframe."""
        return list(self.robots).index(robot) * _KEYS_PER_ROBOT + index

    def initial(self, T_world_odom: Mapping[str, Float[NDArray, "4 4"]]) -> gtsam.Values:
        """Dead reckoning through the start frames."""
        values = gtsam.Values()
        for name, keyframes in self.robots.items():
            for i, T in enumerate(T_world_odom[name] @ keyframes.T_odom_body):
                values.insert(self.key(name, i), gtsam.Pose3(T))
        for key in self.bias_keys:
            values.insert(key, np.zeros(1))
        return values

    def motion_factors(self) -> gtsam.NonlinearFactorGraph:
        """Odometry, gravity, the anchor's first pose, floor, biases, photographs: all without outliers."""
        graph = gtsam.NonlinearFactorGraph()
        config = self.config
        anchor = next(iter(self.robots.values()))
        tight = gtsam.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
        graph.add(
            gtsam.PriorFactorPose3(self.key(anchor.robot, 0), gtsam.Pose3(anchor.T_odom_body[0]), tight)
        )
        up = np.array([0.0, 0.0, 1.0])
        for name, keyframes in self.robots.items():
            steps = se3.inverse(keyframes.T_odom_body[:-1]) @ keyframes.T_odom_body[1:]
            for i, (T, covariance) in enumerate(zip(steps, keyframes.step_covariance, strict=True)):
                noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
                key, following = self.key(name, i), self.key(name, i + 1)
                graph.add(gtsam.BetweenFactorPose3(key, following, gtsam.Pose3(T), noise))
            if config.gravity_aligned:
                variance = keyframes.tilt_variance_rad2 + np.deg2rad(config.gravity_sigma_deg) ** 2
                for i, T in enumerate(keyframes.T_odom_body):
                    noise = gtsam.noiseModel.Isotropic.Variance(2, float(variance[i]))
                    seen_up = gtsam.Unit3(T[:3, :3].T @ up)
                    graph.add(gtsam.AttitudeFactorPose3(self.key(name, i), gtsam.Unit3(up), noise, seen_up))
            if config.common_floor_sigma_m is not None:
                floor_m = anchor.T_odom_body[0, :3, 3] * up
                # only the height counts: a kilometre of sigma leaves the plane free
                noise = gtsam.noiseModel.Diagonal.Sigmas(
                    np.array([1e3, 1e3, max(config.common_floor_sigma_m, 1e-4)])
                )
                for i in range(len(keyframes.time_s)):
                    graph.add(gtsam.PoseTranslationPrior3D(self.key(name, i), floor_m, noise))
        bias = gtsam.noiseModel.Isotropic.Sigma(1, max(config.range_bias_sigma_m, 1e-6))
        for key in self.bias_keys:
            graph.add(gtsam.PriorFactorVector(key, np.zeros(1), bias))
        if self.photographs is not None:
            graph.add(self.photographs)
        return graph


def observed_in_body(
    node: BearingNode, hypothesis: int
) -> tuple[Float[NDArray, "3"], Float[NDArray, "3 d"], Float[NDArray, "d d"]]:
    """Direction, tangent columns and covariance of one hypothesis in the observer keyframe's body axes."""
    bearing = node.bearing
    u, basis, covariance = observed_basis(
        bearing.direction_odom[hypothesis], bearing.tangent_covariance[hypothesis]
    )
    return node.R_body_odom @ u, node.R_body_odom @ basis, covariance


def bearing_node_factor(
    node: BearingNode, hypothesis: int, noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """The factor of one hypothesis."""
    u, basis, _ = observed_in_body(node, hypothesis)
    return bearing_factor(node.sight, u, basis, noise)


def range_node_factor(node: RangeNode, noise: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
    """The factor of one range."""
    return range_factor(node.sight, node.bias_key, node.measurement.range_m, noise)


def sight_vector(values: gtsam.Values, sight: Sight) -> Float[NDArray, "3"]:
    """From the observer's point to the peer's, in the observer's body axes."""
    observer, peer = values.atPose3(sight.observer_key), values.atPose3(sight.peer_key)
    return line_of_sight(observer.matrix(), peer.matrix(), sight)[0]


def build_graph(
    robots: Sequence[RobotLog],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    config: LocalizationConfig,
) -> LocalizationGraph:
    """Choose keyframes and hang every measurement on the nearest ones.

    A measurement's points are carried to the keyframe by the robot's own odometry, so a keyframe need not
    fall on its instant.

    Raises:
        InputError: A photograph lies outside its robot's odometry.
    """
    logs = {robot.name: robot for robot in robots}
    order = list(logs)
    keyframes = {
        robot.name: make_keyframes(
            robot,
            keyframe_times(
                robot,
                measurement_times(robot.name, bearings, ranges),
                config.keyframe_merge_s,
                config.photo_keyframe_every_m,
                config.photo_keyframe_every_s,
            ),
            config.odometry_noise,
            config.gravity_aligned,
        )
        for robot in robots
    }

    def hang(name: str, time_s: float, point_odom_m: NDArray) -> tuple[int, NDArray]:
        index = keyframes[name].nearest(time_s)
        return index, keyframes[name].point_in_keyframe(index, point_odom_m)

    def sight(observer: tuple[str, float, NDArray], peer: tuple[str, float, NDArray]) -> tuple[Sight, int]:
        i, a = hang(*observer)
        j, b = hang(*peer)
        keys = [order.index(name) * _KEYS_PER_ROBOT + k for name, k in ((observer[0], i), (peer[0], j))]
        return Sight(keys[0], keys[1], a, b), i

    bearing_nodes = []
    for bearing, peer_point in zip(bearings, bearing_targets(logs, bearings), strict=True):
        observer, peer = logs[bearing.observer], logs[bearing.peer]
        joined, index = sight(
            (observer.name, bearing.time_s, bearing_origin(bearing, observer)),
            (peer.name, bearing.peer_time_s, peer_point),
        )
        R_body_odom = keyframes[observer.name].T_odom_body[index, :3, :3].T
        bearing_nodes.append(BearingNode(bearing, joined, R_body_odom))
    pairs = sorted({tuple(sorted((r.observer, r.peer))) for r in ranges})
    bias_key = {pair: _BIAS_KEYS + i for i, pair in enumerate(pairs)}
    range_nodes = []
    peer_s, observer_odom_m, peer_odom_m = range_endpoints(logs, ranges, bearings)
    for i, r in enumerate(ranges):
        joined, _ = sight(
            (r.observer, r.time_s, observer_odom_m[i]), (r.peer, float(peer_s[i]), peer_odom_m[i])
        )
        range_nodes.append(RangeNode(r, joined, bias_key[tuple(sorted((r.observer, r.peer)))]))
    return LocalizationGraph(
        keyframes, tuple(bearing_nodes), tuple(range_nodes), tuple(bias_key.values()), config
    )
