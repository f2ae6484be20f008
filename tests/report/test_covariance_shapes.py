import numpy as np
import pytest

from mulan.geometry import se3, so3
from mulan.report.covariance_shapes import (
    ellipse_95,
    ellipsoid_95,
    exaggeration_for,
    position_covariance_world,
)


def test_the_95_percent_ellipse_holds_95_percent_of_the_samples():
    covariance = np.array([[0.04, 0.03], [0.03, 0.05]])
    outline = ellipse_95(np.zeros(2), covariance, 1)
    precision = np.linalg.inv(covariance)
    boundary = np.einsum("ni,ij,nj->n", outline, precision, outline)
    samples = np.random.default_rng(0).multivariate_normal(np.zeros(2), covariance, 20_000)
    inside = np.einsum("ni,ij,nj->n", samples, precision, samples) < boundary.mean()
    assert np.ptp(boundary) < 1e-9
    assert inside.mean() == pytest.approx(0.95, abs=0.005)


def test_the_95_percent_ellipsoid_holds_95_percent_of_the_samples():
    A = np.random.default_rng(1).normal(size=(3, 3))
    covariance = A @ A.T
    precision = np.linalg.inv(covariance)
    rings = np.concatenate(ellipsoid_95(np.zeros(3), covariance, 1))
    boundary = np.einsum("ni,ij,nj->n", rings, precision, rings)
    samples = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, 20_000)
    inside = np.einsum("ni,ij,nj->n", samples, precision, samples) < boundary.mean()
    assert np.ptp(boundary) < 1e-6
    assert inside.mean() == pytest.approx(0.95, abs=0.005)


def test_body_axes_covariance_turns_with_the_body():
    T = se3.from_parts(so3.about_z(np.array([np.pi / 2])), np.zeros((1, 3)))
    covariance = np.diag([0.0, 0.0, 0.0, 4.0, 1.0, 0.0])[None]
    np.testing.assert_allclose(
        position_covariance_world(T, covariance)[0], np.diag([1.0, 4.0, 0.0]), atol=1e-12
    )


@pytest.mark.parametrize(("sigma_m", "factor"), [(0.05, 1), (0.004, 5), (0.0, 1)])
def test_ellipses_are_exaggerated_only_when_too_small_to_see(sigma_m, factor):
    covariance = np.repeat(np.eye(3)[None] * sigma_m**2, 4, axis=0)
    assert exaggeration_for(covariance, 3.0) == factor
