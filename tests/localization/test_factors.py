import gtsam
import numpy as np
import pytest

from mulan.geometry import se3
from mulan.localization.factors import Sight, bearing_factor, bearing_residual, observed_basis, range_factor
from mulan.wireless.directions import tangent_basis


def random_pose(rng):
    return se3.exp(np.concatenate([rng.normal(size=3), 3 * rng.normal(size=3)]))


def numerical_jacobian(error, poses, which):
    columns = []
    for axis in range(6):
        step = np.zeros(6)
        step[axis] = 1e-6
        ends = []
        for sign in (1, -1):
            moved = list(poses)
            moved[which] = poses[which] @ se3.exp(sign * step)
            ends.append(error(moved))
        columns.append((ends[0] - ends[1]) / 2e-6)
    return np.stack(columns, -1)


@pytest.mark.parametrize("kind", ["bearing", "level bearing", "range"])
def test_jacobians_equal_numerical_ones(kind):
    rng = np.random.default_rng(0)
    for _ in range(10):
        poses = [random_pose(rng), random_pose(rng)]
        sight = Sight(0, 1, rng.normal(size=3) * 0.2, rng.normal(size=3) * 0.2)
        u = rng.normal(size=3)
        u /= np.linalg.norm(u)
        if kind == "range":
            factor = range_factor(sight, 2, 3.0, gtsam.noiseModel.Isotropic.Sigma(1, 1.0))
        else:
            columns = 2 if kind == "bearing" else 1
            noise = gtsam.noiseModel.Isotropic.Sigma(columns, 1.0)
            factor = bearing_factor(sight, u, tangent_basis(u)[:, :columns], noise)

        def values_of(moved):
            values = gtsam.Values()
            for key, T in enumerate(moved):
                values.insert(key, gtsam.Pose3(T))
            values.insert(2, np.array([0.1]))
            return values

        J, _ = factor.linearize(values_of(poses)).jacobian()
        expected = np.hstack(
            [
                numerical_jacobian(lambda moved, f=factor: f.unwhitenedError(values_of(moved)), poses, k)
                for k in (0, 1)
            ]
        )
        np.testing.assert_allclose(J[:, :12], expected, atol=2e-5 * max(1.0, np.abs(expected).max()))


def test_the_residual_is_the_angle_when_small_and_finite_at_the_antipode():
    m = np.array([0.6, 0.0, 0.8])
    B = tangent_basis(m)
    for angle in (1e-3, 0.1, 1.0, 3.0, 3.14, np.pi):
        v = 2.5 * (np.cos(angle) * m + np.sin(angle) * B[:, 0])
        residual, jacobian = bearing_residual(v, m, B)
        assert np.linalg.norm(residual) == pytest.approx(2 * np.sin(angle / 2), abs=1e-6)
        assert np.isfinite(jacobian).all()


def test_an_unobserved_axis_is_left_out():
    u = np.array([0.6, 0.0, 0.8])
    direction, basis, covariance = observed_basis(u, np.diag([0.01, np.inf]))
    assert basis.shape == (3, 1)
    assert covariance.shape == (1, 1)
    np.testing.assert_allclose(direction, [1, 0, 0])
    assert observed_basis(u, np.diag([0.01, 0.02]))[1].shape == (3, 2)
