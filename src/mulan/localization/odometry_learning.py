"""Each robot's odometry scale and noise, learned from how its steps fit the rest of the graph."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.localization.graph import LocalizationGraph
from mulan.localization.keyframes import Keyframes, corrected_keyframes
from mulan.localization.marginals import TeamMarginals, columns, solve_normal_equations
from mulan.localization.odometry_correction import Learning, OdometryCorrection
from mulan.localization.solve import Solution, refine_solution
from mulan.mission.types import RobotLog

_PRIOR_STEPS = 0.5  # what was given counts as so many residuals
_OVERRELAXATION = 1.8
_MOST_STRIDE = 2.0
_SETTLED_NOISE = 0.03  # change of a sigma, relative
_SETTLED_SCALE = 0.1  # in its sigmas
_MOST_SCALE_STEP = 0.02
_LEAST_SCALE, _MOST_SCALE = 0.5, 2.0


@dataclass(frozen=True)
class LearnedOdometry:
    """The graph with corrected odometry, solved.

    Attributes:
        graph: Keyframes and step covariances hold the corrections.
        solution: Of that graph.
        marginals: Covariances, the scales' uncertainty included.
    """

    graph: LocalizationGraph
    solution: Solution
    marginals: TeamMarginals

    @property
    def corrections(self) -> Mapping[str, OdometryCorrection]:
        """By robot name."""
        return {name: keyframes.correction for name, keyframes in self.graph.robots.items()}


@dataclass(frozen=True)
class _Steps:
    """Residuals of one robot's odometry at the solution.

    Attributes:
        residual: ``log(Z⁻¹ X_i⁻¹ X_j)`` of every step.
        by_first: Its derivative by the first pose; by the second it is the identity.
        by_scale: Its derivative by the scale.
        covariance: Of the step.
        up_body: The vertical in the second body.
    """

    residual: Float[NDArray, "m 6"]
    by_first: Float[NDArray, "m 6 6"]
    by_scale: Float[NDArray, "m 6"]
    covariance: Float[NDArray, "m 6 6"]
    up_body: Float[NDArray, "m 3"]


def _steps(graph: LocalizationGraph, solution: Solution, keyframes: Keyframes) -> _Steps:
    count = len(keyframes.time_s)
    X = np.array([solution.values.atPose3(graph.key(keyframes.robot, i)).matrix() for i in range(count)])
    Z = se3.inverse(keyframes.T_odom_body[:-1]) @ keyframes.T_odom_body[1:]
    apart = se3.inverse(X[:-1]) @ X[1:]
    by_scale = np.zeros((count - 1, 6))
    by_scale[:, 3:] = -np.einsum("mji,mj->mi", Z[:, :3, :3], Z[:, :3, 3]) / keyframes.correction.scale
    return _Steps(
        residual=se3.log(se3.inverse(Z) @ apart),
        by_first=-se3.adjoint(se3.inverse(apart)),
        by_scale=by_scale,
        covariance=keyframes.step_covariance,
        up_body=keyframes.T_odom_body[1:, 2, :3],
    )


def _learns(which: Learning, robot: RobotLog) -> bool:
    return which is Learning.ALWAYS or (which is Learning.UNREPORTED and robot.odometry.covariance is None)


def learn_odometry(
    robots: Sequence[RobotLog], graph: LocalizationGraph, solution: Solution
) -> LearnedOdometry:
    """Alternate solving with re-estimating every robot's scale and noise until they settle.

    The scale is the Gauss-Newton step of one more unknown a robot, eliminated from the graph by its Schur
    complement. The noise is restricted maximum likelihood: squared residuals are divided not by their number
    but by how many the radio could see at all (MacKay's effective number of freedoms), apart for heading and
    translation; what was given counts as a few residuals, so a robot the radio hardly sees keeps it.

    Args:
        robots: The placed ones.
        graph: With the odometry as it came.
        solution: Of that graph.
    """
    config = graph.config.odometry_learning
    scaled = [r.name for r in robots if _learns(config.scale, r) and len(graph.robots[r.name].time_s) > 1]
    noisy = [r.name for r in robots if _learns(config.noise, r) and len(graph.robots[r.name].time_s) > 1]
    if len(robots) < 2 or not (scaled or noisy) or not (graph.bearings or graph.ranges):
        return LearnedOdometry(graph, solution, TeamMarginals(graph, solution))
    plain, corrections = graph.robots, {name: OdometryCorrection() for name in graph.robots}
    marginals = TeamMarginals(graph, solution)
    for remaining in reversed(range(config.rounds + 1)):
        steps = {name: _steps(graph, solution, graph.robots[name]) for name in {*scaled, *noisy}}
        response, covariance, change = _scale_update(graph, solution, steps, scaled)
        marginals = TeamMarginals(graph, solution, response, covariance)
        for k, name in enumerate(scaled):
            corrections[name] = replace(corrections[name], scale_sigma=float(np.sqrt(covariance[k, k])))
        if remaining == 0:
            break
        updated = dict(corrections)
        for name in noisy:
            side = (response, covariance, scaled.index(name)) if name in scaled else None
            updated[name] = _noise_update(
                graph, marginals, columns(solution.values), steps[name], name, updated, side
            )
        for k, name in enumerate(scaled):
            step = float(np.clip(change[k], -_MOST_SCALE_STEP, _MOST_SCALE_STEP))
            scale = float(np.clip(updated[name].scale + step, _LEAST_SCALE, _MOST_SCALE))
            updated[name] = replace(updated[name], scale=scale)
        if _settled(corrections, updated):
            break
        corrections = updated
        graph = replace(
            graph,
            robots={
                name: corrected_keyframes(keyframes, corrections[name], graph.config.gravity_aligned)
                for name, keyframes in plain.items()
            },
        )
        solution = refine_solution(graph, solution)
    graph = replace(graph, robots={n: replace(k, correction=corrections[n]) for n, k in graph.robots.items()})
    return LearnedOdometry(graph, solution, marginals)  # pyright: ignore[reportPossiblyUnboundVariable]


def _settled(before: Mapping[str, OdometryCorrection], after: Mapping[str, OdometryCorrection]) -> bool:
    for name, old in before.items():
        new = after[name]
        noise = np.log([new.heading_noise / old.heading_noise, new.translation_noise / old.translation_noise])
        if (
            np.abs(noise).max() > _SETTLED_NOISE
            or abs(new.scale - old.scale) > _SETTLED_SCALE * old.scale_sigma
        ):
            return False
    return True


def _scale_update(
    graph: LocalizationGraph, solution: Solution, steps: Mapping[str, _Steps], scaled: Sequence[str]
) -> tuple[Float[NDArray, "n s"], Float[NDArray, "s s"], Float[NDArray, "s"]]:
    """How the graph's variables move with the scales, the scales' covariance, and their Gauss-Newton step."""
    column = columns(solution.values)
    size = solution.values.dim()
    variance = graph.config.odometry_learning.scale_sigma**2
    cross, own, slope = np.zeros((size, len(scaled))), np.zeros(len(scaled)), np.zeros(len(scaled))
    for k, name in enumerate(scaled):
        s = steps[name]
        weighted = np.linalg.solve(s.covariance, s.by_scale[..., None])[..., 0]
        by_first = np.einsum("mji,mj->mi", s.by_first, weighted)
        for i in range(len(s.residual)):
            first, second = (column[graph.key(name, i + j)] for j in (0, 1))
            cross[first : first + 6, k] += by_first[i]
            cross[second : second + 6, k] += weighted[i]
        own[k] = float((weighted * s.by_scale).sum()) + 1 / variance
        slope[k] = float((weighted * s.residual).sum())
        slope[k] += (graph.robots[name].correction.scale - 1) / variance
    if not scaled:
        return cross, np.zeros((0, 0)), np.zeros(0)
    response = -solve_normal_equations(solution.graph, solution.values, cross)
    covariance = np.linalg.inv(np.diag(own) + cross.T @ response)
    return response, (covariance + covariance.T) / 2, -covariance @ slope


def _noise_update(
    graph: LocalizationGraph,
    marginals: TeamMarginals,
    column: Mapping[int, int],
    steps: _Steps,
    name: str,
    corrections: Mapping[str, OdometryCorrection],
    side: tuple[Float[NDArray, "n s"], Float[NDArray, "s s"], int] | None,
) -> OdometryCorrection:
    """Factors on the sigmas of heading and translation that make the residuals as large as expected."""
    correction = corrections[name]
    turn, turn_open, shift, shift_open = 0.0, 0.0, 0.0, 0.0
    for i, residual in enumerate(steps.residual):
        J = np.concatenate([steps.by_first[i], np.eye(6)], axis=1)
        spread = J @ marginals.joint([(name, i), (name, i + 1)]) @ J.T
        if side is not None:
            response, covariance, k = side
            first = column[graph.key(name, i)]
            second = column[graph.key(name, i + 1)]
            moved = J @ np.concatenate([response[first : first + 6], response[second : second + 6]])
            mixed = np.outer(moved @ covariance[:, k], steps.by_scale[i])
            spread = spread + mixed + mixed.T
            spread += covariance[k, k] * np.outer(steps.by_scale[i], steps.by_scale[i])
        Q = steps.covariance[i]
        if graph.config.gravity_aligned:
            up = steps.up_body[i]
            variance = float(up @ Q[:3, :3] @ up)
            turn += float(up @ residual[:3]) ** 2 / variance
            turn_open += float(up @ spread[:3, :3] @ up) / variance
        else:
            turn += float(residual[:3] @ np.linalg.solve(Q[:3, :3], residual[:3]))
            turn_open += float(np.trace(np.linalg.solve(Q[:3, :3], spread[:3, :3])))
        shift += float(residual[3:] @ np.linalg.solve(Q[3:, 3:], residual[3:]))
        shift_open += float(np.trace(np.linalg.solve(Q[3:, 3:], spread[3:, 3:])))
    count = len(steps.residual)
    most = graph.config.odometry_learning.largest_noise_factor
    turns = count * (1 if graph.config.gravity_aligned else 3)
    return replace(
        correction,
        heading_noise=_factor(correction.heading_noise, turn, turns - turn_open, most),
        translation_noise=_factor(correction.translation_noise, shift, 3 * count - shift_open, most),
    )


def _factor(present: float, squared: float, seen: float, most: float) -> float:
    """The next factor on a sigma, from whitened squared residuals and how many the radio could see."""
    variance = (squared * present**2 + _PRIOR_STEPS) / (max(seen, 0.0) + _PRIOR_STEPS)
    # the plain iteration creeps towards its fixed point from one side; nearly twice its step is still stable
    stride = float(np.clip((np.sqrt(variance) / present) ** _OVERRELAXATION, 1 / _MOST_STRIDE, _MOST_STRIDE))
    return float(np.clip(present * stride, 1 / most, most))
