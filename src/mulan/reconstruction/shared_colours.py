"""The same place of the scene in photographs of two robots: what each camera makes of its colour."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from mulan.radiance.engine import RadianceEngine, RayBatch
from mulan.reconstruction.posed_pixels import PosedPixels

_LEAST_OPACITY = 0.9  # of a ray that meets a surface, and of a pixel that shows nothing else
_SAME_DEPTH = 0.005  # share of the distance within which two rays meet the same surface, at least
_CANDIDATES = 8  # photographs of which the nearest is looked into
_DARK = 0.05  # colours below tell no ratio
_CLIPPED = 254.5 / 255


@dataclass(frozen=True)
class SharedColours:
    """Pairs of pixels that show one place.

    Attributes:
        image: The two photographs of each pair, by their number.
        colour: Their colours as photographed.
    """

    image: Int[NDArray, "p 2"]
    colour: Float[NDArray, "p 2 3"]

    def log_ratios(self, robot: Int[NDArray, "n"], first: int, second: int) -> Float[NDArray, "q 3"]:
        """The second robot's log-brightness over the first's, in all their pairs; NaN where too dark to tell.

        Args:
            robot: Which robot took each photograph.
            first: One robot.
            second: The other.
        """
        log = np.log(np.maximum(self.colour, 1e-3))
        log[log.mean(1, keepdims=True).repeat(2, 1) < math.log(_DARK)] = np.nan
        a, b = robot[self.image].T
        ahead, behind = (a == first) & (b == second), (a == second) & (b == first)
        return np.concatenate([(log[:, 1] - log[:, 0])[ahead], (log[:, 0] - log[:, 1])[behind]])


def shared_colours(
    field: RadianceEngine,
    data: PosedPixels,
    robot: Int[NDArray, "n"],
    points: int,
    generator: torch.Generator,
) -> SharedColours:
    """Draw pixels of all photographs, and look each place up in one photograph of another robot.

    Only the field's shape is used, not its colours. Left out: places the second camera does not see, pixels
    that are clipped in either photograph, or of no weight.

    Args:
        field: The scene.
        data: Photographs.
        robot: Which robot took each.
        points: Pixels to draw.
        generator: Source of randomness.
    """
    first = torch.randint(len(data), (points,), generator=generator).numpy()
    at = torch.rand(points, generator=generator, dtype=torch.float64).numpy()
    T = data.T_world_camera.double().cpu().numpy()
    second = _of_another_robot(robot, T[:, :3, 3], first, generator)
    first, at, second = (each[second >= 0] for each in (first, at, second))
    sizes = np.array([image.colour[..., 0].size for image in data.images])
    pixel = np.array([data.first_pixel(int(i)) for i in first], dtype=np.int64)
    one = _look(field, data, pixel + (at * sizes[first]).astype(np.int64))
    looked_up = _pixels_showing(data, second, one.place_m)
    visible = one.usable & (looked_up >= 0)
    first, second = first[visible], second[visible]
    if not len(first):
        return SharedColours(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2, 3)))
    other = _look(field, data, looked_up[visible])
    distance_m = np.linalg.norm(one.place_m[visible] - T[second, :3, 3], axis=1)
    # half a pixel aside, a slanting surface is deeper by about as much as half a pixel is wide
    focal_px = np.array([data.images[i].camera.fx for i in second])
    tolerance_m = np.maximum(_SAME_DEPTH, 0.5 / focal_px) * distance_m
    same = other.usable & (np.abs(other.depth_m - distance_m) < tolerance_m)
    colour = np.stack([one.colour[visible], other.colour], 1)[same]
    return SharedColours(np.stack([first, second], 1)[same], colour)


@dataclass(frozen=True)
class _Looked:
    place_m: Float[NDArray, "p 3"]
    depth_m: Float[NDArray, "p"]
    colour: Float[NDArray, "p 3"]
    usable: Bool[NDArray, "p"]


def _look(field: RadianceEngine, data: PosedPixels, pixel: Int[NDArray, "p"]) -> _Looked:
    batch = data.rays(torch.from_numpy(pixel).to(data.T_world_camera.device))
    rendering = field.render(batch.origins, batch.directions)
    place = batch.origins + rendering.depth_m[:, None] * batch.directions
    colour = _as_photographed(batch, data)
    usable = (rendering.opacity > _LEAST_OPACITY) & (batch.weights > 0) & (colour < _CLIPPED).all(-1)
    if batch.opacity is not None:
        usable &= batch.opacity > _LEAST_OPACITY
    place, depth, colour = (x.double().cpu().numpy() for x in (place, rendering.depth_m, colour))
    return _Looked(place, depth, colour, usable.cpu().numpy())


def _as_photographed(batch: RayBatch, data: PosedPixels) -> Float[Tensor, "r 3"]:
    """Without the white behind what was cut out, and before any division."""
    colour = batch.colours if batch.opacity is None else batch.colours - (1 - batch.opacity)[:, None]
    return colour if data.image_gain is None else colour * data.image_gain[batch.image_index]


def _of_another_robot(
    robot: Int[NDArray, "n"],
    position_m: Float[NDArray, "n 3"],
    image: Int[NDArray, "p"],
    generator: torch.Generator,
) -> Int[NDArray, "p"]:
    """For each image one of another robot, the nearest of a few drawn; -1 where there is none."""
    chance = torch.rand(len(image), _CANDIDATES, generator=generator, dtype=torch.float64).numpy()
    found = np.full(len(image), -1)
    for own in np.unique(robot):
        others, mine = np.flatnonzero(robot != own), np.flatnonzero(robot[image] == own)
        if len(others) and len(mine):
            drawn = others[(chance[mine] * len(others)).astype(np.int64)]
            apart_m = np.linalg.norm(position_m[drawn] - position_m[image[mine], None], axis=-1)
            found[mine] = drawn[np.arange(len(mine)), apart_m.argmin(1)]
    return found


def _pixels_showing(
    data: PosedPixels, image: Int[NDArray, "p"], place_m: Float[NDArray, "p 3"]
) -> Int[NDArray, "p"]:
    """Number of the pixel of each image where a place would be seen; -1 outside of it."""
    T, pixel = data.T_world_camera.double().cpu().numpy(), np.full(len(image), -1, dtype=np.int64)
    for i in np.unique(image):
        mine, camera = np.flatnonzero(image == i), data.images[i].camera
        at = camera.project((place_m[mine] - T[i, :3, 3]) @ T[i, :3, :3])
        with np.errstate(invalid="ignore"):
            inside = ((at >= 0) & (at < [camera.width, camera.height])).all(1)
        column, row = np.floor(at[inside]).astype(np.int64).T
        pixel[mine[inside]] = data.first_pixel(int(i)) + row * camera.width + column
    return pixel
