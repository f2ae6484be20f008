"""Bearings between all robots of a team from the CSI they recorded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import combinations

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import RobotLog
from mulan.wireless.apertures import Aperture, ApertureConfig, find_apertures
from mulan.wireless.calibration import AzimuthCalibration
from mulan.wireless.channel import pair_packets
from mulan.wireless.drift_tracking import tracked_peaks, tracked_weights
from mulan.wireless.kappa_paper import kappa_paper
from mulan.wireless.level_posterior import LevelPosteriorConfig, level_hypotheses
from mulan.wireless.multipath import MultipathConfig, resolve_paths
from mulan.wireless.odometry_drift import displacement_covariance
from mulan.wireless.peak import SteeringModel, grid_peaks, refined_peaks, steering_model
from mulan.wireless.phase_score import scored_direction
from mulan.wireless.principal_channels import principal_channels
from mulan.wireless.profile import bartlett_power, unit_sum_profile
from mulan.wireless.types import Bearing
from mulan.wireless.uncertainty import (
    drift_covariance,
    hypothesis_weights,
    is_level,
    is_straight,
    residual_smoothness,
    residual_statistics,
    sandwich_covariance,
)

_COHERENT_DRIFT_RAD2 = 0.25  # more drift than half a radian of phase is tracked, not ignored
_TRACKED_STARTS = 12
_PROFILE_CHANNELS = 3  # principal components in the profile; on real cards they hold 98 % of the power
_REFLECTED_SMOOTHNESS = 0.25  # white residuals stay below 0.1 from 300 packets, real rooms show 0.6 to 0.9
_CURVED_PHASE_RAD = 3.0  # more curvature than this moves plane-wave peaks out of the true one's main lobe
_FOCUS_AZIMUTHS, _FOCUS_ELEVATIONS = 180, 91


class KeepProfile(Enum):
    """Which full profiles to keep (260 kB each)."""

    NONE = "none"
    ONE = "one"
    ALL = "all"


@dataclass(frozen=True)
class BearingConfig:
    """How CSI becomes bearings."""

    aperture: ApertureConfig = field(default_factory=ApertureConfig)
    """What counts as an aperture."""
    azimuth_count: int = 360
    """Azimuths of the profile grid; even."""
    elevation_count: int = 181
    """Elevations of the profile grid; odd."""
    hypotheses: int = 3
    """Directions kept a bearing, at most."""
    least_outlier_mass: float = 0.01
    """Floor of the probability that none is right; raise it where the direct path is often blocked."""
    spherical: bool = True
    """Curve the wavefront by the UWB range where there is one."""
    keep_profile: KeepProfile = KeepProfile.ONE
    """Keep the full profile of no, one (the sharpest) or all bearings."""
    multipath: MultipathConfig = field(default_factory=MultipathConfig)
    """How the paths of an aperture among reflections are told apart (paths that are not level)."""
    kappa_tolerance_rad: float = 0.5
    """Phase noise ν of the rebuilt channel in the paper's uncertainty."""
    assumed_drift_percent: float = 1.0
    """Drift (percent, as a random walk) that widens sigma where the odometry reports no covariance."""
    smallest_sigma_rad: float = 0.002
    """Floor of a bearing's standard deviation: antenna calibration, packet and odometry clocks."""
    level: LevelPosteriorConfig = field(default_factory=LevelPosteriorConfig)
    """How level apertures are judged where reflections show."""
    undo_phase_jumps: bool = False
    """Turn back quarter and half turns of a card's phase that are found; else they are only told."""
    calibration: AzimuthCalibration = field(default_factory=AzimuthCalibration)
    """Learned corrections of what a bearing claims; none by default ('mulan calibrate' makes them)."""


def range_during(observer: RobotLog, peer: RobotLog, aperture: Aperture) -> float | None:
    """Median UWB range [m] while an aperture was recorded, or None."""
    heard = []
    for log, other, clock in ((observer, peer, aperture.time_s), (peer, observer, aperture.peer_time_s)):
        if other.name in log.ranges:
            track = log.ranges[other.name]
            heard.append(
                track.range_m[(track.time_s >= clock[0] - 0.25) & (track.time_s <= clock[-1] + 0.25)]
            )
    values = np.concatenate(heard) if heard else np.zeros(0)
    values = values[np.isfinite(values) & (values > 0)]
    return float(np.median(values)) if len(values) else None


@dataclass(frozen=True)
class _Hypotheses:
    direction: Float[NDArray, "k 3"]
    covariance: Float[NDArray, "k 2 2"]
    weight: Float[NDArray, "k"]
    outlier_mass: float
    ordered: bool = False  # the first is the best guess although another may weigh more


def _drift_variance(aperture: Aperture, observer: RobotLog) -> Float[NDArray, "n"] | None:
    """Variance of the antenna's drift along any one axis since the first packet, or None where unknown."""
    covariance = displacement_covariance(observer.odometry, aperture.time_s)
    if covariance is None:
        return None
    return np.maximum.accumulate(np.trace(covariance, axis1=1, axis2=2) / 3)


def _coherent(
    model: SteeringModel,
    channel: Complex[NDArray, "n"],
    power: Float[NDArray, "e a"],
    searched: Float[NDArray, "e a"],
    drift_variance_m2: Float[NDArray, "n"] | None,
    config: BearingConfig,
) -> _Hypotheses:
    """Peaks of the coherent sum, where odometry is good for the whole aperture."""
    directions = refined_peaks(model, channel, searched, config.hypotheses)
    weight, outlier_mass = hypothesis_weights(model, channel, power, directions, config.least_outlier_mass)
    covariance = [sandwich_covariance(model, channel, u, drift_variance_m2) for u in directions]
    directions = np.array([scored_direction(model, channel, u) for u in directions])
    return _Hypotheses(directions, np.array(covariance), weight, outlier_mass)


def _among_reflections(
    aperture: Aperture, range_m: float | None, correlation_packets: float, config: BearingConfig
) -> _Hypotheses:
    """Azimuths of a level path whose residual is smooth: other paths, not noise, limit the bearing."""
    found = level_hypotheses(
        aperture.position_odom_m,
        aperture.channel,
        aperture.wavelength_m,
        range_m,
        len(aperture.channel) / correlation_packets,
        config.level,
    )
    covariance = np.zeros((len(found.sigma_rad), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = found.sigma_rad**2, np.inf
    return _Hypotheses(found.direction, covariance, found.weight, found.outlier_mass, ordered=True)


def _resolved(
    aperture: Aperture,
    model: SteeringModel,
    drift_variance_m2: Float[NDArray, "n"],
    config: BearingConfig,
) -> _Hypotheses:
    """Directions of all paths together, where the smooth residual of one says that reflections limit it."""
    paths = resolve_paths(model, aperture.channel, config.multipath)
    drift = np.array([drift_covariance(model, u, drift_variance_m2) for u in paths.direction])
    return _Hypotheses(paths.direction, paths.covariance + drift, paths.weight, paths.outlier_mass)


def _tracked(
    model: SteeringModel,
    channel: Complex[NDArray, "n"],
    searched: Float[NDArray, "e a"],
    drift_variance_m2: Float[NDArray, "n"],
    config: BearingConfig,
) -> _Hypotheses:
    """Directions found together with odometry drift; the outlier mass is that of the focused profile."""
    starts = grid_peaks(searched, _TRACKED_STARTS, 0.1)
    tracked = tracked_peaks(model, channel, starts, drift_variance_m2, is_level(model), config.hypotheses)
    best = tracked[0]
    focused = channel * np.exp(-1j * best.drift_rad)
    # half the grid's resolution is enough for a probability
    power = bartlett_power(
        model.relative_m, focused, 4 * np.pi / model.wavenumber_rad_m, _FOCUS_AZIMUTHS, _FOCUS_ELEVATIONS
    )
    _, outlier_mass = hypothesis_weights(
        model, focused, power, best.direction[None], config.least_outlier_mass
    )
    return _Hypotheses(
        np.array([t.direction for t in tracked]),
        np.array([t.covariance for t in tracked]),
        tracked_weights(tracked),
        outlier_mass,
    )


def _curvature_rad(model: SteeringModel) -> float:
    """Phase by which a spherical wave departs from a plane one at the path's farthest point."""
    assert model.range_m is not None
    return float(model.wavenumber_rad_m * (model.relative_m**2).sum(1).max() / (2 * model.range_m))


def bearing_of_aperture(
    aperture: Aperture, observer: RobotLog, range_m: float | None, config: BearingConfig
) -> Bearing | None:
    """The bearing of one aperture with its full profile, or None if the path was a straight line."""
    model = steering_model(
        aperture.position_odom_m, aperture.wavelength_m, range_m if config.spherical else None
    )
    if is_straight(model):
        return None
    # one path looks the same on all subcarriers: their strongest common component carries it, noise averaged
    components = principal_channels(aperture.channel)[0][:, :_PROFILE_CHANNELS]
    components = components / np.abs(components[:, 0]).mean()
    channel = components[:, 0]
    power = bartlett_power(
        aperture.position_odom_m,
        components,
        aperture.wavelength_m,
        config.azimuth_count,
        config.elevation_count,
    )
    level = is_level(model)
    searched = power.copy()
    if model.range_m is not None and _curvature_rad(model) > _CURVED_PHASE_RAD:
        searched = bartlett_power(
            aperture.position_odom_m,
            components,
            aperture.wavelength_m,
            config.azimuth_count,
            config.elevation_count,
            range_m=model.range_m,
        )
    if level:
        searched[: config.elevation_count // 2] = 0  # the mirror image below the horizon says nothing new
    drift = _drift_variance(aperture, observer)
    if drift is not None and drift[-1] * model.wavenumber_rad_m**2 >= _COHERENT_DRIFT_RAD2:
        found = _tracked(model, channel, searched, drift, config)
    else:
        strongest = refined_peaks(model, channel, searched, 1)[0]
        reflected = residual_smoothness(model, channel, strongest) > _REFLECTED_SMOOTHNESS
        if level and reflected:
            correlation = residual_statistics(model, channel, strongest).correlation_packets
            found = _among_reflections(aperture, model.range_m, correlation, config)
        else:
            if drift is None:
                # an unmodelled walk must not steer the estimate, only be owned up to
                steps_m = np.linalg.norm(
                    np.diff(aperture.position_odom_m, axis=0, prepend=aperture.position_odom_m[:1]), axis=1
                )
                drift = (config.assumed_drift_percent / 100) ** 2 * np.cumsum(steps_m)
            if reflected:
                found = _resolved(aperture, model, drift, config)
            else:
                found = _coherent(model, channel, power, searched, drift, config)
    kept = found.weight >= 1e-3 * found.weight.max()
    kept[0] |= found.ordered
    order = np.arange(kept.sum()) if found.ordered else np.argsort(-found.weight[kept], kind="stable")
    directions, covariance = found.direction[kept][order], found.covariance[kept][order]
    weight = found.weight[kept][order]
    weight = weight / weight.sum() * (1 - found.outlier_mass)
    covariance = covariance + config.smallest_sigma_rad**2 * np.eye(2)
    if level:
        directions = np.column_stack([directions[:, :2], np.abs(directions[:, 2])])
    profile = unit_sum_profile(power)
    kappa = kappa_paper(
        profile, aperture.position_odom_m, aperture.wavelength_m, tolerance_rad=config.kappa_tolerance_rad
    )
    bearing = Bearing(
        observer=aperture.observer,
        peer=aperture.peer,
        time_s=float(aperture.time_s[aperture.reference]),
        peer_time_s=float(aperture.peer_time_s[aperture.reference]),
        T_odom_body=aperture.T_odom_body,
        direction_odom=directions,
        tangent_covariance=covariance,
        weight=weight,
        outlier_mass=found.outlier_mass,
        kappa_paper=kappa,
        packets=len(aperture.channel),
        profile=profile,
        origin_odom_m=aperture.position_odom_m.mean(0),
        faults=aperture.faults,
    )
    return config.calibration.applied(bearing)


OfAperture = Callable[[Aperture, RobotLog, float | None, BearingConfig], Bearing | None]
"""Aperture, observer, range [m] to the peer if known, options: see :func:`bearing_of_aperture`."""


def sharpness(bearing: Bearing) -> float:
    """Smaller is better: variance of the azimuth, distrust added."""
    return float(bearing.tangent_covariance[0, 0, 0]) / max(float(bearing.weight[0]), 1e-6) ** 4


def estimate_bearings(
    robots: Sequence[RobotLog],
    config: BearingConfig,
    progress: Callable[[int, int, str], None] | None = None,
    of_aperture: OfAperture = bearing_of_aperture,
) -> list[Bearing]:
    """Every bearing of every pair, in both directions, in order of the observers' times.

    Args:
        robots: The team.
        config: Options.
        progress: Called with (apertures done, apertures in all, "observer → peer").
        of_aperture: Gives one aperture's bearing; another may remember what it gave before.

    Raises:
        InputError: A peer is no robot of the team, or a CSI track is dead or one-sided.
    """
    names = {robot.name for robot in robots}
    for robot in robots:
        for peer in robot.csi:
            if peer not in names:
                raise InputError(
                    f"/{robot.name}/csi/{peer}",
                    "peer",
                    "is no robot of this mission",
                    "fix the topic mapping",
                )
    work: list[tuple[RobotLog, RobotLog, Aperture]] = []
    for first, second in combinations(robots, 2):
        if second.name not in first.csi and first.name not in second.csi:
            continue
        pairs = pair_packets(first, second, config.undo_phase_jumps)
        work += [(first, second, a) for a in find_apertures(pairs, first, second, config.aperture)]
        work += [(second, first, a) for a in find_apertures(pairs.swapped(), second, first, config.aperture)]
    bearings: list[Bearing] = []
    for done, (observer, peer, aperture) in enumerate(work):
        if progress is not None:
            progress(done, len(work), f"{observer.name} → {peer.name}")
        bearing = of_aperture(aperture, observer, range_during(observer, peer, aperture), config)
        if bearing is None:
            continue
        if config.keep_profile is KeepProfile.NONE:
            bearing = replace(bearing, profile=None)
        bearings.append(bearing)
    if config.keep_profile is KeepProfile.ONE and bearings:
        best = min(range(len(bearings)), key=lambda i: sharpness(bearings[i]))
        bearings = [b if i == best else replace(b, profile=None) for i, b in enumerate(bearings)]
    if progress is not None and work:
        progress(len(work), len(work), "bearings done")
    return sorted(bearings, key=lambda bearing: bearing.time_s)
