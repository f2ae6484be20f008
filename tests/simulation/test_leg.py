import numpy as np
from scipy.stats import chi2

from mulan.geometry import se3, so3
from mulan.simulation.leg import continued
from mulan.simulation.odometry import OdometryNoiseConfig, simulate_odometry, start_frame

NOISE = OdometryNoiseConfig(2.0, 2.0, tilt_sigma_deg=0.0)
SAMPLES = 25


def _way(seed):
    """Two legs of about three metres; the second begins where the first ends."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(0.1, 0.08, (2 * SAMPLES, 3)), axis=0)
    T = se3.from_parts(so3.about_z(np.cumsum(rng.normal(0, 0.1, 2 * SAMPLES))), points)
    return T[: SAMPLES + 1], T[SAMPLES:]


def test_odometry_of_two_legs_has_the_covariance_it_claims():
    first, second = _way(3)
    truth = se3.inverse(start_frame(first[0])) @ second[-1]
    nees, claimed, errors = [], [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        before = simulate_odometry(np.arange(len(first), dtype=float), first, NOISE, rng)
        leg = simulate_odometry(100.0 + np.arange(len(second)), second, NOISE, rng)
        whole = continued(before, leg)
        np.testing.assert_allclose(whole.T_odom_body[0], before.T_odom_body[-1], atol=1e-12)
        assert whole.covariance is not None
        # yaw and position; there is no tilt error
        xi = se3.log(se3.inverse(whole.T_odom_body[-1]) @ truth)[2:]
        covariance = whole.covariance[-1][2:, 2:]
        nees.append(xi @ np.linalg.solve(covariance, xi))
        claimed.append(np.sqrt(np.diag(covariance)))
        errors.append(xi)
    assert 0.8 < np.mean(nees) / 4 < 1.25
    ratio = np.std(errors, axis=0) / np.mean(claimed, axis=0)
    assert ((ratio > 0.84) & (ratio < 1.18)).all()
    assert np.mean(np.array(nees) < chi2.ppf(0.95, 4)) > 0.9


def test_exact_odometry_of_two_legs_is_the_truth():
    exact = OdometryNoiseConfig(0.0, 0.0, 0.0)
    first, second = _way(5)
    rng = np.random.default_rng(0)
    before = simulate_odometry(np.arange(len(first), dtype=float), first, exact, rng)
    leg = simulate_odometry(100.0 + np.arange(len(second)), second, exact, rng)
    np.testing.assert_allclose(
        continued(before, leg).T_odom_body, se3.inverse(start_frame(first[0])) @ second, atol=1e-9
    )
