from importlib import import_module

import numpy as np

splats = import_module("splats")
scene = import_module("scene")

CAMERA = scene.Camera(20, 20, 20.0, 20.0, 10.0, 10.0, (0.0, 0.0, 0.0, 0.0))
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def gaussians(*rows):
    """Each row: z in front of the camera, sigma, opacity, colour."""
    harmonics = np.zeros((len(rows), 16, 3))
    harmonics[:, 0] = (np.array([colour for *_, colour in rows]) - 0.5) * 2 * np.sqrt(np.pi)
    mean = np.array([[0.0, 0.0, -z] for z, *_ in rows])
    covariance = np.array([sigma**2 * np.eye(3) for _, sigma, *_ in rows])
    return splats.Splats(mean, covariance, np.array([row[2] for row in rows]), harmonics)


def test_an_opaque_gaussian_hides_what_is_behind_it():
    for order in ((2.0, 4.0), (4.0, 2.0)):
        pair = gaussians((order[0], 1.0, 0.9, RED), (order[1], 1.0, 0.9, BLUE))
        red, _, blue = splats.render(pair, CAMERA, np.eye(4), (0.0, 0.0, 0.0))[10, 10]
        assert (red > blue) == (order[0] < order[1])


def test_a_footprint_falls_off_as_the_projected_gaussian():
    image = splats.render(gaussians((4.0, 0.5, 0.8, (1.0, 1.0, 1.0))), CAMERA, np.eye(4), (0.0, 0.0, 0.0))
    variance_px2 = (0.5 * 20 / 4) ** 2 + 0.3
    du, dv = np.arange(20) + 0.5 - 10, (np.arange(20) + 0.5 - 10)[:, None]
    expected = 0.8 * np.exp(-0.5 * (du**2 + dv**2) / variance_px2)
    near = np.sqrt(du**2 + dv**2) < 5
    np.testing.assert_allclose(image[..., 0][near], expected[near], atol=1e-3)


def test_the_background_shows_where_nothing_is():
    image = splats.render(gaussians((4.0, 0.01, 0.8, RED)), CAMERA, np.eye(4), (0.2, 0.4, 0.6))
    np.testing.assert_allclose(image[0, 0], (0.2, 0.4, 0.6), atol=1e-6)


def test_spherical_harmonics_are_orthonormal():
    draw = np.random.default_rng(0).normal(size=(60_000, 3))
    direction = draw / np.linalg.norm(draw, axis=1, keepdims=True)
    basis = np.stack(
        [splats._colour(np.tile(np.eye(16)[k][:, None] * 0.1, (1, 1, 3)), direction)[:, 0] for k in range(16)]
    )
    gram = 4 * np.pi * ((basis - 0.5) / 0.1) @ ((basis - 0.5) / 0.1).T / len(direction)
    np.testing.assert_allclose(gram, np.eye(16), atol=0.05)
