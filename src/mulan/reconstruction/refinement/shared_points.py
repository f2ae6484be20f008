"""What photographs say of all poses together when the scene they show was learnt from the same photographs.

A field held still would make every pose look as if it were known to a hundredth of a pixel. But a point
of the scene follows the images that see it: only what they disagree on says anything. So every compared point
has a place and a colour of its own, which are eliminated (the Schur complement of bundle adjustment, with the
field's own gradients as the images').
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.refinement.compared_pixels import ComparedPixels

_LEAST_OPACITY = 0.9  # of a ray that meets a surface
_SAME_DEPTH = 0.02  # share of the distance within which two rays meet the same surface
_COLOUR_SIGMA, _PLACE_SHARE = 0.5, 0.05  # how far off a point may be: colour, share of its distance


@dataclass(frozen=True)
class SharedPoints:
    """Points of the scene, and how each image that sees one feels its own pose and the point's place.

    Attributes:
        seen: Which image sees which point.
        by_pose: Derivative of the colour along the point's axis by a right perturbation of each pose.
        by_place: The same by the point's place.
        weight: Independent points each stands for.
        distance_m: From the image each was drawn in.
    """

    seen: Bool[NDArray, "p n"]
    by_pose: Float[NDArray, "p n 6"]
    by_place: Float[NDArray, "p n 3"]
    weight: Float[NDArray, "p"]
    distance_m: Float[NDArray, "p"]


def shared_points(
    field: RadianceEngine,
    compared: ComparedPixels,
    points_an_image: int,
    pixels_a_residual: float,
    generator: torch.Generator,
) -> SharedPoints:
    """Draw points in every image and look at them from all others.

    Args:
        field: The scene.
        compared: Photographs at their poses, and the pixels to draw.
        points_an_image: Points drawn in each.
        pixels_a_residual: Neighbouring pixels whose residuals agree, as an area.
        generator: Source of randomness.
    """
    data, n = compared.data, len(compared.data)
    draw = compared.draw(np.arange(n), points_an_image, pixels_a_residual, generator)
    rays = data.rays(draw.pixel.reshape(-1))
    rendering = field.render(rays.origins, rays.directions)
    solid = rendering.opacity > _LEAST_OPACITY
    depth_m = rendering.depth_m[solid]
    points = (rays.origins[solid] + depth_m[:, None] * rays.directions[solid]).double()
    axis = draw.axis[solid]
    weight = draw.weight.reshape(-1)[solid.numpy()]
    T = data.T_world_camera.double()
    offset = points[:, None] - T[None, :, :3, 3]
    distance_m = offset.norm(dim=-1)
    p, i = _inside(data, points.numpy(), T.numpy()).nonzero()
    directions = (offset[p, i] / distance_m[p, i, None]).float()
    origins = data.T_world_camera[i, :3, 3].contiguous()
    met = field.render(origins, directions)
    off = (met.depth_m - distance_m[p, i]).abs() / distance_m[p, i]
    same = ((off < _SAME_DEPTH) & (met.opacity > _LEAST_OPACITY)).numpy()
    p, i, origins, directions = p[same], i[same], origins[same], directions[same]
    _, gradients = field.ray_gradients(origins, directions, axis[p])
    R = data.T_world_camera[i, :3, :3]
    turned = torch.cross(directions, gradients.directions, dim=-1)
    J = torch.cat([_in_camera(turned, R), _in_camera(gradients.origins, R)], -1).double().numpy()
    seen = np.zeros((len(points), n), dtype=bool)
    seen[p, i] = True
    by_pose, by_place = np.zeros((len(points), n, 6)), np.zeros((len(points), n, 3))
    # moving the camera one way shows what moving the point the other way would
    by_pose[p, i], by_place[p, i] = J, -gradients.origins.double().numpy()
    # each point could have been drawn in every image that sees it
    weight = weight / np.maximum(seen.sum(1), 1)
    return SharedPoints(seen, by_pose, by_place, weight, depth_m.double().numpy())


def joint_information(
    points: SharedPoints, sigma: Float[NDArray, "n"], image: Int[NDArray, "k"]
) -> Float[NDArray, "m m"]:
    """Information on the poses of some images together, those of the others being known.

    Args:
        points: Seen from all images.
        sigma: Standard deviation of the residuals of each image.
        image: Which poses are unknown.
    """
    k = len(image)
    place = np.full(points.seen.shape[1], -1)
    place[image] = np.arange(k)
    information = np.zeros((k, 6, k, 6))
    for p in np.flatnonzero(points.seen.sum(1) > 1):
        by = np.flatnonzero(points.seen[p])
        B = np.concatenate([points.by_place[p, by], np.ones((len(by), 1))], 1) / sigma[by, None]
        sure = np.array([1 / (_PLACE_SHARE * points.distance_m[p]) ** 2] * 3 + [1 / _COLOUR_SIGMA**2])
        unknown = by[place[by] >= 0]
        if not len(unknown):
            continue
        J = points.by_pose[p, unknown] / sigma[unknown, None]
        own = B[place[by] >= 0]
        left = np.eye(len(unknown)) - own @ np.linalg.solve(B.T @ B + np.diag(sure), own.T)
        block = points.weight[p] * np.einsum("ja,jk,kb->jakb", J, left, J)
        at = place[unknown]
        information[at[:, None], :, at[None, :], :] += block.transpose(0, 2, 1, 3)
    return information.reshape(6 * k, 6 * k)


def _inside(
    data: PosedPixels, points: Float[NDArray, "p 3"], T: Float[NDArray, "n 4 4"]
) -> Bool[NDArray, "p n"]:
    """Which image shows the place of which point."""
    inside = np.zeros((len(points), len(T)), dtype=bool)
    for i, image in enumerate(data.images):
        camera = image.camera
        at = camera.project((points - T[i, :3, 3]) @ T[i, :3, :3])
        with np.errstate(invalid="ignore"):
            inside[:, i] = ((at >= 0) & (at < [camera.width, camera.height])).all(1)
    return inside


def _in_camera(v: Float[Tensor, "r 3"], R: Float[Tensor, "r 3 3"]) -> Float[Tensor, "r 3"]:
    return torch.einsum("ra,rab->rb", v, R)
