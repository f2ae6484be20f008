"""A run folder filled with plausible invented results, for looking at the page; never shipped."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mulan.geometry import se3, so3
from mulan.mission.run_folder import RunFolder, write_json

ROBOTS = ("robot_1", "robot_2", "robot_3")
PHOTOS = 24


def _poses(position: NDArray) -> NDArray:
    heading = np.arctan2(-position[:, 1], -position[:, 0])
    return se3.from_parts(so3.about_z(heading), position)


def _orbit(start_rad: float, count: int) -> NDArray:
    angle = start_rad + np.linspace(0, 2.3, count)
    radius = 2.0 + 0.25 * np.sin(3 * angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.9 + 0.3 * np.sin(2 * angle)], -1)


def write_localization(run: RunFolder, with_truth: bool = True, robots: tuple[str, ...] = ROBOTS) -> None:
    rng = np.random.default_rng(1)
    records, accuracy = {}, {}
    for i, name in enumerate(robots):
        true = _poses(_orbit(2.1 * i, PHOTOS))
        sigma = np.array([0.004, 0.004, 0.012, 0.05, 0.03, 0.03]) * (1 if i else 0.15)
        covariance = np.diag(sigma**2)
        estimate = true @ se3.exp(np.tile(rng.normal(size=6) * sigma, (PHOTOS, 1)))
        path = _orbit(2.1 * i, 200)
        records[name] = {
            "T_world_odom": np.eye(4).tolist(),
            "time_s": np.linspace(0, 60, PHOTOS).tolist(),
            "T_world_body": estimate.tolist(),
            "covariance": [covariance.tolist()] * PHOTOS,
            "path": (path + (estimate[0, :3, 3] - true[0, :3, 3])).tolist(),
            "truth_path": path.tolist() if with_truth else None,
            "truth_T_world_body": true.tolist() if with_truth else None,
        }
        scale = 1.0 if i else 0.05
        accuracy[name] = {
            "position_rms_m": 0.047 * scale,
            "rotation_rms_deg": 0.81 * scale,
            "yaw_rms_deg": 0.62 * scale,
            "nees_per_dof": 1.08,
        }
    bearings = []
    for k in range(24):
        observer, peer = (robots[j % len(robots)] for j in (k, k + 1))
        i = int(rng.integers(PHOTOS))
        start, end = (np.array(records[n]["T_world_body"])[i, :3, 3] for n in (observer, peer))
        sigma = float(np.radians(10 ** rng.uniform(-0.2, 0.9)))
        outlier = k % 11 == 7
        offset = rng.normal(size=3) * (0.5 if outlier else sigma / np.sqrt(2))
        direction = (end - start) / np.linalg.norm(end - start)
        measured = direction + offset
        measured /= np.linalg.norm(measured)
        error = float(np.arccos(np.clip(direction @ measured, -1, 1)))
        bearings.append(
            {
                "observer": observer,
                "peer": peer,
                "time_s": records[observer]["time_s"][i],
                "origin_world": start.tolist(),
                "direction_world": measured.tolist(),
                "sigma_rad": sigma,
                "outlier_mass": 0.02,
                "inlier": 0.03 if outlier else 0.97,
                "packets": 300,
                "true_direction_world": direction.tolist() if with_truth else None,
                "error_rad": error if with_truth else None,
            }
        )
    azimuth, elevation = np.radians(np.arange(-180, 180, 2.0)), np.radians(np.arange(-90, 91, 2.0))
    a, e = np.meshgrid(azimuth, elevation)
    power = np.exp(-(((a - 0.6) / 0.16) ** 2) - ((e - 0.1) / 0.3) ** 2)
    power += 0.3 * np.exp(-(((a + 1.9) / 0.2) ** 2) - ((e + 0.2) / 0.4) ** 2)
    power += 0.05 * (np.sin(9 * a) * np.cos(7 * e)) ** 2 + 0.003
    profile = {
        "observer": robots[0],
        "peer": robots[-1],
        "azimuth_rad": azimuth.tolist(),
        "elevation_rad": elevation.tolist(),
        "power": (power / power.sum()).tolist(),
        "true_azimuth_rad": 0.66 if with_truth else None,
        "true_elevation_rad": 0.13 if with_truth else None,
        "estimated_azimuth_rad": 0.6,
        "estimated_elevation_rad": 0.1,
        "sigma_rad": 0.045,
    }
    write_json(
        run.localization,
        {
            "anchor": robots[0],
            "robots": records,
            "bearings": bearings,
            "ranges": 412,
            "profile": profile,
            "accuracy": accuracy if with_truth else None,
        },
    )


def _photograph(view: int) -> NDArray:
    y, x = (np.mgrid[0:144, 0:192] + 0.5) / 144.0
    wall = np.stack([0.75 - 0.2 * y, 0.72 - 0.15 * y, 0.68 - 0.1 * y], -1)
    floor = y > 0.68
    tiles = ((np.floor(8 * (x + 0.1 * view) / y) + np.floor(6 / y)) % 2)[..., None]
    image = np.where(floor[..., None], 0.35 + 0.2 * tiles * np.array([1.0, 0.85, 0.7]), wall)
    shade = (x - 0.62 - 0.03 * view) ** 2 + (y - 0.5) ** 2
    light = np.clip(1.15 - 3.0 * shade - 0.6 * (y - 0.4), 0.15, 1)
    stripes = 0.6 + 0.4 * np.sin(18 * np.arctan2(y - 0.5, x - 0.62 - 0.03 * view))
    ball = np.stack([0.85 * light, 0.45 * light * stripes, 0.2 * light], -1)
    return np.clip(np.where((shade < 0.08)[..., None], ball, image), 0, 1)


def write_training(run: RunFolder, psnr_db: float, seed: int = 0, views: int = 4) -> dict:
    rng = np.random.default_rng(seed)
    seconds = np.linspace(2, 120, 40)
    curve = psnr_db - 12 * np.exp(-seconds / 18)
    noisy = curve + rng.normal(0, 0.25, len(seconds)) + 0.8
    write_json(
        run.history,
        [
            {
                "seconds": float(t),
                "steps": int(t * 40),
                "loss": float(10 ** (-n / 10)),
                "train_psnr_db": float(n),
                "test_psnr_db": float(c) if k % 4 == 3 else None,
            }
            for k, (t, n, c) in enumerate(zip(seconds, noisy, curve, strict=True))
        ],
    )
    run.renders.mkdir(parents=True)
    for view in range(views):
        true = _photograph(view)
        blur = max(1, round((34 - psnr_db) / 2))
        soft = np.mean([np.roll(true, (0, s), (0, 1)) for s in range(-blur, blur + 1)], axis=0)
        rendered = np.clip(soft + rng.normal(0, 0.012, true.shape), 0, 1)
        for kind, image in (("true", true), ("rendered", rendered), ("depth", true)):
            Image.fromarray((image * 255).astype(np.uint8)).save(run.renders / f"{view:03}_{kind}.png")
    metrics = {
        "psnr_db": psnr_db,
        "ssim": 0.55 + psnr_db / 85,
        "views": [{"name": f"{v}.png", "psnr_db": psnr_db, "ssim": 0.9} for v in range(12)],
        "train_seconds": 120.4,
        "steps": 4816,
    }
    write_json(run.metrics, metrics)
    return metrics


def write_plan(run: RunFolder, picture: Path | None = None) -> None:
    rng = np.random.default_rng(2)
    robots = {}
    for i, name in enumerate(ROBOTS):
        candidates = []
        for k in range(8):
            T = np.eye(4)
            T[:3, 3] = _orbit(2.1 * i, 2)[-1] + [0.5 * np.cos(k * np.pi / 4), 0.5 * np.sin(k * np.pi / 4), 0]
            score = float(rng.uniform(0.001, 0.004))
            candidates.append({"T_world_camera": T.tolist(), "score": score, "position_sigma_m": 0.031})
        best = int(np.argmax([c["score"] for c in candidates]))
        robots[name] = {"T_world_camera": np.eye(4).tolist(), "candidates": candidates, "best": best}
    write_json(run.plan, {"centre_m": [0.0, 0.0, 0.4], "robots": robots})
    image = Image.open(picture) if picture else Image.new("RGB", (1320, 660), "white")
    image.save(run.plan.with_suffix(".png"))


def record_config(run: RunFolder) -> None:
    run.record_config("simulate", {"robots": 3, "photos_per_robot": 24, "seed": 0, "scene": None})
    run.record_config("train", {"image_size": 192, "time_budget_s": 120, "field": {"levels": 8, "width": 32}})


def full_run(root: Path, plan_picture: Path | None = None) -> RunFolder:
    run = RunFolder(root)
    write_localization(run)
    write_training(run, 27.6)
    write_plan(run, plan_picture)
    record_config(run)
    return run


def evaluation_run(root: Path) -> RunFolder:
    run = RunFolder(root)
    write_localization(run, robots=ROBOTS[:2])
    setups = {
        name: write_training(RunFolder(root / name), psnr_db, seed)
        for seed, (name, psnr_db) in enumerate((("oracle", 30.2), ("wireless", 25.9), ("uncertainty", 28.4)))
    }
    write_json(run.metrics, {"setups": setups})
    record_config(run)
    return run
