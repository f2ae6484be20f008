"""A scene with a closed form: two coloured spheres before white."""

import torch
from torch import Tensor

from mulan.radiance.engine import RayBatch

CENTRES = torch.tensor([[0.25, 0.0, 0.1], [-0.35, 0.2, -0.1]])
RADII = torch.tensor([0.4, 0.25])


def colours_seen(o: Tensor, d: Tensor) -> Tensor:
    """Colours along rays: the position on the nearer sphere as colour."""
    nearest, colour = torch.full((len(o),), torch.inf), torch.ones(len(o), 3)
    for centre, radius in zip(CENTRES, RADII, strict=True):
        b = ((o - centre) * d).sum(-1)
        discriminant = b**2 - (o - centre).square().sum(-1) + radius**2
        t = -b - discriminant.clamp_min(0).sqrt()
        hit = (discriminant > 0) & (t > 0) & (t < nearest)
        point = o + t[:, None] * d
        colour = torch.where(hit[:, None], 0.5 + 0.45 * (point - centre) / radius, colour)
        nearest = torch.where(hit, t, nearest)
    return colour


def rays_around(n: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    o = torch.nn.functional.normalize(torch.randn(n, 3, generator=generator), dim=-1) * 2.5
    target = (torch.rand(n, 3, generator=generator) * 2 - 1) * 0.7
    return o, torch.nn.functional.normalize(target - o, dim=-1)


def batch_around(n: int, generator: torch.Generator, rays_a_pixel: int = 1) -> RayBatch:
    """Pixels of nearly parallel rays from one point, with the mean of what the rays see."""
    o, d = (x.repeat_interleave(rays_a_pixel, 0) for x in rays_around(n // rays_a_pixel, generator))
    if rays_a_pixel > 1:
        d = torch.nn.functional.normalize(d + 0.01 * torch.randn(n, 3, generator=generator), dim=-1)
    seen = colours_seen(o, d).view(-1, rays_a_pixel, 3).mean(1).repeat_interleave(rays_a_pixel, 0)
    return RayBatch(o, d, seen, torch.ones(n), torch.zeros(n, dtype=torch.int64), rays_a_pixel=rays_a_pixel)
