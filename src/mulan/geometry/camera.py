"""The pinhole camera with OpenCV distortion, on OpenGL axes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

# OpenCV optical axes (x right, y down, z forward) from OpenGL camera axes (x right, y up, z backward).
R_OPTICAL_OPENGL = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class PinholeCamera:
    """Intrinsics of one camera.

    Attributes:
        width, height: Image size in pixels.
        fx, fy, cx, cy: Focal lengths and principal point in pixels; pixel (0, 0) is centred at (0.5, 0.5).
        k1, k2, p1, p2, k3: OpenCV radial and tangential distortion.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @property
    def distortion(self) -> tuple[float, float, float, float, float]:
        """(k1, k2, p1, p2, k3), ROS plumb_bob order."""
        return (self.k1, self.k2, self.p1, self.p2, self.k3)

    def resized(self, width: int, height: int) -> "PinholeCamera":
        """The same lens over an image resampled to another size."""
        sx, sy = width / self.width, height / self.height
        return PinholeCamera(
            width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy, *self.distortion
        )

    def _distort(self, xy: Float[NDArray, "*b 2"]) -> Float[NDArray, "*b 2"]:
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        xd = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        yd = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return np.stack([xd, yd], -1)

    def _undistort(self, xy_distorted: Float[NDArray, "*b 2"]) -> Float[NDArray, "*b 2"]:
        """Newton's method with a numerical Jacobian; exact to 1e-10 inside the image."""
        xy = xy_distorted.copy()
        eps = 1e-6
        step_x, step_y = np.array([eps, 0.0]), np.array([0.0, eps])
        for _ in range(12):
            residual = self._distort(xy) - xy_distorted
            if np.abs(residual).max(initial=0.0) < 1e-12:
                break
            jx = (self._distort(xy + step_x) - self._distort(xy - step_x)) / (2 * eps)
            jy = (self._distort(xy + step_y) - self._distort(xy - step_y)) / (2 * eps)
            det = jx[..., 0] * jy[..., 1] - jy[..., 0] * jx[..., 1]
            dx = (jy[..., 1] * residual[..., 0] - jy[..., 0] * residual[..., 1]) / det
            dy = (jx[..., 0] * residual[..., 1] - jx[..., 1] * residual[..., 0]) / det
            xy = xy - np.stack([dx, dy], -1)
        return xy

    def project(self, points_camera: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b 2"]:
        """Pixels of points in the camera frame (metres, OpenGL axes); NaN for points behind it."""
        depth = -points_camera[..., 2]
        safe = np.where(depth > 0, depth, np.nan)
        xy = np.stack([points_camera[..., 0] / safe, -points_camera[..., 1] / safe], -1)
        return self._distort(xy) * [self.fx, self.fy] + [self.cx, self.cy]

    def unproject(self, pixels: Float[NDArray, "*b 2"]) -> Float[NDArray, "*b 3"]:
        """Unit viewing directions of pixels in the camera frame (OpenGL axes)."""
        xy = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        if any(self.distortion):
            xy = self._undistort(xy)
        d = np.stack([xy[..., 0], -xy[..., 1], -np.ones_like(xy[..., 0])], -1)
        return d / np.linalg.norm(d, axis=-1, keepdims=True)

    def pixel_directions(self) -> Float[NDArray, "h w 3"]:
        """Unit viewing direction of every pixel centre in the camera frame."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return self.unproject(np.stack([u, v], -1))
