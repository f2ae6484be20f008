import numpy as np
import pytest
from scipy.stats import kstest

from mulan.wireless.azimuth_density import AzimuthMixture, azimuth_mixture, wrapped
from mulan.wireless.directions import unit_direction
from mulan.wireless.types import Bearing


def mixture(rng, outlier_mass, k=3):
    weight = rng.dirichlet(np.ones(k)) * (1 - outlier_mass)
    mean = rng.uniform(-np.pi, np.pi, k)
    return AzimuthMixture(mean, np.exp(rng.uniform(np.log(0.003), np.log(0.5), k)), weight, outlier_mass)


def drawn(m, rng, n):
    which = rng.choice(len(m.weight) + 1, n, p=[*m.weight, m.outlier_mass])
    uniform = rng.uniform(-np.pi, np.pi, n)
    at = np.minimum(which, len(m.weight) - 1)
    return np.where(
        which == len(m.weight), uniform, wrapped(m.mean_rad[at] + m.sigma_rad[at] * rng.normal(size=n))
    )


@pytest.mark.parametrize("outlier_mass", [0.0, 0.01, 0.4])
def test_levels_of_truths_drawn_from_the_mixture_are_uniform(outlier_mass):
    rng = np.random.default_rng(3)
    levels = []
    for _ in range(40):
        m = mixture(rng, outlier_mass)
        levels.append(m.level_of(drawn(m, rng, 100)))
    assert kstest(np.concatenate(levels), "uniform").pvalue > 0.01


def test_one_gaussian_has_the_textbook_levels():
    m = AzimuthMixture(np.array([0.3]), np.array([0.01]), np.array([1.0]), 0.0)
    off = np.array([0.0, 0.1, 0.5, 1.0, 1.959964, 3.0])
    expected = [0.0, 0.07966, 0.38292, 0.68269, 0.95, 0.99730]
    assert np.allclose(m.level_of(0.3 + 0.01 * off), expected, atol=2e-3)
    assert np.allclose(m.interval(0.95), [[0.3 - 0.01959964, 0.3 + 0.01959964]], atol=1e-4)


def test_everything_turns_with_the_circle():
    rng = np.random.default_rng(4)
    m = mixture(rng, 0.1)
    truth = rng.uniform(-np.pi, np.pi, 50)
    for turn in (1.0, np.pi, 3.5):
        turned = AzimuthMixture(wrapped(m.mean_rad + turn), m.sigma_rad, m.weight, m.outlier_mass)
        assert np.allclose(turned.level_of(wrapped(truth + turn)), m.level_of(truth), atol=2e-3)
        assert np.allclose(turned.log_density(truth + turn), m.log_density(truth))
        assert turned.sigma_azimuth_rad == pytest.approx(m.sigma_azimuth_rad, rel=1e-2)


def test_an_arc_may_cross_180_degrees():
    m = AzimuthMixture(np.array([np.pi - 0.01]), np.array([0.1]), np.array([0.9]), 0.1)
    (arc,) = m.interval(0.5)
    assert arc[0] < np.pi < arc[1]
    assert m.level_of(np.array([-np.pi + 0.01]))[0] < 0.5


@pytest.mark.parametrize("level", [0.1, 0.68, 0.95])
def test_regions_hold_their_level_and_contain_what_level_of_says(level):
    rng = np.random.default_rng(5)
    for outlier_mass in (0.0, 0.02, 0.3, 0.9):
        m = mixture(rng, outlier_mass)
        arcs = m.interval(level)
        around = np.linspace(-np.pi, np.pi, 40_001)[:-1]
        from_begin = (around[:, None] - arcs[:, 0]) % (2 * np.pi)
        inside = np.any(from_begin <= arcs[:, 1] - arcs[:, 0], axis=1)
        mass = np.exp(m.log_density(around))
        assert mass.sum() * (around[1] - around[0]) == pytest.approx(1.0, abs=1e-3)
        assert mass[inside].sum() * (around[1] - around[0]) == pytest.approx(level, abs=5e-3)
        some = around[::80]
        levels = m.level_of(some)
        clear = np.abs(levels - level) > 5e-3
        assert np.array_equal((levels <= level)[clear], np.asarray(inside)[::80][clear])


def test_sigma_counts_side_hypotheses_and_outliers():
    m = AzimuthMixture(np.array([0.0, 0.5]), np.array([0.02, 0.03]), np.array([0.7, 0.2]), 0.1)
    expected = np.sqrt(0.7 * 0.02**2 + 0.2 * (0.25 + 0.03**2) + 0.1 * np.pi**2 / 3)
    assert m.sigma_azimuth_rad == pytest.approx(expected, rel=1e-3)
    alone = AzimuthMixture(np.array([0.0]), np.array([0.02]), np.array([1.0]), 0.0)
    assert alone.sigma_azimuth_rad == pytest.approx(0.02, rel=1e-3)
    assert alone.mean_abs_azimuth_rad == pytest.approx(0.02 * np.sqrt(2 / np.pi), rel=1e-3)


def test_azimuth_sigma_grows_with_elevation():
    direction = unit_direction(np.array([0.2, -1.0]), np.array([np.pi / 3, 0.0]))
    covariance = np.tile(np.diag([1e-4, np.inf]), (2, 1, 1))
    bearing = Bearing(
        "a", "b", 0.0, 0.0, np.eye(4), direction, covariance, np.array([0.6, 0.3]), 0.1, 1e5, 300
    )
    m = azimuth_mixture(bearing)
    assert np.allclose(m.mean_rad, [0.2, -1.0])
    assert np.allclose(m.sigma_rad, [0.02, 0.01])
