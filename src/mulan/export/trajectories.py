"""Every robot's poses as TUM text, with their covariances beside."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.export.exported_run import ExportedRun
from mulan.geometry import se3
from mulan.mission.messages import HELD_OUT
from mulan.mission.posed_images import PosedImage
from mulan.mission.ros_poses import T_OPTICAL_OPENGL
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.mission.tum import write_tum
from mulan.mission.types import PoseTrack

_COVARIANCE_NOTE = (
    "6x6 over (rotation rad, translation m), right perturbation T @ exp(xi), in the axes of the named frame"
)


def export_trajectories(exported: ExportedRun, folder: Path) -> list[Path]:
    """Write ``<robot>_camera.tum`` and, where the run was localized, ``<robot>.tum``; returns the files.

    Cameras are on optical axes (x right, y down, z forward), as TUM files of cameras are everywhere; bodies
    are ``base_link``. ``<robot>.json`` has both frames' covariances, line by line. Poses are those of the
    photographs. Photographs held out of a refined run keep unrefined poses, so they are left out.

    Args:
        exported: The run.
        folder: Target.

    Raises:
        InputError: No photograph has a robot and a time, or the folder cannot be written.
    """
    chosen = exported.images.train if exported.refined else (*exported.images.train, *exported.images.test)
    tracks: dict[str, list[PosedImage]] = {}
    for image in chosen:
        if image.robot_id not in (None, HELD_OUT) and image.timestamp_s is not None:
            tracks.setdefault(image.robot_id, []).append(image)
    if not tracks:
        raise InputError(
            exported.images.source,
            "robot_id, timestamp",
            "no photograph has both, so there are no trajectories",
            "make the run from a bag with 'mulan localize'",
        )
    written = []
    for robot, images in tracks.items():
        images.sort(key=lambda image: image.timestamp_s or 0.0)
        written += _write_robot(exported, robot, images, folder)
    return written


def _write_robot(exported: ExportedRun, robot: str, images: list[PosedImage], folder: Path) -> list[Path]:
    if Path(robot).name != robot:
        raise InputError(
            exported.images.source, f"robot_id '{robot}'", "cannot be a file name", "rename the robot"
        )
    time_s = np.array([image.timestamp_s for image in images], dtype=float)
    T_world_camera = np.stack([image.T_world_camera for image in images])
    covariance = None
    if all(image.pose_covariance is not None for image in images):
        covariance = np.array([image.pose_covariance for image in images], dtype=float)
    record: dict[str, Any] = {
        "time_s": time_s.tolist(),
        "refined": exported.refined,
        "covariance_convention": _COVARIANCE_NOTE,
    }
    frames = {"camera": T_OPTICAL_OPENGL}
    T_body_camera = _mount(exported.run, robot)
    if T_body_camera is not None:
        frames["body"] = se3.inverse(T_body_camera)
    written = []
    for frame, T_camera_frame in frames.items():
        path = folder / (f"{robot}.tum" if frame == "body" else f"{robot}_{frame}.tum")
        write_tum(PoseTrack(time_s, T_world_camera @ T_camera_frame), path)
        written.append(path)
        if covariance is not None:
            moved = se3.covariance_of_composition(
                np.broadcast_to(T_camera_frame, T_world_camera.shape), covariance
            )
            record[f"{frame}_covariance"] = moved.tolist()
    path = folder / f"{robot}.json"
    write_json(path, record)
    return [*written, path]


def _mount(run: RunFolder, robot: str) -> Float[NDArray, "4 4"] | None:
    """Where the camera (OpenGL axes) sits on its robot, from the two poses localization wrote of each."""
    cameras = run.poses / f"{robot}.json"
    if not (run.localization.exists() and cameras.exists()):
        return None
    try:
        bodies = read_json(run.localization, "mulan localize")["robots"][robot]["T_world_body"]
        T_world_body = np.array(bodies[0], dtype=float).reshape(4, 4)
        first = read_json(cameras, "mulan localize")["T_world_camera"][0]
        T_world_camera = np.array(first, dtype=float).reshape(4, 4)
    except (KeyError, IndexError, TypeError, ValueError):
        return None
    return se3.inverse(T_world_body) @ T_world_camera
