"""A plain rasteriser of 3-D Gaussians, to score what OpenSplat saved (its PLY files).

Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", SIGGRAPH 2023, in numpy.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scene import Camera

_SCREEN_BLUR_PX2 = 0.3  # added to every footprint's variance, as all implementations of the article do
_ALPHA_MIN, _ALPHA_MAX, _TRANSMITTANCE_MIN = 1 / 255, 0.999, 1e-4


@dataclass(frozen=True)
class Splats:
    """n Gaussians: mean (n, 3), covariance (n, 3, 3), opacity (n,), spherical harmonics (n, 16, 3)."""

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    opacity: NDArray[np.float64]
    harmonics: NDArray[np.float64]


def read_ply(path: Path) -> Splats:
    """Gaussians of a binary PLY in the article's layout."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[2] for line in header.decode().splitlines() if line.startswith("property float")]
    table = np.frombuffer(body, "<f4").reshape(-1, len(names)).astype(np.float64)

    def columns(*wanted: str) -> NDArray[np.float64]:
        return table[:, [names.index(name) for name in wanted]]

    rest = [name for name in names if name.startswith("f_rest_")]
    harmonics = np.zeros((len(table), 16, 3))
    harmonics[:, 0] = columns("f_dc_0", "f_dc_1", "f_dc_2")
    harmonics[:, 1 : 1 + len(rest) // 3] = columns(*rest).reshape(len(table), 3, -1).transpose(0, 2, 1)
    axes = _rotation(columns("rot_0", "rot_1", "rot_2", "rot_3"))
    axes = axes * np.exp(columns("scale_0", "scale_1", "scale_2"))[:, None, :]
    opacity = 1 / (1 + np.exp(-columns("opacity")[:, 0]))
    return Splats(columns("x", "y", "z"), axes @ axes.transpose(0, 2, 1), opacity, harmonics)


def render(
    splats: Splats,
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    background: tuple[float, float, float],
    *,
    as_program: float | None = None,
) -> NDArray[np.float32]:
    """Colours (h, w, 3): footprints blended front to back over a background; no lens distortion.

    Args:
        splats: Gaussians in the frame of the pose.
        camera: Intrinsics.
        T_world_camera: Pose (4, 4), OpenGL axes.
        background: Colour behind everything.
        as_program: None blends by depth. A length (the unit OpenSplat scales the scene to) blends in
            the order OpenSplat 1.1.4 itself does on a CPU, see :func:`_program_key`.
    """
    to_camera = np.diag([1.0, -1.0, -1.0]) @ T_world_camera[:3, :3].T  # OpenGL axes to z forward, y down
    offset = splats.mean - T_world_camera[:3, 3]
    x, y, z = (offset @ to_camera.T).T
    order = np.flatnonzero(z > 0.01)
    key = z if as_program is None else _program_key(camera, x, y, z, as_program)
    order = order[np.argsort(key[order], kind="stable")]
    splats = Splats(*(values[order] for values in vars(splats).values()))
    x, y, z, offset = x[order], y[order], z[order], offset[order]
    u = camera.fl_x * x / z + camera.cx - 0.5
    v = camera.fl_y * y / z + camera.cy - 0.5
    colour = _colour(splats.harmonics, offset / np.linalg.norm(offset, axis=1, keepdims=True))
    footprint = _footprint(splats.covariance, to_camera, camera, x, y, z)
    conic = np.linalg.inv(footprint)
    reach = 3 * np.sqrt(footprint[:, [0, 1], [0, 1]])
    image = np.zeros((camera.height, camera.width, 3))
    left = np.ones((camera.height, camera.width))
    for i in range(len(order)):
        c0, c1 = max(0, int(u[i] - reach[i, 0]) - 1), min(camera.width, int(u[i] + reach[i, 0]) + 2)
        r0, r1 = max(0, int(v[i] - reach[i, 1]) - 1), min(camera.height, int(v[i] + reach[i, 1]) + 2)
        if c0 >= c1 or r0 >= r1:
            continue
        dx, dy = np.arange(c0, c1) - u[i], (np.arange(r0, r1) - v[i])[:, None]
        power = 0.5 * (conic[i, 0, 0] * dx**2 + conic[i, 1, 1] * dy**2) + conic[i, 0, 1] * dx * dy
        alpha = np.minimum(_ALPHA_MAX, splats.opacity[i] * np.exp(-power))
        here = left[r0:r1, c0:c1]
        alpha = np.where((alpha < _ALPHA_MIN) | (here * (1 - alpha) <= _TRANSMITTANCE_MIN), 0.0, alpha)
        image[r0:r1, c0:c1] += (alpha * here)[..., None] * colour[i]
        here *= 1 - alpha
    return np.clip(image + left[..., None] * np.asarray(background), 0, 1).astype(np.float32)


def _program_key(
    camera: Camera, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], unit: float
) -> NDArray[np.float64]:
    """What OpenSplat 1.1.4 sorts by on a CPU.

    Its rasteriser takes the depth column of the (n, 3) projected points for a contiguous array, so
    Gaussian i is ordered by entry i + 2 of all coordinates. Rendered so, a saved state equals the
    program's own pictures.
    """
    near, far = 0.001, 1000.0
    depth = (far + near - far * near * unit / z) / (far - near)
    points = np.stack(
        [2 * camera.fl_x * x / z / camera.width, 2 * camera.fl_y * y / z / camera.height, depth], 1
    )
    return np.concatenate([points.reshape(-1), np.zeros(2)])[2 : 2 + len(z)]


def _rotation(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices (n, 3, 3) of quaternions (w, x, y, z), normalised first."""
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _footprint(
    covariance: NDArray[np.float64],
    to_camera: NDArray[np.float64],
    camera: Camera,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Image covariances (n, 2, 2) [px²] of the linearised projection."""
    limit_x, limit_y = 1.3 * 0.5 * camera.width / camera.fl_x, 1.3 * 0.5 * camera.height / camera.fl_y
    x, y = z * np.clip(x / z, -limit_x, limit_x), z * np.clip(y / z, -limit_y, limit_y)
    jacobian = np.zeros((len(z), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 0, 2] = camera.fl_x / z, -camera.fl_x * x / z**2
    jacobian[:, 1, 1], jacobian[:, 1, 2] = camera.fl_y / z, -camera.fl_y * y / z**2
    jacobian = jacobian @ to_camera
    return jacobian @ covariance @ jacobian.transpose(0, 2, 1) + _SCREEN_BLUR_PX2 * np.eye(2)


def _colour(harmonics: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (n, 3) of real spherical harmonics to degree 3 (Condon-Shortley signs), plus 0.5, from 0."""
    x, y, z = direction.T
    basis = [
        np.full_like(x, 0.5 / np.sqrt(np.pi)),
        *(np.sqrt(3 / (4 * np.pi)) * term for term in (-y, z, -x)),
        *(np.sqrt(15 / (4 * np.pi)) * term for term in (x * y, -y * z)),
        np.sqrt(5 / (16 * np.pi)) * (2 * z * z - x * x - y * y),
        -np.sqrt(15 / (4 * np.pi)) * x * z,
        np.sqrt(15 / (16 * np.pi)) * (x * x - y * y),
        -np.sqrt(35 / (32 * np.pi)) * y * (3 * x * x - y * y),
        np.sqrt(105 / (4 * np.pi)) * x * y * z,
        -np.sqrt(21 / (32 * np.pi)) * y * (4 * z * z - x * x - y * y),
        np.sqrt(7 / (16 * np.pi)) * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -np.sqrt(21 / (32 * np.pi)) * x * (4 * z * z - x * x - y * y),
        np.sqrt(105 / (16 * np.pi)) * z * (x * x - y * y),
        -np.sqrt(35 / (32 * np.pi)) * x * (x * x - 3 * y * y),
    ]
    return np.maximum(0.0, np.einsum("bn,nbc->nc", np.array(basis), harmonics) + 0.5)
