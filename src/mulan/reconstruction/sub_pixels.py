"""Several rays a pixel: a photograph's pixel is the mean over its area, not the colour along its centre.

Judging the mean of several rays lets the field keep what is sharper than a pixel (supersampling; Mip-NeRF,
Barron et al. 2021, reaches the same end with cones).
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from mulan.radiance.engine import Rendering

ANTIALIAS_SHARE = 0.3  # of a training; longer gains nothing more and learns from fewer pixels


@runtime_checkable
class Renders(Protocol):
    """Anything that renders rays."""

    def render(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """Colour, depth, opacity and colour variance along rays."""
        ...


@dataclass(frozen=True)
class Antialiasing:
    """When pixels are learnt as several rays.

    Attributes:
        share: Last share of the training in which they are; 0 = never.
    """

    share: float

    @staticmethod
    def choose(wanted: float | None, unbounded: bool, on_gpu: bool = False) -> "Antialiasing":
        """What was asked for, or what suits the scene: photographs of whole places gained nothing.

        The GPU engine learns one ray a pixel only.
        """
        if wanted is not None:
            return Antialiasing(wanted)
        return Antialiasing(0.0 if unbounded or on_gpu else ANTIALIAS_SHARE)

    def began(self, fraction_done: float) -> bool:
        """Whether pixels are several rays by now."""
        return self.share > 0 and fraction_done >= 1 - self.share

    @property
    def sub_pixels(self) -> int:
        """Rays a side of a pixel in pictures of the finished field."""
        return 2 if self.share > 0 else 1


def lattice(side: int) -> Float[Tensor, "k 2"]:
    """Centres of a pixel's ``side`` × ``side`` parts, from the pixel's centre, in pixels (right, down)."""
    at = (torch.arange(side) + 0.5) / side - 0.5
    return torch.stack(torch.meshgrid(at, at, indexing="xy"), -1).view(-1, 2)


def random_diagonals(pixels: int, generator: torch.Generator) -> Float[Tensor, "p 2 2"]:
    """One of the two diagonals of ``lattice(2)`` for each pixel: half its rays, without bias."""
    down = (torch.randint(2, (pixels,), generator=generator) * 2 - 1).float()
    right = torch.tensor([-1.0, 1.0]).expand(pixels, 2)
    return torch.stack([right, right * down[:, None]], -1) / 4


def spread_directions(
    directions: Float[Tensor, "r 3"],
    R_world_camera: Float[Tensor, "r 3 3"],
    focal_px: Float[Tensor, "r 2"],
    offset_px: Float[Tensor, "r k 2"],
) -> Float[Tensor, "rk 3"]:
    """Unit directions of pixels moved by offsets, a pixel's ``k`` one after another.

    What a distorting lens stretches within one pixel is neglected: a few per cent of the offset.

    Args:
        directions: World directions of the pixels' centres.
        R_world_camera: Orientation of each pixel's camera (OpenGL axes).
        focal_px: Its focal lengths (x, y).
        offset_px: Where each pixel's rays pass, from its centre (right, down).
    """
    right, up, back = R_world_camera.unbind(-1)
    at_depth_one = directions / -(directions * back).sum(-1, keepdim=True)
    shift = (offset_px / focal_px[:, None, :])[..., None]
    moved = at_depth_one[:, None] + shift[:, :, 0] * right[:, None] - shift[:, :, 1] * up[:, None]
    return functional.normalize(moved.view(-1, 3), dim=-1)


def render_pixels(
    engine: Renders,
    origins: Float[Tensor, "r 3"],
    directions: Float[Tensor, "r 3"],
    R_world_camera: Float[Tensor, "r 3 3"],
    focal_px: Float[Tensor, "r 2"],
    sub_pixels: int,
) -> Rendering:
    """What pixels see: the mean over ``sub_pixels`` × ``sub_pixels`` rays; depth is the mean of what is hit.

    Args:
        engine: The field.
        origins: Camera positions.
        directions: World directions of the pixels' centres.
        R_world_camera: Orientation of each pixel's camera (OpenGL axes).
        focal_px: Its focal lengths (x, y).
        sub_pixels: Rays a side of a pixel.
    """
    if sub_pixels == 1:
        return engine.render(origins, directions)
    k, pixels = sub_pixels**2, len(origins)
    offset_px = lattice(sub_pixels).expand(pixels, k, 2)
    r = engine.render(
        origins.repeat_interleave(k, 0), spread_directions(directions, R_world_camera, focal_px, offset_px)
    )
    opacity = r.opacity.view(pixels, k).mean(1)
    moment = (r.opacity * r.depth_m).view(pixels, k).mean(1)
    return Rendering(
        colour=r.colour.view(pixels, k, 3).mean(1),
        depth_m=moment / opacity.clamp_min(1e-10),
        opacity=opacity,
        variance=r.variance.view(pixels, k).mean(1),
    )
