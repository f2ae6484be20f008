"""Simulated links from exact distances; knows nothing of the estimator's steering."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import OdometryTrack, RobotLog
from mulan.wireless.apertures import Aperture

WAVELENGTH_M = 299_792_458.0 / 5.54e9
_DURATION_S = 2.0


@dataclass(frozen=True)
class SimulatedLink:
    """One antenna path and the round-trip channel to a source that stood still.

    Attributes:
        position_m: Antenna positions.
        channel: Forward times reverse channel.
        range_m: From the path's centroid to the source.
        direction: Unit vector from the centroid to the source.
    """

    position_m: Float[NDArray, "n 3"]
    channel: Complex[NDArray, "n"]
    range_m: float
    direction: Float[NDArray, "3"]


def loop(packets: int, extent_m: float, turn_rad: float = 0.0) -> Float[NDArray, "n 3"]:
    """A closed loop that is not flat: a circle of a diameter, two rises and falls of half of it."""
    a = np.linspace(0, 2 * np.pi, packets) + turn_rad
    radius = extent_m / 2
    return np.stack([radius * np.cos(a), radius * np.sin(a), 0.5 * radius * np.sin(2 * (a - turn_rad))], -1)


def random_direction(rng: np.random.Generator) -> Float[NDArray, "3"]:
    """Uniform on the sphere."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def simulate_link(
    position_m: Float[NDArray, "n 3"],
    range_m: float,
    rng: np.random.Generator,
    phase_noise_rad: float,
    echoes: int = 0,
    strongest_echo: float = 0.9,
    snr_db: float | None = None,
) -> SimulatedLink:
    """A link to a random direction.

    The one-way channel is ``Σ g exp(-j 2π d/λ)`` over the source and its echoes with exact distances d; its
    square is the round-trip channel, whose packets get phase noise.

    Args:
        position_m: Antenna path.
        range_m: Distance of the source.
        rng: Source of all randomness.
        phase_noise_rad: Of each packet's round-trip channel.
        echoes: How many further paths, from random directions at one to two times the distance.
        strongest_echo: Their amplitudes are uniform between a tenth and this share of the direct path's.
        snr_db: Of the one-way channel, each way; None for no additive noise.
    """
    centre, direction, n = position_m.mean(0), random_direction(rng), len(position_m)

    def wave(point: Float[NDArray, "3"]) -> Complex[NDArray, "n"]:
        return np.exp(-2j * np.pi / WAVELENGTH_M * np.linalg.norm(point - position_m, axis=1))

    one_way = wave(centre + range_m * direction)
    for _ in range(echoes):
        point = centre + range_m * rng.uniform(1.0, 2.0) * random_direction(rng)
        gain = rng.uniform(0.1, strongest_echo) * np.exp(2j * np.pi * rng.random())
        one_way = one_way + gain * wave(point)
    channel = one_way**2
    if snr_db is not None:
        sigma = np.sqrt(np.mean(np.abs(one_way) ** 2) * 10 ** (-snr_db / 10) / 2)
        noise = sigma * (rng.normal(size=(2, n)) + 1j * rng.normal(size=(2, n)))
        channel = (one_way + noise[0]) * (one_way + noise[1])
    channel = channel * np.exp(1j * phase_noise_rad * rng.normal(size=n))
    return SimulatedLink(position_m, channel, range_m, direction)


def aperture_of(link: SimulatedLink) -> tuple[Aperture, RobotLog]:
    """The link as the estimator takes it, with odometry that claims to be exact."""
    n = len(link.position_m)
    time_s = np.linspace(0.0, _DURATION_S, n)
    aperture = Aperture(
        "observer",
        "peer",
        time_s,
        time_s,
        link.position_m,
        link.channel[:, None],
        WAVELENGTH_M,
        n // 2,
        np.eye(4),
    )
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, 3] = link.position_m
    log = RobotLog(
        name="observer",
        camera=PinholeCamera(4, 3, 3.0, 3.0, 2.0, 1.5),
        T_body_camera=np.eye(4),
        wifi_antenna_body_m=np.zeros(3),
        uwb_antenna_body_m=np.zeros(3),
        photos=(),
        odometry=OdometryTrack(time_s, T, np.zeros((n, 6, 6))),
        csi={},
        ranges={},
    )
    return aperture, log
