import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mulan.geometry import se3
from mulan.geometry.alignment import point_nearest_to_axes, umeyama

from .strategies import transforms, vectors


def cloud(seed: int, count: int = 20) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


@given(transforms(), st.floats(0.1, 10.0), st.integers(0, 1000))
def test_umeyama_recovers_a_known_similarity(T, scale, seed):
    source = cloud(seed)
    target = scale * source @ T[:3, :3].T + T[:3, 3]
    found, found_scale = umeyama(source, target, with_scale=True)
    assert found_scale == pytest.approx(scale, rel=1e-9)
    np.testing.assert_allclose(found, T, atol=1e-8)


@given(transforms(), st.integers(0, 1000))
def test_umeyama_without_scale_recovers_a_rigid_transform_from_planar_points(T, seed):
    source = cloud(seed) * [1.0, 1.0, 0.0]
    found, scale = umeyama(source, se3.transform(np.broadcast_to(T, (20, 4, 4)), source))
    assert scale == 1.0
    np.testing.assert_allclose(found, T, atol=1e-8)


def test_umeyama_never_answers_with_a_mirror_image():
    source = cloud(3)
    found, _ = umeyama(source, source * [1.0, 1.0, -1.0])
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)


def test_umeyama_is_the_least_squares_optimum():
    rng = np.random.default_rng(5)
    source = cloud(5)
    target = cloud(6)
    best, _ = umeyama(source, target)

    def cost(T):
        return float(((source @ T[:3, :3].T + T[:3, 3] - target) ** 2).sum())

    nearby = [best @ se3.exp(1e-3 * rng.normal(size=6)) for _ in range(50)]
    assert cost(best) < min(map(cost, nearby))


@given(vectors(5.0), st.integers(0, 1000))
def test_lines_through_one_point_meet_there(point, seed):
    origins = cloud(seed) * 3 + point
    directions = (point - origins) / np.linalg.norm(point - origins, axis=1, keepdims=True)
    np.testing.assert_allclose(point_nearest_to_axes(origins, directions), point, atol=1e-4)


def test_parallel_lines_still_give_a_finite_point_between_them():
    origins = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    directions = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(point_nearest_to_axes(origins, directions), [0, 0, 0], atol=1e-6)
