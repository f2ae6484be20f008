"""Places a robot could photograph next: a ring about where it stands, kept out of matter."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.radiance.engine import RadianceEngine

_UP = np.array([0.0, 0.0, 1.0])
_STRAIGHT_DOWN_SINE = 1e-3  # below this the vertical no longer fixes the camera's roll


@dataclass(frozen=True)
class CandidateConfig:
    """The ring of candidate views (paper, section Active Image Capturing)."""

    directions: int = 8
    """Horizontal directions to try, evenly spread, the first straight ahead."""
    distance_m: float = 0.5
    """Length of the move."""
    look_at_centre: bool = True
    """Turn each candidate to the scene's centre; otherwise keep the present heading."""
    max_density_per_m: float = 5.0
    """A move is free where the field's density stays below this."""
    clearance_m: float = 0.1
    """Radius about the candidate that must be free as well."""
    check_spacing_m: float = 0.02
    """Distance between the points at which the way is checked."""


def look_at(
    position_m: Float[NDArray, "3"], target_m: Float[NDArray, "3"], right_hint: Float[NDArray, "3"]
) -> Float[NDArray, "4 4"]:
    """Upright camera pose (OpenGL axes, world z up) at a position, looking at a target.

    ``right_hint`` settles the roll of a vertical view, and the heading where target and position meet.
    """
    backward = position_m - target_m
    length = np.linalg.norm(backward)
    backward = backward / length if length > 1e-9 else np.cross(right_hint, _UP)
    backward = backward / np.linalg.norm(backward)
    right = np.cross(_UP, backward)
    if np.linalg.norm(right) < _STRAIGHT_DOWN_SINE:
        right = right_hint - backward * (right_hint @ backward)
    right = right / np.linalg.norm(right)
    return se3.from_parts(np.stack([right, np.cross(backward, right), backward], -1), position_m)


def ring_of_candidates(
    T_world_camera: Float[NDArray, "4 4"], centre_m: Float[NDArray, "3"], config: CandidateConfig
) -> Float[NDArray, "n 4 4"]:
    """Camera poses on a horizontal ring about the present one, not yet checked for free space."""
    position, right = T_world_camera[:3, 3], T_world_camera[:3, 0]
    # the horizontal part of "right" is well defined however steeply the camera looks down
    ahead_rad = np.arctan2(right[1], right[0]) + np.pi / 2
    angle = ahead_rad + 2 * np.pi * np.arange(config.directions) / config.directions
    step = config.distance_m * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    if config.look_at_centre:
        return np.stack([look_at(position + s, centre_m, right) for s in step])
    return se3.from_parts(np.broadcast_to(T_world_camera[:3, :3], (len(step), 3, 3)), position + step)


def is_free(
    engine: RadianceEngine,
    start_m: Float[NDArray, "3"],
    goals_m: Float[NDArray, "n 3"],
    config: CandidateConfig,
) -> Bool[NDArray, "n"]:
    """Whether the straight way to each goal, and a ball about the goal, are free of matter in the field."""
    steps = max(2, int(np.ceil(config.distance_m / config.check_spacing_m)) + 1)
    fraction = np.linspace(0, 1, steps)[None, :, None]
    way = start_m + fraction * (goals_m - start_m)[:, None]
    directions = np.array(
        [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z]
    )
    ball = directions / np.linalg.norm(directions, axis=1, keepdims=True) * config.clearance_m
    points = np.concatenate([way, goals_m[:, None] + ball, goals_m[:, None] + 0.5 * ball], axis=1)
    density = engine.density(torch.tensor(points.reshape(-1, 3), dtype=torch.float32)).cpu().numpy()
    return density.reshape(points.shape[:2]).max(axis=1) < config.max_density_per_m


def free_candidates(
    engine: RadianceEngine,
    T_world_camera: Float[NDArray, "4 4"],
    centre_m: Float[NDArray, "3"],
    config: CandidateConfig,
) -> Float[NDArray, "n 4 4"]:
    """Candidate camera poses in the world that the robot can reach in a straight line; possibly none.

    Args:
        engine: The field, whose density tells matter from free space.
        T_world_camera: Where the robot's camera is now (OpenGL axes).
        centre_m: Scene centre in the world.
        config: The ring.
    """
    ring = ring_of_candidates(T_world_camera, centre_m, config)
    return ring[is_free(engine, T_world_camera[:3, 3], ring[:, :3, 3], config)]
