"""A small mission that uses every channel."""

import numpy as np
import pytest

from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission import pixels
from mulan.mission.types import (
    CsiTrack,
    HeldOutViews,
    Mission,
    OdometryTrack,
    Photo,
    PoseTrack,
    RangeTrack,
    RobotLog,
)

EPOCH_S = 1_700_000_000.0  # a real clock: stamps must survive ten digits before the point
CAMERA = PinholeCamera(32, 24, 30.5, 31.25, 15.75, 12.5, k1=-0.21, k2=0.03, p1=1e-3, p2=-2e-3, k3=0.004)


@pytest.fixture
def mission() -> Mission:
    rng = np.random.default_rng(7)
    # the anchor is not the first by name, so that order cannot be an accident
    robots = (
        make_robot("zebra", ["ant", "bee"], rng),
        make_robot("ant", ["zebra"], rng),
        make_robot("bee", [], rng),
    )
    times_s = EPOCH_S + np.array([2.5, 3.5])
    held_out = HeldOutViews(CAMERA, make_photos(times_s, "png", rng), make_poses(2, rng))
    return Mission(robots, held_out)


def make_poses(count: int, rng: np.random.Generator) -> np.ndarray:
    return se3.exp(
        np.concatenate([rng.uniform(-1.7, 1.7, (count, 3)), rng.normal(size=(count, 3)) * 5], axis=1)
    )


def make_covariances(count: int, rng: np.random.Generator) -> np.ndarray:
    roots = rng.normal(size=(count, 6, 6)) * 0.1
    return roots @ np.swapaxes(roots, 1, 2)


def make_photos(times_s: np.ndarray, encoding: str, rng: np.random.Generator) -> tuple[Photo, ...]:
    encode = pixels.encode_png if encoding == "png" else pixels.encode_jpeg
    return tuple(
        Photo(float(t), encoding, encode(rng.integers(0, 256, (24, 32, 3), dtype=np.uint8))) for t in times_s
    )


def make_robot(name: str, peers: list[str], rng: np.random.Generator) -> RobotLog:
    photo_s = EPOCH_S + np.arange(3) * 0.5 + 0.123456789
    odometry_s = EPOCH_S + np.arange(12) * 0.1
    radio_s = EPOCH_S + np.arange(5) * 0.03
    channel = rng.normal(size=(5, 2, 4)) + 1j * rng.normal(size=(5, 2, 4))
    covariance = make_covariances(12, rng) if peers else None
    return RobotLog(
        name=name,
        camera=CAMERA,
        T_body_camera=make_poses(1, rng)[0],
        wifi_antenna_body_m=rng.normal(size=3),
        uwb_antenna_body_m=rng.normal(size=3),
        photos=make_photos(photo_s, "jpeg", rng),
        odometry=OdometryTrack(odometry_s, make_poses(12, rng), covariance),
        csi={
            peer: CsiTrack(
                peer,
                radio_s,
                np.arange(4_294_967_290, 4_294_967_295, dtype=np.uint32),
                channel.astype(np.complex64).astype(complex),
                5.54e9 + np.arange(4) * 312_500.0,
            )
            for peer in peers
        },
        ranges={
            peer: RangeTrack(peer, radio_s, rng.uniform(1, 9, 5), rng.uniform(0.05, 0.2, 5)) for peer in peers
        },
        ground_truth=PoseTrack(odometry_s, make_poses(12, rng)) if peers else None,
    )
