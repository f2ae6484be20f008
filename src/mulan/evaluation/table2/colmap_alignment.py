"""What a map by COLMAP says about where the robots are, in the anchor's start frame."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.table2.colmap import ColmapMap
from mulan.geometry.alignment import umeyama
from mulan.mission.posed_images import PosedImage, PosedImageSet

NEEDED = 3  # photographs of a robot that tell where its start frame is in the map


class AlignmentFailedError(Exception):
    """The map does not tell where the robots are; the message says why."""


def between_robots(found: ColmapMap, odometry: PosedImageSet, anchor: str) -> PosedImageSet:
    """The paper's setup E: each robot's own odometry, the transform between their start frames by COLMAP.

    The map is carried into the anchor's start frame by the similarity that best takes the anchor's cameras to
    its odometry; another robot's start frame is where the rigid transform lies that best takes its odometry
    to its cameras in the map.

    Args:
        found: COLMAP's largest map.
        odometry: All photographs at each robot's own odometry, in its own start frame.
        anchor: Robot whose start frame is the world.

    Raises:
        AlignmentFailedError: There is no map, or it holds too few photographs of a robot.
    """
    in_world = _carried(found, odometry, anchor)
    robots = {image.robot_id: np.eye(4) for image in odometry.train}
    for robot in robots:
        if robot != anchor:
            own = _placed(found, odometry, robot or "")
            cameras_m = _positions(odometry.train[i].T_world_camera for i in own)
            robots[robot], _ = umeyama(cameras_m, _positions(in_world[i] for i in own))
    train = tuple(
        replace(image, T_world_camera=robots[image.robot_id] @ image.T_world_camera)
        for image in odometry.train
    )
    return replace(odometry, train=train)


def by_colmap_alone(found: ColmapMap, odometry: PosedImageSet, anchor: str) -> PosedImageSet:
    """The photographs COLMAP placed, at its own poses; the anchor's odometry carries them into the world.

    Raises:
        AlignmentFailedError: There is no map, or it holds too few photographs of the anchor.
    """
    in_world = _carried(found, odometry, anchor)
    train: list[PosedImage] = [
        replace(odometry.train[i], T_world_camera=in_world[i]) for i in sorted(in_world)
    ]
    return replace(odometry, train=tuple(train))


def _carried(found: ColmapMap, odometry: PosedImageSet, anchor: str) -> dict[int, Float[NDArray, "4 4"]]:
    """The map's cameras in the anchor's start frame."""
    if found.why_not is not None:
        raise AlignmentFailedError(found.why_not)
    own = _placed(found, odometry, anchor)
    source = _positions(found.T_map_camera[i] for i in own)
    target = _positions(odometry.train[i].T_world_camera for i in own)
    T_world_map, scale = umeyama(source, target, with_scale=True)
    carried = {}
    for i, T in found.T_map_camera.items():
        scaled = T.copy()
        scaled[:3, 3] *= scale
        carried[i] = T_world_map @ scaled
    return carried


def _placed(found: ColmapMap, odometry: PosedImageSet, robot: str) -> list[int]:
    own = sorted(i for i in found.T_map_camera if odometry.train[i].robot_id == robot)
    if len(own) < NEEDED:
        count = f"{len(found.T_map_camera)} of {found.of} photographs"
        raise AlignmentFailedError(f"COLMAP's largest map of {count} holds {len(own)} of {robot}'s")
    return own


def _positions(poses: Iterable[Float[NDArray, "4 4"]]) -> Float[NDArray, "n 3"]:
    return np.stack([T[:3, 3] for T in poses])
