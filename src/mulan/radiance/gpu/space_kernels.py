"""Parts of kernels: world points to the unit cube, lengths of steps (``space.py``, ``kernels/march.py``)."""

import math
from dataclasses import dataclass
from typing import no_type_check

import triton
import triton.language as tl

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.march import FAR_RADII, NEAR_RADII, bounded_step_m, step_count
from mulan.radiance.space import SceneSpace


@dataclass(frozen=True)
class SceneArguments:
    """What kernels know of the scene, as plain numbers.

    Attributes:
        centre_m: Centre in world coordinates.
        radius_m: Half side of the inner cube.
        step_m: Step of a bounded ray.
        near_m: First distance of an unbounded ray.
        growth: Growth of an unbounded ray's distance from one step to the next.
        unbounded: Which of the two.
        steps: Steps a ray is cut into.
        min_transmittance: Samples behind it are dropped.
    """

    centre_m: tuple[float, float, float]
    radius_m: float
    step_m: float
    near_m: float
    growth: float
    unbounded: bool
    steps: int
    min_transmittance: float

    @staticmethod
    def of(march: MarchConfig, space: SceneSpace) -> "SceneArguments":
        """Of a scene and how it is sampled."""
        steps = step_count(march)
        return SceneArguments(
            space.centre_m,
            space.radius_m,
            bounded_step_m(march, space),
            NEAR_RADII * space.radius_m,
            math.asinh(FAR_RADII - NEAR_RADII) / steps,
            space.unbounded,
            steps,
            march.min_transmittance,
        )


@triton.jit
@no_type_check
def contraction(x, y, z):
    """The factor that squeezes a point of the unbounded world into the cube [-2, 2]³, and its norm."""
    norm = tl.maximum(tl.maximum(tl.abs(x), tl.abs(y)), tl.maximum(tl.abs(z), 1e-9))
    return tl.where(norm <= 1, 1.0, (2 - 1 / norm) / norm), norm


@triton.jit
@no_type_check
def to_unit(x, y, z, centre_x, centre_y, centre_z, radius, UNBOUNDED: tl.constexpr):
    """World points to the unit cube."""
    x, y, z = (x - centre_x) / radius, (y - centre_y) / radius, (z - centre_z) / radius
    if UNBOUNDED:
        scale, _ = contraction(x, y, z)
        return x * scale * 0.25 + 0.5, y * scale * 0.25 + 0.5, z * scale * 0.25 + 0.5
    else:
        return x * 0.5 + 0.5, y * 0.5 + 0.5, z * 0.5 + 0.5


@triton.jit
@no_type_check
def to_unit_backward(x, y, z, gx, gy, gz, centre_x, centre_y, centre_z, radius, UNBOUNDED: tl.constexpr):
    """Gradient to world points from the gradient to points of the unit cube."""
    if UNBOUNDED:
        x, y, z = (x - centre_x) / radius, (y - centre_y) / radius, (z - centre_z) / radius
        scale, norm = contraction(x, y, z)
        # the scale depends on the widest coordinate alone
        slope = tl.where(norm <= 1, 0.0, (2 / norm - 2) / (norm * norm)) * (x * gx + y * gy + z * gz)
        x_widest = tl.abs(x) >= norm
        y_widest = (tl.abs(y) >= norm) & (x_widest == 0)
        z_widest = (x_widest == 0) & (y_widest == 0)
        gx = scale * gx + tl.where(x_widest, tl.where(x < 0, -slope, slope), 0.0)
        gy = scale * gy + tl.where(y_widest, tl.where(y < 0, -slope, slope), 0.0)
        gz = scale * gz + tl.where(z_widest, tl.where(z < 0, -slope, slope), 0.0)
        return gx * 0.25 / radius, gy * 0.25 / radius, gz * 0.25 / radius
    else:
        return gx * 0.5 / radius, gy * 0.5 / radius, gz * 0.5 / radius


@triton.jit
@no_type_check
def step_in_radii(t, radius, step, near, growth, UNBOUNDED: tl.constexpr):
    """Length of ray that a sample stands for, in scene radii."""
    if UNBOUNDED:
        beyond = (t - near) / radius
        return growth * tl.sqrt(1 + beyond * beyond)
    else:
        return tl.zeros_like(t) + step / radius
