"""Where the scene is, judged from the cameras and, if the object was cut out, from its outlines."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry.alignment import point_nearest_to_axes
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage

OUTLINE_MARGIN = 1.1
OUTLINE_QUANTILE = 0.9  # of the images; a few badly posed ones must not blow up the box


def choose_space(images: Sequence[CapturedImage]) -> SceneSpace:
    """A box about a cut-out object, or the whole world contracted about the point the cameras look at.

    Bounded (every image has transparency): the centre is the point nearest all optical axes and the half
    side is the radius of the sphere about it that the outlines fill, so the object stays inside however the
    world is turned. Unbounded: same centre, radius = median camera distance.
    """
    T = np.stack([image.T_world_camera for image in images])
    centre, distance_m = look_at_centre(T[:, :3, 3], -T[:, :3, 2])
    if any(image.alpha is None for image in images):
        return SceneSpace(_tuple(centre), distance_m, unbounded=True)
    extents = np.array([_outline_extent_m(image, centre) for image in images])
    extent = float(np.quantile(extents, OUTLINE_QUANTILE)) * OUTLINE_MARGIN
    return SceneSpace(_tuple(centre), min(extent, distance_m) if extent > 0 else distance_m, unbounded=False)


def look_at_centre(
    origins: Float[NDArray, "n 3"], forward: Float[NDArray, "n 3"]
) -> tuple[Float[NDArray, "3"], float]:
    """The point cameras look at and their median distance from it [m].

    Cameras that look outward, or all the same way, have no such point in front of them: then it is
    the mean camera position (pushed along the common view), at a distance of the cameras' own spread.
    """
    middle = origins.mean(0)
    spread_m = float(np.linalg.norm(origins - middle, axis=1).max())
    centre = point_nearest_to_axes(origins, forward)
    offset = centre - origins
    depth = (offset * forward).sum(1)
    distance_m = float(np.median(np.linalg.norm(offset, axis=1)))
    in_front = np.mean(depth > 0) > 0.5
    if in_front and distance_m > 0 and distance_m < 20 * max(spread_m, 1e-9):
        return centre, distance_m
    reach_m = spread_m if spread_m > 0 else 1.0
    return middle + reach_m * forward.mean(0), reach_m


def _outline_extent_m(image: CapturedImage, centre: Float[NDArray, "3"]) -> float:
    """Largest distance from the centre to a viewing ray that meets the object."""
    assert image.alpha is not None
    seen = image.alpha > 0
    if not seen.any():
        return 0.0
    directions = image.camera.pixel_directions()[seen] @ image.T_world_camera[:3, :3].T
    to_centre = centre - image.T_world_camera[:3, 3]
    return float(np.linalg.norm(np.cross(directions, to_centre), axis=1).max())


def _tuple(point: Float[NDArray, "3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in point)
    return x, y, z
