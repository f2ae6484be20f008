import numpy as np
import pytest

from mulan.wireless.directions import tangent_basis, unit_direction
from mulan.wireless.multipath import resolve_paths
from mulan.wireless.peak import steering_model

from .signals import WAVELENGTH_M, aperture_channel, helix


def _two_paths(seed, level=False):
    rng = np.random.default_rng(seed)
    path = helix(200, 0.3, 0.3, level)
    first, second = unit_direction(np.array([0.4, 2.5]), np.array([0.3, -0.2 if not level else 0.2]))
    centre = path.mean(0)
    sources = centre + 4.0 * first, [(centre + 5.0 * second, 0.75)]
    channel = aperture_channel(path, sources[0], rng, 0.3, sources[1])
    return steering_model(path, WAVELENGTH_M, 4.0), channel, first, second


def test_the_square_of_two_paths_is_two_paths_and_no_cross_term():
    model, channel, first, second = _two_paths(1)
    paths = resolve_paths(model, channel)
    strong = paths.direction[paths.power > 0.1]
    assert len(strong) == 2
    assert np.degrees(np.linalg.norm(strong[0] - first)) < 0.5
    assert np.degrees(np.linalg.norm(strong[1] - second)) < 1.5  # seen with the other source's range
    assert paths.weight.sum() + paths.outlier_mass == pytest.approx(1.0)
    assert paths.weight[0] == paths.weight.max()


def test_covariance_of_a_resolved_path_holds_its_error():
    squared = []
    for seed in range(3):
        model, channel, first, _ = _two_paths(seed)
        paths = resolve_paths(model, channel)
        error = tangent_basis(paths.direction[0]).T @ (first - paths.direction[0])
        squared.append(error @ np.linalg.solve(paths.covariance[0], error) / 2)
    assert 0.2 < np.mean(squared) < 4


def test_elevation_of_a_path_is_unobservable_on_a_level_aperture():
    model, channel, first, _ = _two_paths(2, level=True)
    paths = resolve_paths(model, channel[:, None])
    assert np.isinf(paths.covariance[:, 1, 1]).all()
    azimuth = np.arctan2(paths.direction[:, 1], paths.direction[:, 0])
    assert np.degrees(np.abs(azimuth - np.arctan2(first[1], first[0]))).min() < 1.0
