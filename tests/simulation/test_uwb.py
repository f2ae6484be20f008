from dataclasses import replace

import numpy as np
import pytest

from mulan.simulation.uwb import UwbConfig, simulate_ranges


def _ranges(config: UwbConfig, seed: int = 0, end_s: float = 400.0):
    near, far = (lambda t: np.zeros((len(t), 3))), (lambda t: np.tile([3.0, 4.0, 0.0], (len(t), 1)))
    return simulate_ranges(("alpha", "beta"), (near, far), end_s, config, np.random.default_rng(seed))


def test_ranges_scatter_about_the_distance_with_the_reported_sigma():
    for track in _ranges(replace(UwbConfig(), bias_sigma_m=0.0)):
        assert track.range_m.mean() == pytest.approx(5.0, abs=0.005)
        assert track.range_m.std() == pytest.approx(0.05, rel=0.06)
        assert np.all(track.sigma_m == 0.05)


def test_both_robots_range_at_the_asked_rate_in_turn():
    to_beta, to_alpha = _ranges(UwbConfig())
    assert (to_beta.peer, to_alpha.peer) == ("beta", "alpha")
    assert np.allclose(np.diff(to_beta.time_s), 0.2)
    assert np.allclose(to_alpha.time_s - to_beta.time_s, 0.1)


def test_bias_is_one_number_a_pair_and_varies_over_pairs():
    means = [[track.range_m.mean() - 5 for track in _ranges(UwbConfig(), seed, 100.0)] for seed in range(60)]
    means = np.array(means)
    assert np.abs(means[:, 0] - means[:, 1]).max() < 0.02
    assert means[:, 0].std() == pytest.approx(0.02, rel=0.35)


def test_outliers_are_late_never_early():
    error = _ranges(UwbConfig(outlier_rate=0.3))[0].range_m - 5
    assert np.mean(error > 0.3) == pytest.approx(0.3 * np.exp(-0.3), abs=0.05)
    assert error.min() > -0.3
