"""How the colours of a field disagree with photographs, and what that says about the cameras' poses."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.radiance.engine import RadianceEngine, RayBatch
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.refinement.compared_pixels import PixelDraw

CAUCHY = 2.385  # sigmas; 95 % efficient on Gaussian residuals
_LEAST_SIGMA = 0.004  # an 8-bit photograph is no better known


@dataclass(frozen=True)
class PhotometricTerms:
    """Gauss-Newton's view of the photographs' cost about the present poses.

    Attributes:
        information: Second derivative by a right perturbation of each pose.
        gradient: First derivative.
        cost: Of each image.
        sigma: Robust standard deviation of its residuals (a colour's projection on a random axis).
    """

    information: Float[NDArray, "n 6 6"]
    gradient: Float[NDArray, "n 6"]
    cost: Float[NDArray, "n"]
    sigma: Float[NDArray, "n"]

    def by_metres(self, metres_per_unit: float) -> "PhotometricTerms":
        """The same by translations in the world, the poses being those in a field of another unit."""
        per = np.repeat([1.0, 1 / metres_per_unit], 3)
        return replace(self, information=self.information * per[:, None] * per, gradient=self.gradient * per)


def photometric_terms(
    field: RadianceEngine,
    data: PosedPixels,
    draw: PixelDraw,
    T: Float[NDArray, "n 4 4"],
    sigma: Float[NDArray, "n"] | None = None,
) -> PhotometricTerms:
    """Cost of the drawn pixels and its derivatives by the poses (Cauchy's loss, iteratively reweighted).

    Args:
        field: What the cameras look at.
        data: The photographs; their poses are not used.
        draw: Pixels to compare at.
        T: Poses of the drawn images.
        sigma: Scale of the residuals; estimated if not given.
    """
    batch = _rays(data, draw, T)
    n, r = draw.pixel.shape
    rendering, gradients = field.ray_gradients(batch.origins, batch.directions, draw.axis)
    residual = ((rendering.colour - batch.colours) * draw.axis).sum(-1).view(n, r).double().numpy()
    sigma = residual_sigma(residual, draw.weight) if sigma is None else sigma
    R = torch.from_numpy(T[:, :3, :3]).float()
    turned = torch.cross(batch.directions, gradients.directions, dim=-1).view(n, r, 3)
    J = torch.cat([turned @ R, gradients.origins.view(n, r, 3) @ R], -1).double().numpy()
    scaled = residual / sigma[:, None]
    trust = draw.weight / (1 + (scaled / CAUCHY) ** 2) / sigma[:, None] ** 2
    information = np.einsum("nr,nra,nrb->nab", trust, J, J)
    gradient = np.einsum("nr,nra->na", trust * residual, J)
    return PhotometricTerms(information, gradient, _cost(scaled, draw), sigma)


def photometric_cost(
    field: RadianceEngine,
    data: PosedPixels,
    draw: PixelDraw,
    T: Float[NDArray, "n 4 4"],
    sigma: Float[NDArray, "n"],
) -> Float[NDArray, "n"]:
    """Cost of the drawn pixels at other poses."""
    return _cost(residuals(field, data, draw, T) / sigma[:, None], draw)


def residuals(
    field: RadianceEngine, data: PosedPixels, draw: PixelDraw, T: Float[NDArray, "n 4 4"]
) -> Float[NDArray, "n r"]:
    """Field minus photograph at the drawn pixels, along their axes."""
    batch = _rays(data, draw, T)
    colour = field.render(batch.origins, batch.directions).colour
    return ((colour - batch.colours) * draw.axis).sum(-1).view(draw.pixel.shape).double().numpy()


def residual_sigma(residual: Float[NDArray, "n r"], weight: Float[NDArray, "n r"]) -> Float[NDArray, "n"]:
    """Robust scale of each image's residuals.

    Between the median absolute deviation, which flat background makes vanish, and the root mean square,
    which a few occluded pixels blow up: the root mean square of residuals cut at Cauchy's scale of the
    mean absolute one.
    """
    share = weight / weight.sum(1, keepdims=True)
    cut = CAUCHY * 1.2533 * (share * np.abs(residual)).sum(1, keepdims=True)
    return np.maximum(np.sqrt((share * np.minimum(residual**2, cut**2)).sum(1)), _LEAST_SIGMA)


def _cost(scaled: Float[NDArray, "n r"], draw: PixelDraw) -> Float[NDArray, "n"]:
    return 0.5 * CAUCHY**2 * (draw.weight * np.log1p((scaled / CAUCHY) ** 2)).sum(1)


def _rays(data: PosedPixels, draw: PixelDraw, T: Float[NDArray, "n 4 4"]) -> RayBatch:
    """In main memory, wherever the photographs are kept: a few thousand, and poses are solved for there."""
    poses = data.T_world_camera.clone()
    poses[torch.from_numpy(draw.image)] = torch.from_numpy(T).float().to(poses.device)
    return data.rays_at(draw.pixel.reshape(-1).to(poses.device), poses).to(torch.device("cpu"))
