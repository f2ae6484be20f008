"""Planning on a run folder: transforms.json in, plan.json and plan.png out."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry.alignment import point_nearest_to_axes
from mulan.mission.goals import goals_as_json
from mulan.mission.messages import RobotFrames
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.planning.picture import draw_plan
from mulan.planning.plan import PlanConfig, RobotView, ViewPlan, plan_views
from mulan.radiance.engine import RadianceEngine


def last_views(images: PosedImageSet) -> list[RobotView]:
    """The last training photograph of each robot, by time where known, else by order in the set.

    Images without a robot name count as one robot called "camera"; a pose without covariance counts as exact.

    Raises:
        InputError: There is no training image.
    """
    if not images.train:
        raise InputError(images.source, "frames", "no training image", "add photographs and poses")
    last: dict[str, PosedImage] = {}
    for image in images.train:
        name = image.robot_id or "camera"
        earlier = last.get(name)
        if earlier is None or (image.timestamp_s or 0.0) >= (earlier.timestamp_s or 0.0):
            last[name] = image
    return [
        RobotView(
            name,
            image.camera,
            image.T_world_camera,
            np.zeros((6, 6)) if image.pose_covariance is None else image.pose_covariance,
        )
        for name, image in last.items()
    ]


def plan_as_json(plan: ViewPlan) -> dict[str, Any]:
    """plan.json: per robot the present pose, every free candidate with score and sigma, the best index."""
    robots = {
        p.robot.robot: {
            "T_world_camera": p.robot.T_world_camera.tolist(),
            "candidates": [
                {
                    "T_world_camera": T.tolist(),
                    "score": float(score),
                    "position_sigma_m": float(np.sqrt(np.trace(covariance[3:, 3:]) / 3)),
                }
                for T, covariance, score in zip(p.T_world_candidate, p.covariance, p.score, strict=True)
            ],
            "best": p.best,
        }
        for p in plan.robots
    }
    return {"centre_m": plan.centre_m.tolist(), "score_meaning": plan.score_meaning, "robots": robots}


def plan_run(
    run: RunFolder,
    engine: RadianceEngine,
    config: PlanConfig,
    progress: Callable[[int, int, str], None] | None = None,
) -> ViewPlan:
    """Choose the next view of every robot of a run; writes plan.json and plan.png beside each other.

    Raises:
        InputError: transforms.json is missing or cannot be used.
    """
    images = photographed(run)
    plan = plan_views(engine, last_views(images), looked_at_m(images), config, progress)
    write_plan(run, images, plan, engine)
    return plan


def photographed(run: RunFolder) -> PosedImageSet:
    """The photographs a run has learnt from.

    Raises:
        InputError: transforms.json is missing or cannot be used.
    """
    if not run.transforms.exists():
        raise InputError(run.transforms, "file", "does not exist", "make it with 'mulan localize'")
    return read_transforms(run.transforms)


def looked_at_m(images: PosedImageSet) -> Float[NDArray, "3"]:
    """The point nearest to all training cameras' axes, in the world."""
    cameras = np.array([image.T_world_camera for image in images.train]).reshape(-1, 4, 4)
    return point_nearest_to_axes(cameras[:, :3, 3], -cameras[:, :3, 2])


def write_plan(run: RunFolder, images: PosedImageSet, plan: ViewPlan, engine: RadianceEngine) -> None:
    """Write plan.json and, beside it, plan.png and goal_poses.json."""
    write_json(run.plan, plan_as_json(plan))
    goals = {p.robot.robot: p.T_world_candidate[p.best] for p in plan.robots if p.best is not None}
    write_json(run.goals, goals_as_json(goals, _world_frame(run)))
    draw_plan(plan, engine, _paths(run, images), run.plan.with_suffix(".png"))


def _world_frame(run: RunFolder) -> str:
    """The anchor's odometry frame where the run was localized, else "world"."""
    if not run.localization.exists():
        return "world"
    return RobotFrames(read_json(run.localization, "mulan localize")["anchor"]).odom


def _paths(run: RunFolder, images: PosedImageSet) -> dict[str, np.ndarray]:
    """Horizontal path of each robot: from localization.json if the run has one, else through the photos."""
    if run.localization.exists():
        robots = read_json(run.localization, "mulan localize")["robots"]
        return {name: np.array(robot["path"], dtype=float)[:, :2] for name, robot in robots.items()}
    paths: dict[str, list[np.ndarray]] = {}
    for image in images.train:
        paths.setdefault(image.robot_id or "camera", []).append(image.T_world_camera[:2, 3])
    return {name: np.stack(points) for name, points in paths.items()}
