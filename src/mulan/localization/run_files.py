"""What localization leaves in a run folder: ``localization.json`` and the poses of every robot."""

from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.localization.accuracy import accuracy, true_poses, world_from_truth
from mulan.localization.factors import level_direction
from mulan.localization.picture import draw_localization
from mulan.localization.relative_measurements import bearing_origin
from mulan.localization.types import Localization
from mulan.mission.run_folder import RunFolder, write_json
from mulan.mission.tum import write_tum
from mulan.mission.types import Mission, PoseTrack, RobotLog
from mulan.wireless.directions import azimuth_elevation
from mulan.wireless.types import Bearing

_MOST_PATH_POINTS = 500


def _listed(values: Float[NDArray, "*n"], decimals: int = 6) -> list[Any]:
    return np.round(values, decimals).tolist()


def corrected(
    localization: Localization, robot: RobotLog, time_s: Float[NDArray, "n"]
) -> Float[NDArray, "n 4 4"]:
    """``T_world_odom`` at times: the correction of dead reckoning, carried between the photographs."""
    trajectory = localization.trajectories[robot.name]
    if len(trajectory.time_s) == 0:
        return np.broadcast_to(localization.T_world_odom[robot.name], (len(time_s), 4, 4)).copy()
    odometry = robot.odometry
    T_odom_body = se3.interpolate(odometry.time_s, odometry.T_odom_body, trajectory.time_s)
    corrections = trajectory.T_world_body @ se3.inverse(T_odom_body)
    return se3.interpolate(trajectory.time_s, corrections, time_s)


def _robot_entry(
    localization: Localization, robot: RobotLog, T_world_truth: Float[NDArray, "4 4"] | None
) -> dict[str, Any]:
    trajectory = localization.trajectories[robot.name]
    every = max(1, -(-len(robot.odometry.time_s) // _MOST_PATH_POINTS))
    path_s, path = robot.odometry.time_s[::every], robot.odometry.T_odom_body[::every]
    truth_path, truth_poses = None, None
    if T_world_truth is not None and robot.ground_truth is not None:
        along, at_photos = (true_poses(robot, T_world_truth, t) for t in (path_s, trajectory.time_s))
        truth_path = None if along is None else _listed(along[:, :3, 3], 4)
        truth_poses = None if at_photos is None else _listed(at_photos)
    return {
        "T_world_odom": _listed(localization.T_world_odom[robot.name], 9),
        "time_s": trajectory.time_s.tolist(),
        "T_world_body": _listed(trajectory.T_world_body, 9),
        "covariance": trajectory.covariance.tolist(),
        "path": _listed((corrected(localization, robot, path_s) @ path)[:, :3, 3], 4),
        "truth_path": truth_path,
        "truth_T_world_body": truth_poses,
    }


def true_direction_odom(
    bearing: Bearing, mission: Mission, T_world_truth: Float[NDArray, "4 4"] | None
) -> Float[NDArray, "3"] | None:
    """The true direction in the axes the bearing was measured in; None without truth of both robots."""
    if T_world_truth is None:
        return None
    observer, peer = mission.robot(bearing.observer), mission.robot(bearing.peer)
    T_observer = true_poses(observer, T_world_truth, np.array([bearing.time_s]))
    T_peer = true_poses(peer, T_world_truth, np.array([bearing.peer_time_s]))
    if T_observer is None or T_peer is None:
        return None
    T_odom_world = bearing.T_odom_body @ se3.inverse(T_observer[0])
    antenna = se3.transform(T_odom_world, se3.transform(T_peer[0], peer.wifi_antenna_body_m))
    v = antenna - bearing_origin(bearing, observer)
    return v / np.linalg.norm(v)


def _sigma_rad(bearing: Bearing) -> float:
    variance = np.diag(bearing.tangent_covariance[0])
    return float(np.sqrt(variance[np.isfinite(variance)].mean()))


def bearing_error_rad(bearing: Bearing, true_odom: Float[NDArray, "3"]) -> float:
    """Angle between the best hypothesis and the truth; of azimuths where only those were observed."""
    u = bearing.direction_odom[0]
    if not np.isfinite(bearing.tangent_covariance[0, 1, 1]):
        u, true_odom = level_direction(u), level_direction(true_odom)
    return float(2 * np.arcsin(np.clip(np.linalg.norm(u - true_odom) / 2, 0.0, 1.0)))


def _bearing_entry(
    bearing: Bearing,
    inlier: float,
    localization: Localization,
    mission: Mission,
    T_world_truth: Float[NDArray, "4 4"] | None,
) -> dict[str, Any]:
    observer = mission.robot(bearing.observer)
    T_world_odom = corrected(localization, observer, np.array([bearing.time_s]))[0]
    true_odom = true_direction_odom(bearing, mission, T_world_truth)
    true_world = None
    if true_odom is not None and T_world_truth is not None:
        T_true = true_poses(observer, T_world_truth, np.array([bearing.time_s]))
        assert T_true is not None  # a true direction exists only with it
        true_world = _listed(T_true[0, :3, :3] @ bearing.T_odom_body[:3, :3].T @ true_odom)
    return {
        "observer": bearing.observer,
        "peer": bearing.peer,
        "time_s": bearing.time_s,
        "origin_world": _listed(se3.transform(T_world_odom, bearing_origin(bearing, observer))),
        "direction_world": _listed(T_world_odom[:3, :3] @ bearing.direction_odom[0]),
        "sigma_rad": _sigma_rad(bearing),
        "outlier_mass": bearing.outlier_mass,
        "inlier": inlier,
        "packets": bearing.packets,
        "true_direction_world": true_world,
        "error_rad": None if true_odom is None else bearing_error_rad(bearing, true_odom),
    }


def _profile_entry(
    localization: Localization, mission: Mission, T_world_truth: Float[NDArray, "4 4"] | None
) -> dict[str, Any] | None:
    """The sharpest bearing whose profile was kept."""
    kept = [b for b in localization.bearings if b.profile is not None]
    if not kept:
        return None
    bearing = min(kept, key=_sigma_rad)
    assert bearing.profile is not None
    true_odom = true_direction_odom(bearing, mission, T_world_truth)
    true_azimuth, true_elevation = (
        (None, None) if true_odom is None else map(float, azimuth_elevation(true_odom))
    )
    azimuth, elevation = map(float, azimuth_elevation(bearing.direction_odom[0]))
    return {
        "observer": bearing.observer,
        "peer": bearing.peer,
        "azimuth_rad": _listed(bearing.profile.azimuth_rad, 5),
        "elevation_rad": _listed(bearing.profile.elevation_rad, 5),
        "power": _listed(bearing.profile.power.astype(float), 8),
        "true_azimuth_rad": true_azimuth,
        "true_elevation_rad": true_elevation,
        "estimated_azimuth_rad": azimuth,
        "estimated_elevation_rad": elevation,
        "sigma_rad": _sigma_rad(bearing),
    }


def localization_record(localization: Localization, mission: Mission) -> dict[str, Any]:
    """Everything ``localization.json`` holds."""
    T_world_truth = world_from_truth(mission)
    measured = accuracy(localization, mission)
    placed = [robot for robot in mission.robots if robot.name in localization.trajectories]
    return {
        "anchor": localization.anchor,
        "robots": {robot.name: _robot_entry(localization, robot, T_world_truth) for robot in placed},
        "bearings": [
            _bearing_entry(bearing, float(inlier), localization, mission, T_world_truth)
            for bearing, inlier in zip(localization.bearings, localization.bearing_inlier, strict=True)
        ],
        "ranges": len(localization.ranges),
        "profile": _profile_entry(localization, mission, T_world_truth),
        "accuracy": None if measured is None else {name: asdict(value) for name, value in measured.items()},
        "undetermined": [asdict(robot) for robot in localization.undetermined],
        "suspects": [asdict(suspect) for suspect in localization.suspects],
        "odometry": {name: asdict(learned) for name, learned in localization.odometry.items()},
    }


def relative_record(localization: Localization) -> list[dict[str, Any]]:
    """Everything ``relative_poses.json`` holds: of every pair the peer's body in the robot's body frame."""
    return [
        {
            "robot": pose.robot,
            "peer": pose.peer,
            "time_s": pose.time_s,
            "peer_time_s": pose.peer_time_s,
            "T_robot_peer": _listed(pose.T_robot_peer, 9),
            "covariance": pose.covariance.tolist(),
        }
        for pose in localization.relative_poses
    ]


def write_localization(
    localization: Localization, mission: Mission, run: RunFolder, picture: bool = True
) -> None:
    """Write what was concluded, a picture of it, and the poses of every placed robot.

    ``localization.json`` and ``.png``, ``relative_poses.json``, ``poses/<robot>.tum`` (bodies) and
    ``poses/<robot>.json`` (cameras). Poses that an earlier localization left of a robot not placed any more
    are removed. ``picture`` may be left out where all this is written again and again.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    for robot in mission.robots:
        trajectory = localization.trajectories.get(robot.name)
        if trajectory is None:
            for kind in ("tum", "json"):
                (run.poses / f"{robot.name}.{kind}").unlink(missing_ok=True)
            continue
        write_tum(PoseTrack(trajectory.time_s, trajectory.T_world_body), run.poses / f"{robot.name}.tum")
        T_body_camera = np.broadcast_to(robot.T_body_camera, trajectory.T_world_body.shape)
        cameras = {
            "time_s": trajectory.time_s.tolist(),
            "T_world_camera": _listed(trajectory.T_world_body @ robot.T_body_camera, 9),
            "covariance": se3.covariance_of_composition(T_body_camera, trajectory.covariance).tolist(),
        }
        write_json(run.poses / f"{robot.name}.json", cameras)
    write_json(run.relative_poses, relative_record(localization))
    record = localization_record(localization, mission)
    write_json(run.localization, record)
    if picture:
        draw_localization(record, run.localization.with_suffix(".png"))
