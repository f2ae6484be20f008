"""A small radio written for the tests, independent of the simulator."""

import numpy as np

from mulan.geometry import se3, so3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import CsiTrack, OdometryTrack, RangeTrack, RobotLog

LIGHT = 299_792_458.0
CARRIER_HZ = 5.54e9
WAVELENGTH_M = LIGHT / CARRIER_HZ
INDEX = np.array([*range(-28, 0, 2), -1, *range(1, 28, 2), 28], float)
SUBCARRIER_HZ = CARRIER_HZ + 312_500.0 * INDEX


def helix(n, radius_m=0.25, height_m=0.15, level=False):
    """One loop of antenna positions; two rises a turn so that it is not flat."""
    a = np.linspace(0, 2 * np.pi, n)
    z = np.zeros(n) if level else height_m / 2 * np.sin(2 * a)
    return np.stack([radius_m * np.sin(a), radius_m * (1 - np.cos(a)), z], -1)


def aperture_channel(path_m, source_m, rng, phase_noise_rad=0.42, paths=()):
    """Round-trip product along a path; ``paths`` are (source, gain) of reflections."""
    h = np.zeros(len(path_m), complex)
    for point, gain in [(source_m, 1.0), *paths]:
        d = np.linalg.norm(point - path_m, axis=1)
        h += gain / d * np.exp(-2j * np.pi / WAVELENGTH_M * d)
    return h**2 * np.exp(1j * phase_noise_rad * rng.normal(size=len(h)))


def csi_direction(distance_m, carrier_phase, rng, phase_noise_rad=0.3):
    """What one card reports: timing slope, phase noise, carrier phase."""
    n = len(distance_m)
    h = np.exp(-2j * np.pi * distance_m[:, None] * SUBCARRIER_HZ / LIGHT) / distance_m[:, None]
    slope = rng.normal(size=n) * 60e-9
    phase = carrier_phase + phase_noise_rad * rng.normal(size=n)
    h = h * np.exp(1j * (phase[:, None] - 2 * np.pi * 312_500.0 * INDEX * slope[:, None]))
    return h[:, None, :]


def robot(name, time_s, T_odom_body, csi=None, ranges=None, covariance=None, lever=(0.1, 0.0, 0.05), **more):
    return RobotLog(
        name=name,
        camera=PinholeCamera(40, 30, 30.0, 30.0, 20.0, 15.0),
        T_body_camera=np.eye(4),
        wifi_antenna_body_m=np.array(lever, float),
        uwb_antenna_body_m=np.array([0.0, 0.1, 0.0]),
        photos=more.pop("photos", ()),
        odometry=OdometryTrack(time_s, T_odom_body, covariance),
        csi=csi or {},
        ranges=ranges or {},
        **more,
    )


def two_robots(
    rng, peer_world_m=(3.0, 2.0, 0.4), clock_offset_s=7.5, level=False, rate_hz=200.0, phase_noise_rad=0.3
):
    """alpha waves for two seconds, then beta; each in its own odometry frame, beta's clock ahead.

    Returns the logs and T_alpha_odom_from_beta_odom.
    """
    time_s = np.arange(0, 6.0, 0.02)
    T_alpha = np.tile(np.eye(4), (len(time_s), 1, 1))
    T_beta = T_alpha.copy()

    def wave(T, begin):
        inside = (time_s >= begin) & (time_s <= begin + 2.0)
        s = (time_s[inside] - begin) / 2.0
        a = 2 * np.pi * s
        T[inside, :3, 3] = np.stack(
            [0.25 * np.sin(a), 0.25 * (1 - np.cos(a)), np.zeros_like(a) if level else 0.075 * np.sin(2 * a)],
            -1,
        )

    wave(T_alpha, 0.5)
    wave(T_beta, 3.2)
    T_ab = se3.from_parts(so3.about_z(np.array(1.1)), np.array(peer_world_m, float))
    lever = np.array([0.1, 0.0, 0.05])
    packets_s = np.sort(np.concatenate([np.arange(0.4, 2.6, 1 / rate_hz), np.arange(3.1, 5.3, 1 / rate_hz)]))

    def antenna(T, lever):
        poses = se3.interpolate(time_s, T, packets_s)
        return poses[:, :3, :3] @ lever + poses[:, :3, 3]

    p_alpha = antenna(T_alpha, lever)
    p_beta = se3.transform(np.broadcast_to(T_ab, (len(packets_s), 4, 4)), antenna(T_beta, lever))
    distance = np.linalg.norm(p_alpha - p_beta, axis=1)
    cfo = np.cumsum(rng.normal(size=len(packets_s)) * 2.0)
    forward = csi_direction(distance, cfo, rng, phase_noise_rad)
    reverse = csi_direction(distance, -cfo, rng, phase_noise_rad)
    counter = np.arange(len(packets_s), dtype=np.uint32)
    keep_f, keep_r = rng.random(len(counter)) > 0.05, rng.random(len(counter)) > 0.05
    csi_a = CsiTrack("beta", packets_s[keep_f], counter[keep_f], forward[keep_f], SUBCARRIER_HZ)
    csi_b = CsiTrack(
        "alpha", packets_s[keep_r] + clock_offset_s, counter[keep_r], reverse[keep_r], SUBCARRIER_HZ
    )
    u_alpha, u_beta = antenna(T_alpha, np.array([0.0, 0.1, 0.0])), antenna(T_beta, np.array([0.0, 0.1, 0.0]))
    u_beta = se3.transform(np.broadcast_to(T_ab, (len(packets_s), 4, 4)), u_beta)
    every = slice(0, None, 40)
    uwb = np.linalg.norm(u_alpha - u_beta, axis=1)[every]
    sigma = np.full(len(uwb), 0.05)
    ranges = RangeTrack("beta", packets_s[every], uwb + 0.05 * rng.normal(size=len(uwb)), sigma)
    alpha = robot("alpha", time_s, T_alpha, {"beta": csi_a}, {"beta": ranges})
    beta = robot("beta", time_s + clock_offset_s, T_beta, {"alpha": csi_b})
    return (alpha, beta), T_ab
