"""How much odometry drifts, told by the radio alone: the noise under which the measurements are likeliest.

The graph's poses are integrated out (Laplace's approximation), as in type-II maximum likelihood; no truth is
used. Too little noise leaves large residuals, too much leaves the poses undetermined. A broad prior about the
configured noise decides what the radio cannot tell (turning from sliding, on short flights).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from mulan.localization.graph import (
    LocalizationConfig,
    LocalizationGraph,
    bearing_node_factor,
    observed_in_body,
    range_node_factor,
)
from mulan.localization.keyframes import OdometryNoise, make_keyframes
from mulan.localization.solve import Solution
from mulan.mission.types import RobotLog

_LEAST_TRUST = 0.02
_FACTORS = (2.0, 1.4)
_PRIOR_LOG_SIGMA = np.log(2.0)  # odometry of one kind differs by such a factor


@dataclass(frozen=True)
class DriftEvidence:
    """The drift most probable given the radio.

    Attributes:
        noise: Odometry noise of all robots.
        log_evidence: Of every (rotation, translation) tried, up to a constant and without the prior.
    """

    noise: OdometryNoise
    log_evidence: Mapping[tuple[float, float], float]


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


def with_noise(
    graph: LocalizationGraph, robots: Sequence[RobotLog], noise: OdometryNoise, config: LocalizationConfig
) -> LocalizationGraph:
    """The same graph with another odometry noise."""
    keyframes = {
        robot.name: make_keyframes(robot, graph.robots[robot.name].time_s, noise, config.gravity_aligned)
        for robot in robots
    }
    return replace(graph, robots=keyframes, config=replace(graph.config, odometry_noise=noise))


def log_evidence(
    graph: LocalizationGraph, measured: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[float, gtsam.Values]:
    """Log probability of the measurements, poses integrated out, and the poses it was taken about."""
    factors = graph.motion_factors()
    factors.push_back(measured)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(20)
    parameters.setRelativeErrorTol(1e-4)
    values = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters).optimize()
    tree = factors.linearize(values).eliminateMultifrontal()
    steps = [np.linalg.slogdet(k.step_covariance)[1].sum() for k in graph.robots.values()]
    return -factors.error(values) - float(tree.logDeterminant()) - 0.5 * float(np.sum(steps)), values


def likeliest_drift(
    graph: LocalizationGraph, robots: Sequence[RobotLog], solution: Solution, config: LocalizationConfig
) -> DriftEvidence:
    """Rotation and translation noise by pattern search in factors, from the configured one."""
    measured, values = _measured(graph, solution), solution.values
    tried: dict[tuple[float, float], float] = {}

    def evidence(rotation: float, translation: float) -> float:
        nonlocal values
        key = (round(rotation, 6), round(translation, 6))
        if key not in tried:
            noise = replace(
                config.odometry_noise, rotation_deg_per_sqrt_m=rotation, translation_percent=translation
            )
            tried[key], values = log_evidence(with_noise(graph, robots, noise, config), measured, values)
        return tried[key]

    def posterior(point: tuple[float, float]) -> float:
        off = np.log(np.array(point) / configured) / _PRIOR_LOG_SIGMA
        return evidence(*point) - 0.5 * float(off @ off)

    noise = config.odometry_noise
    best = (noise.rotation_deg_per_sqrt_m, noise.translation_percent)
    configured = np.array(best)
    for factor in _FACTORS:
        while True:
            around = [best]
            around += [(best[0] * f, best[1]) for f in (factor, 1 / factor)]
            around += [(best[0], best[1] * f) for f in (factor, 1 / factor)]
            next_best = max(around, key=posterior)
            if next_best == best:
                break
            best = next_best
    noise = replace(noise, rotation_deg_per_sqrt_m=best[0], translation_percent=best[1])
    return DriftEvidence(noise, tried)
