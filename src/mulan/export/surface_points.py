"""A point cloud of what the photographs show, at the field's depths."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from mulan.errors import InputError
from mulan.export.crop import Box
from mulan.export.surface_hits import surface_hits
from mulan.mission.coloured_points import ColouredPoints
from mulan.mission.posed_images import PosedImageSet
from mulan.radiance.engine import RadianceEngine

_ROUNDS = 4  # pixels drawn beyond what is wanted, since some see nothing
LEAST_OPACITY, LEAST_SHARPNESS = 0.5, 0.7


@dataclass(frozen=True)
class PointCloudConfig:
    """Surface points seen through randomly drawn pixels of the training photographs."""

    count: int = 200_000
    """Points to aim for; fewer come where much of the photographs shows nothing."""
    seed: int = 0
    """Of the drawing."""


def surface_points(
    engine: RadianceEngine,
    images: PosedImageSet,
    config: PointCloudConfig,
    crop: Box | None,
    progress: Callable[[float, float, str], None],
) -> ColouredPoints:
    """Follow random pixels to the surface; what they see at edges, or hardly at all, is left out.

    Args:
        engine: The field.
        images: Where photographs were taken.
        config: How many.
        crop: Points outside are left out; None keeps all.
        progress: Called with what is done.

    Raises:
        InputError: ``count`` is not positive, or no pixel sees a surface.
    """
    if config.count < 1:
        raise InputError("--points", "count", f"is {config.count}", "give one or more")
    rng = np.random.default_rng(config.seed)
    found: list[ColouredPoints] = []
    missing, tried = config.count, 0
    for turn in range(_ROUNDS):
        hit_share = (config.count - missing) / tried if tried else 1.0
        per_image = math.ceil(missing / hit_share / len(images.train))
        tried += per_image * len(images.train)
        for index, image in enumerate(images.train):
            progress(turn * len(images.train) + index, _ROUNDS * len(images.train), "")
            pixels = rng.uniform(size=(per_image, 2)) * [image.camera.width, image.camera.height]
            R, origin = image.T_world_camera[:3, :3], image.T_world_camera[:3, 3]
            directions = image.camera.unproject(pixels) @ R.T
            d = torch.from_numpy(directions.astype(np.float32))
            o = torch.from_numpy(origin.astype(np.float32)).expand(len(d), 3)
            hits = surface_hits(engine, o.contiguous(), d)
            position_m = origin + hits.distance_m.double().numpy()[:, None] * directions
            good = ((hits.opacity > LEAST_OPACITY) & (hits.sharpness > LEAST_SHARPNESS)).numpy()
            if crop is not None:
                good &= crop.holds(position_m)
            colour = (hits.colour.numpy() * 255).round().astype(np.uint8)
            found.append(ColouredPoints(position_m[good], colour[good], hits.variance.numpy()[good]))
        missing = config.count - sum(len(part.position_m) for part in found)
        if missing <= 0 or missing == config.count:
            break
    points = ColouredPoints(*(np.concatenate([getattr(part, n) for part in found]) for n in _FIELDS))
    if not len(points.position_m):
        raise InputError(
            images.source,
            "field",
            "shows no surface in the cropped part" if crop is not None else "shows no surface",
            "widen --crop or train longer",
        )
    chosen = np.sort(rng.permutation(len(points.position_m))[: config.count])
    return ColouredPoints(*(getattr(points, name)[chosen] for name in _FIELDS))


_FIELDS = ("position_m", "colour", "variance")
