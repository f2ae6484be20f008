"""A small team with drifting odometry, bearings and ranges drawn straight from the truth."""

import numpy as np

from mulan.evaluation.localization.drawn_bearing import drawn_bearing
from mulan.geometry import se3, so3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import OdometryTrack, Photo, PoseTrack, RobotLog
from mulan.wireless.types import Range

WIFI = np.array([0.1, 0.0, 0.05])
UWB = np.array([0.0, 0.1, 0.02])


def true_motion(rng, n=100, duration_s=100.0, flat=False):
    """A smooth wander with a slowly turning body."""
    time_s = np.linspace(0, duration_s, n)
    phase = rng.uniform(0, 2 * np.pi, 4)
    x = 1.5 * np.sin(0.06 * time_s + phase[0])
    y = 1.5 * np.cos(0.09 * time_s + phase[1])
    z = np.zeros(n) if flat else 0.4 * np.sin(0.11 * time_s + phase[2])
    R = so3.about_z(phase[3] + 0.02 * time_s)
    return time_s, se3.from_parts(R, np.stack([x, y, z], -1))


def dead_reckoning(rng, T_world_body, yaw_deg=0.1, percent=1.0):
    """Random-walk odometry in the robot's own start frame, with its accumulated covariance."""
    steps = se3.inverse(T_world_body[:-1]) @ T_world_body[1:]
    length = np.linalg.norm(steps[:, :3, 3], axis=1)
    T, covariance = [np.eye(4)], [np.zeros((6, 6))]
    for step, metres in zip(steps, length, strict=True):
        sigma = np.concatenate([[1e-5, 1e-5, np.deg2rad(yaw_deg)], np.full(3, percent / 100)]) * np.sqrt(
            metres
        )
        noisy = step @ se3.exp(sigma * rng.normal(size=6))
        T.append(T[-1] @ noisy)
        covariance.append(se3.covariance_of_composition(step, covariance[-1]) + np.diag(sigma**2))
    return np.array(T), np.array(covariance)


def make_team(
    rng,
    count=2,
    n=100,
    with_covariance=True,
    spread_m=4.0,
    flat=False,
    photos=50,
    yaw_deg=0.1,
    percent=1.0,
    duration_s=100.0,
):
    """Robots with ground truth in one frame."""
    robots = []
    for i in range(count):
        time_s, T = true_motion(rng, n, duration_s, flat=flat)
        angle = 2 * np.pi * i / count + rng.uniform(-0.3, 0.3)
        height = 0.0 if flat else rng.uniform(-0.5, 0.5)
        T = (
            se3.from_parts(np.eye(3), spread_m * np.array([np.cos(angle), np.sin(angle), height / spread_m]))
            @ T
        )
        T_odom, covariance = dead_reckoning(rng, T, yaw_deg, percent)
        log = RobotLog(
            name=("alpha", "beta", "gamma", "delta", "epsilon")[i],
            camera=PinholeCamera(40, 30, 30.0, 30.0, 20.0, 15.0),
            T_body_camera=se3.from_parts(so3.about_z(np.array(0.3)), np.array([0.05, 0.0, 0.1])),
            wifi_antenna_body_m=WIFI,
            uwb_antenna_body_m=UWB,
            photos=tuple(Photo(float(t), "png", b"") for t in time_s[:: max(1, n // photos)]),
            odometry=OdometryTrack(time_s, T_odom, covariance if with_covariance else None),
            csi={},
            ranges={},
            ground_truth=PoseTrack(time_s, T),
        )
        robots.append(log)
    return tuple(robots)


def draw_bearing(rng, observer, peer, i, sigma_rad, outlier=False, level=False):
    """What an aperture at sample i would report."""
    return drawn_bearing(rng, observer, peer, i, sigma_rad, float(outlier), level=level)[0]


def draw_measurements(
    rng, robots, bearings=10, ranges=150, sigma_rad=0.03, sigma_m=0.05, outliers=0.0, level=False
):
    """Bearings in both directions and ranges of every pair."""
    n = len(robots[0].odometry.time_s)
    found, heard = [], []
    for a, first in enumerate(robots):
        for second in robots[a + 1 :]:
            for observer, peer in ((first, second), (second, first)):
                for i in np.linspace(2, n - 3, bearings).astype(int):
                    wrong = rng.random() < outliers
                    found.append(draw_bearing(rng, observer, peer, int(i), sigma_rad, wrong, level))
            bias_m = 0.03 * rng.normal()
            for i in np.linspace(0, n - 1, ranges).astype(int) if ranges else []:
                Ta, Tb = first.ground_truth.T_world_body[i], second.ground_truth.T_world_body[i]
                d = np.linalg.norm(Ta[:3, :3] @ UWB + Ta[:3, 3] - Tb[:3, :3] @ UWB - Tb[:3, 3])
                d += (
                    bias_m
                    + sigma_m * rng.normal()
                    + (rng.exponential(2.0) if rng.random() < outliers else 0.0)
                )
                heard.append(
                    Range(
                        first.name, second.name, float(first.odometry.time_s[i]), max(float(d), 0.1), sigma_m
                    )
                )
    return found, heard
