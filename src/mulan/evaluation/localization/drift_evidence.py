"""Odometry's drift and scale, told by the radio alone: those under which the measurements are likeliest.

The graph's poses are integrated out (Laplace's approximation), as in type-II maximum likelihood; no truth is
used. Too little drift leaves large residuals, too much leaves the poses undetermined. A monocular camera also
gets the scale of its whole path wrong by some per cent, which no random walk describes.

Searched are the position drift, common to all robots, and each robot's scale. The rotation drift stays as
configured: over such flights turning and sliding can hardly be told apart by radio.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.graph import (
    LocalizationConfig,
    LocalizationGraph,
    bearing_node_factor,
    build_graph,
    observed_in_body,
    range_node_factor,
)
from mulan.localization.solve import Solution
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing, Range

_LEAST_TRUST = 0.02
_STEPS = (np.log(1.5), 0.01)  # of the logarithm of the drift, and of a scale
_PRIOR_SIGMA = (np.log(3.0), 0.03)
_SWEEPS = 2


@dataclass(frozen=True)
class LikeliestOdometry:
    """What the radio says of the odometry.

    Attributes:
        config: Localization options with the position drift found.
        scale: Factor on each robot's path.
        robots: Logs with their paths scaled.
        graph: Of those.
        values: Poses it was last linearised about.
    """

    config: LocalizationConfig
    scale: Mapping[str, float]
    robots: tuple[RobotLog, ...]
    graph: LocalizationGraph
    values: gtsam.Values


def scaled(robot: RobotLog, scale: float) -> RobotLog:
    """The log with its dead reckoning's positions multiplied."""
    T = robot.odometry.T_odom_body.copy()
    T[:, :3, 3] *= scale
    return replace(robot, odometry=replace(robot.odometry, T_odom_body=T))


def _measured(graph: LocalizationGraph, solution: Solution) -> gtsam.NonlinearFactorGraph:
    """Radio factors with the trust and hypotheses of a solution."""
    factors = gtsam.NonlinearFactorGraph()
    for node, trust, k in zip(graph.bearings, solution.bearing_inlier, solution.hypothesis, strict=True):
        if trust > _LEAST_TRUST:
            noise = gtsam.noiseModel.Gaussian.Covariance(observed_in_body(node, int(k))[2] / trust)
            factors.add(bearing_node_factor(node, int(k), noise))
    for node, trust in zip(graph.ranges, solution.range_inlier, strict=True):
        if trust > _LEAST_TRUST:
            sigma_m = node.measurement.sigma_m / np.sqrt(trust)
            factors.add(range_node_factor(node, gtsam.noiseModel.Isotropic.Sigma(1, sigma_m)))
    return factors


def log_evidence(
    graph: LocalizationGraph, solution: Solution, values: gtsam.Values
) -> tuple[float, gtsam.Values]:
    """Log probability of the measurements, poses integrated out, and the poses it was taken about."""
    factors = graph.motion_factors()
    factors.push_back(_measured(graph, solution))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(15)
    parameters.setRelativeErrorTol(1e-4)
    values = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters).optimize()
    tree = factors.linearize(values).eliminateMultifrontal()
    steps = [np.linalg.slogdet(k.step_covariance)[1].sum() for k in graph.robots.values()]
    return -factors.error(values) - float(tree.logDeterminant()) - 0.5 * float(np.sum(steps)), values


def _climbed(
    objective: Callable[[Float[NDArray, "d"]], float], start: Float[NDArray, "d"], step: Float[NDArray, "d"]
) -> Float[NDArray, "d"]:
    """Coordinates one after another to the top of the parabola through three points, at most two steps."""
    at, height = start, objective(start)
    for _ in range(_SWEEPS):
        for axis in range(len(at)):
            unit = np.zeros(len(at))
            unit[axis] = step[axis]
            below, above = objective(at - unit), objective(at + unit)
            bend = 2 * height - below - above
            move = (above - below) / (2 * bend) if bend > 0 else 2.0 * np.sign(above - below)
            candidates = {0.0: height, -1.0: below, 1.0: above}
            move = float(np.clip(move, -2, 2))
            candidates[move] = objective(at + move * unit)
            best = max(candidates, key=lambda m: candidates[m])
            at, height = at + best * unit, candidates[best]
    return at


def likeliest_odometry(
    robots: Sequence[RobotLog],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    solution: Solution,
    config: LocalizationConfig,
) -> LikeliestOdometry:
    """Position drift and scales most probable given the radio measurements that a solution trusts."""
    values = solution.values
    begin = np.array([np.log(config.odometry_noise.translation_percent), *np.ones(len(robots))])

    def built(x: Float[NDArray, "d"]) -> tuple[LocalizationConfig, tuple[RobotLog, ...], LocalizationGraph]:
        noise = replace(config.odometry_noise, translation_percent=float(np.exp(x[0])))
        options = replace(config, odometry_noise=noise)
        logs = tuple(scaled(robot, float(s)) for robot, s in zip(robots, x[1:], strict=True))
        return options, logs, build_graph(logs, bearings, ranges, options)

    def posterior(x: Float[NDArray, "d"]) -> float:
        nonlocal values
        evidence, values = log_evidence(built(x)[2], solution, values)
        return evidence - 0.5 * float((((x - begin) / spread) ** 2).sum())

    step, spread = (np.array([pair[0], *np.full(len(robots), pair[1])]) for pair in (_STEPS, _PRIOR_SIGMA))
    best = _climbed(posterior, begin, step)
    options, logs, graph = built(best)
    scale = {robot.name: float(s) for robot, s in zip(robots, best[1:], strict=True)}
    return LikeliestOdometry(options, scale, logs, graph, values)
