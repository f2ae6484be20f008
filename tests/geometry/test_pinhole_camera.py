import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mulan.geometry.camera import R_OPTICAL_OPENGL, PinholeCamera

from .strategies import cameras

SQUARE = PinholeCamera(width=4, height=2, fx=2.0, fy=2.0, cx=2.0, cy=1.0)


def opencv_pixel(camera: PinholeCamera, X: float, Y: float, Z: float) -> tuple[float, float]:
    """The formula of OpenCV's calib3d page, written out, on optical axes."""
    x, y = X / Z, Y / Z
    r2 = x**2 + y**2
    radial = 1 + camera.k1 * r2 + camera.k2 * r2**2 + camera.k3 * r2**3
    x2 = x * radial + 2 * camera.p1 * x * y + camera.p2 * (r2 + 2 * x**2)
    y2 = y * radial + camera.p1 * (r2 + 2 * y**2) + 2 * camera.p2 * x * y
    return camera.fx * x2 + camera.cx, camera.fy * y2 + camera.cy


@given(cameras(), st.floats(-0.8, 0.8), st.floats(-0.6, 0.6), st.floats(0.1, 20.0))
def test_projection_is_opencvs_formula(camera, x, y, depth):
    optical = np.array([x * depth, y * depth, depth])
    found = camera.project(R_OPTICAL_OPENGL.T @ optical)
    np.testing.assert_allclose(found, opencv_pixel(camera, *optical), atol=1e-9)


@given(cameras(), st.floats(-0.6, 0.6), st.floats(-0.5, 0.5), st.floats(0.1, 20.0))
def test_unprojection_undoes_projection_under_strong_distortion(camera, x, y, depth):
    point = depth * np.array([x, y, -1.0])
    direction = camera.unproject(camera.project(point))
    np.testing.assert_allclose(direction, point / np.linalg.norm(point), atol=1e-9)


@given(cameras(), st.floats(0.15, 0.85), st.floats(0.15, 0.85))
def test_projection_undoes_unprojection(camera, u, v):
    pixel = np.array([u * camera.width, v * camera.height])
    np.testing.assert_allclose(camera.project(camera.unproject(pixel)), pixel, atol=1e-7)


def test_the_whole_image_of_a_barrel_lens_unprojects():
    camera = PinholeCamera(640, 480, 400.0, 400.0, 320.0, 240.0, k1=-0.2, k2=0.04, p1=1e-3, p2=-1e-3)
    directions = camera.pixel_directions()
    u, v = np.meshgrid(np.arange(640) + 0.5, np.arange(480) + 0.5)
    np.testing.assert_allclose(camera.project(directions), np.stack([u, v], -1), atol=1e-6)


def test_pixel_centres_lie_at_one_half():
    directions = SQUARE.pixel_directions()
    assert directions.shape == (2, 4, 3)
    # pixel (0, 0): centre (0.5, 0.5), so x = (0.5 - 2) / 2 and y is up
    expected = np.array([-0.75, 0.25, -1.0])
    np.testing.assert_allclose(directions[0, 0], expected / np.linalg.norm(expected))
    np.testing.assert_allclose(SQUARE.project(directions[1, 3]), [3.5, 1.5])


def test_the_optical_axis_looks_along_minus_z_and_up_is_plus_y():
    np.testing.assert_allclose(SQUARE.unproject(np.array([2.0, 1.0])), [0, 0, -1])
    above = SQUARE.project(np.array([0.0, 1.0, -4.0]))
    assert above[1] < SQUARE.cy


def test_points_behind_the_camera_have_no_pixel():
    found = SQUARE.project(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
    assert np.isnan(found[:2]).all()
    np.testing.assert_allclose(found[2], [2.0, 1.0])


@given(cameras(), st.integers(50, 2000), st.integers(50, 2000), st.floats(-0.5, 0.5), st.floats(-0.4, 0.4))
def test_a_resized_camera_sees_the_same_place_in_the_image(camera, width, height, x, y):
    point = np.array([x, y, -1.0])
    found = camera.resized(width, height)
    np.testing.assert_allclose(
        found.project(point) / [width, height], camera.project(point) / [640, 480], atol=1e-9
    )
    assert (found.width, found.height, found.distortion) == (width, height, camera.distortion)


def test_every_unprojected_direction_has_unit_length():
    camera = PinholeCamera(64, 48, 40.0, 41.0, 32.0, 24.0, k1=0.1)
    np.testing.assert_allclose(np.linalg.norm(camera.pixel_directions(), axis=-1), 1.0, atol=1e-15)
    assert camera.distortion == (0.1, 0.0, 0.0, 0.0, 0.0)


def test_field_of_view_follows_the_focal_length():
    edge = PinholeCamera(200, 100, 100.0, 100.0, 100.0, 50.0).unproject(np.array([200.0, 50.0]))
    assert math.atan2(edge[0], -edge[2]) == pytest.approx(math.pi / 4)
