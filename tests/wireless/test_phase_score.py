import numpy as np
import pytest

from mulan.wireless.directions import tangent_basis
from mulan.wireless.peak import refine_direction, steering_model
from mulan.wireless.phase_score import scored_direction

from .signals import WAVELENGTH_M, aperture_channel, helix

DIRECTION = np.array([0.6, 0.64, 0.48])


def errors_rad(noise_rad, links=150):
    """Root mean square error of the coherent peak and of the scored direction."""
    path = helix(300)
    source = path.mean(0) + 6.0 * DIRECTION
    model, rng = steering_model(path, WAVELENGTH_M, 6.0), np.random.default_rng(0)
    squares = []
    for _ in range(links):
        h = aperture_channel(path, source, rng, noise_rad)
        peak = refine_direction(model, h / np.abs(h), DIRECTION)
        scored = scored_direction(model, h / np.abs(h), peak)
        squares.append([((tangent_basis(DIRECTION).T @ (u - DIRECTION)) ** 2).sum() for u in (peak, scored)])
    return np.sqrt(np.mean(squares, 0))


def test_strong_phase_noise_costs_less_with_the_score():
    peak, scored = errors_rad(1.2)
    assert scored < 0.98 * peak


def test_little_phase_noise_leaves_the_peak_alone():
    peak, scored = errors_rad(0.3, links=5)
    assert scored == pytest.approx(peak, rel=1e-12)


def test_a_level_path_keeps_its_elevation():
    path = helix(300, level=True)
    model, rng = steering_model(path, WAVELENGTH_M), np.random.default_rng(1)
    h = aperture_channel(path, path.mean(0) + np.array([30.0, 40.0, 0.0]), rng, 1.0)
    peak = refine_direction(model, h, np.array([0.6, 0.8, 0.0]))
    scored = scored_direction(model, h, peak)
    assert scored[2] == pytest.approx(peak[2], abs=1e-6)
    assert 0 < np.linalg.norm(scored - peak) < 0.01
