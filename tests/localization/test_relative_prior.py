import gtsam
import numpy as np
import pytest

from mulan.geometry import se3, so3
from mulan.localization.relative_prior import relative_prior

POSES, BIAS = [0, 1, 2], 10**15
KEYS = [*POSES, BIAS]


@pytest.fixture
def values():
    rng = np.random.default_rng(0)
    found = gtsam.Values()
    for key in POSES:
        found.insert(key, gtsam.Pose3(se3.exp(0.5 * rng.normal(size=6))))
    found.insert(BIAS, np.zeros(1))
    return found


def anything():
    """A linear graph over all keys, with absolute and relative information and correlations."""
    rng = np.random.default_rng(1)
    graph = gtsam.GaussianFactorGraph()
    for keys in ([0], [0, 1], [1, 2, BIAS]):
        blocks = [part for key in keys for part in (key, rng.normal(size=(8, 1 if key == BIAS else 6)))]
        rest = rng.normal(size=8), gtsam.noiseModel.Unit.Create(8)
        graph.add(gtsam.JacobianFactor(*blocks, *rest))  # type: ignore[call-overload]
    return graph


def normal_equations(graph):
    ordering = gtsam.Ordering()
    for key in KEYS:
        ordering.push_back(key)
    A, b = graph.jacobian(ordering)
    return A.T @ A, A.T @ b


def single(factor, values):
    graph = gtsam.GaussianFactorGraph()
    graph.add(factor.linearize(values))
    return graph


def moved(values, xi):
    step = gtsam.VectorValues()
    for i, key in enumerate(POSES):
        step.insert(key, xi[6 * i : 6 * i + 6])
    step.insert(BIAS, xi[18:])
    return values.retract(step)


def test_where_it_was_linearised_it_says_what_the_linear_graph_says(values):
    linear = anything()
    factor = relative_prior(linear, values, POSES, [BIAS])
    for ours, theirs in zip(normal_equations(single(factor, values)), normal_equations(linear), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_its_jacobian_is_the_derivative_elsewhere_too(values):
    factor = relative_prior(anything(), values, POSES, [BIAS])
    away = moved(values, 0.2 * np.random.default_rng(2).normal(size=19))
    H, gradient = normal_equations(single(factor, away))
    step = 1e-6
    residual = factor.unwhitenedError(away)
    J = np.stack(
        [(factor.unwhitenedError(moved(away, step * e)) - residual) / step for e in np.eye(19)], axis=1
    )
    np.testing.assert_allclose(J.T @ J, H, atol=1e-3)
    np.testing.assert_allclose(-J.T @ residual, gradient, atol=1e-3)


def test_relative_knowledge_does_not_feel_the_whole_team_turn_after_its_poses_moved(values):
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.05)
    graph = gtsam.NonlinearFactorGraph()
    for i, j in ((0, 1), (1, 2), (0, 2)):
        apart = values.atPose3(i).between(values.atPose3(j))
        graph.add(gtsam.BetweenFactorPose3(i, j, apart, noise))
    graph.add(gtsam.PriorFactorVector(BIAS, np.zeros(1), gtsam.noiseModel.Unit.Create(1)))
    linear = graph.linearize(values)
    ours = relative_prior(linear, values, POSES, [BIAS])
    frozen = gtsam.LinearContainerFactor.ConvertLinearGraph(linear, values)
    away = moved(values, 0.1 * np.random.default_rng(3).normal(size=19))
    turn = gtsam.Pose3(se3.from_parts(so3.about_z(np.array(0.3)), np.array([1.0, -2.0, 0.0])))
    turned = gtsam.Values(away)
    for key in POSES:
        turned.update(key, turn.compose(away.atPose3(key)))
    np.testing.assert_allclose(ours.error(turned), ours.error(away), rtol=1e-9)
    assert abs(frozen.error(turned) - frozen.error(away)) > 1.0
