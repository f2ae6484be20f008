"""How well refined poses are known."""

import numpy as np
import pytest

from mulan.reconstruction.refinement.posterior import less_sure_of


def information(images: int) -> np.ndarray:
    """Of images that only know where they are among each other."""
    rng = np.random.default_rng(0)
    J = rng.normal(size=(40 * images, 6 * images))
    common = np.linalg.qr(np.tile(np.eye(6), (images, 1)))[0]
    J -= J @ common @ common.T
    return J.T @ J


def test_an_image_that_errs_besides_counts_as_one_with_an_unknown_of_its_own():
    known, own, k = information(4), slice(6, 12), 3.0
    shifts = np.eye(24)[:, own]
    # its error as six more unknowns, then eliminated
    of_error = shifts.T @ known @ shifts + known[own, own] / k
    eliminated = known - known @ shifts @ np.linalg.inv(of_error) @ shifts.T @ known
    np.testing.assert_allclose(less_sure_of(known, 1, k), eliminated, atol=1e-9)


def test_what_the_others_know_of_each_other_stays():
    known, prior = information(4), np.diag(np.repeat([1e6, 1e-3, 1e-3, 1e-3], 6))
    covariances = [np.linalg.inv(prior + x) for x in (known, less_sure_of(known, 0, 3.0))]
    apart = np.kron([[0, 1, -1, 0]], np.eye(6))
    before, after = (apart @ covariance @ apart.T for covariance in covariances)
    np.testing.assert_allclose(after, before, rtol=0.35)
    # but where they lie together is known less well
    assert np.trace(covariances[1][6:, 6:]) > 1.5 * np.trace(covariances[0][6:, 6:])


@pytest.mark.filterwarnings("error")
def test_an_image_that_tells_nothing_changes_nothing():
    known = information(3)
    known[:6], known[:, :6] = 0, 0
    np.testing.assert_allclose(less_sure_of(known, 0, 3.0), known, atol=1e-12)
