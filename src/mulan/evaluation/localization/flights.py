"""EuRoC flights of one room as robots of one team: real odometry estimates beside the true motion.

Flights made one after another are replayed at the same time: each clock starts at zero with the ground truth.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from mulan.errors import InputError
from mulan.geometry import se3, so3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import OdometryTrack, Photo, PoseTrack, RobotLog
from mulan.wireless.recordings.uwb_samples import finite_numbers, read_lines

_COLUMNS = 8
_NO_CAMERA = PinholeCamera(1, 1, 1.0, 1.0, 0.5, 0.5)
_UNIT = 1e-3


@dataclass(frozen=True)
class Flight:
    """One robot: what it estimated and where it was, on one clock.

    Attributes:
        name: Of the sequence.
        odometry: The estimate, in its own start frame, without a covariance.
        truth: In the room's frame.
    """

    name: str
    odometry: OdometryTrack
    truth: PoseTrack

    @property
    def span_s(self) -> tuple[float, float]:
        """When both are known."""
        own, true = self.odometry.time_s, self.truth.time_s
        return max(float(own[0]), float(true[0])), min(float(own[-1]), float(true[-1]))


def read_tum(path: Path) -> PoseTrack:
    """Poses of a TUM text file, ``t x y z qx qy qz qw`` a line, plain or gzip.

    Raises:
        InputError: The file is missing or damaged, a line is not eight finite numbers, a quaternion is not of
            unit length, or time does not increase.
    """
    rows = []
    for number, line in enumerate(read_lines(path), start=1):
        if line.lstrip().startswith("#"):
            continue
        words = line.split()
        if len(words) != _COLUMNS:
            raise InputError(
                path, f"line {number}", f"has {len(words)} of {_COLUMNS} values", "fetch it again"
            )
        rows.append(finite_numbers(path, number, words))
    if len(rows) < 2:
        raise InputError(path, "poses", "are fewer than two", "fetch it again")
    table = np.array(rows)
    if (np.abs(np.linalg.norm(table[:, 4:], axis=1) - 1) > _UNIT).any():
        raise InputError(path, "quaternion", "is not of unit length", "fetch it again")
    if (np.diff(table[:, 0]) <= 0).any():
        raise InputError(path, "time", "does not increase", "sort the lines by time")
    return PoseTrack(table[:, 0], se3.from_parts(so3.from_quaternion(table[:, 4:]), table[:, 1:4]))


def read_flight(folder: Path, estimate: str) -> Flight:
    """One sequence of ``euroc_vio`` with the estimate asked for (``vio_mono``, ``vislam_mono_run0``, ...).

    The first poses of a visual-inertial estimate are placeholders from before it started (identity) and are
    left out.

    Raises:
        InputError: A file is bad or the two do not overlap.
    """
    truth = read_tum(folder / "groundtruth.txt.gz")
    path = folder / f"{estimate}.txt.gz"
    own = read_tum(path)
    begin_s = truth.time_s[0]
    placeholder = np.asarray(np.isclose(own.T_world_body, np.eye(4)).all((1, 2)))
    started = len(placeholder) if placeholder.all() else int((~placeholder).argmax())
    if len(placeholder) - started < 2:
        raise InputError(path, "poses", "are all placeholders", "fetch it again")
    odometry = OdometryTrack(own.time_s[started:] - begin_s, own.T_world_body[started:], None)
    if odometry.time_s[-1] < 0 or odometry.time_s[0] > truth.time_s[-1] - begin_s:
        raise InputError(path, "time", "does not overlap the ground truth", "give files of the same flight")
    return Flight(folder.name, odometry, PoseTrack(truth.time_s - begin_s, truth.T_world_body))


def on_estimators_body(flight: Flight) -> tuple[Flight, Float[NDArray, "3"]]:
    """The truth about the body the estimator means, and the turn between the two bodies [rad, body axes].

    A constant turn between the body of the ground truth and that of the estimates is a matter of mounting
    (some degrees in the Vicon room) and neither drift nor radio; the mean over the flight is taken out of
    the truth before anything is drawn on it or compared with it.
    """
    own, truth = flight.odometry, flight.truth
    begin_s, end_s = flight.span_s
    inside = (own.time_s >= begin_s) & (own.time_s <= end_s)
    T = own.T_odom_body[inside]
    true = se3.interpolate(truth.time_s, truth.T_world_body, own.time_s[inside])
    aligned = turned_about_vertical(T[:, :3, 3], true[:, :3, 3]) @ T
    turn = so3.log(np.swapaxes(true[:, :3, :3], 1, 2) @ aligned[:, :3, :3]).mean(0)
    T_body = se3.from_parts(so3.exp(turn), np.zeros(3))
    return replace(flight, truth=PoseTrack(truth.time_s, truth.T_world_body @ T_body)), turn


def well_known(track: OdometryTrack, time_s: Float[NDArray, "n"], within_s: float) -> Bool[NDArray, "n"]:
    """Where a sample of the track is near in time, so that interpolation adds next to nothing."""
    after = np.clip(np.searchsorted(track.time_s, time_s), 1, len(track.time_s) - 1)
    gap = np.minimum(np.abs(track.time_s[after] - time_s), np.abs(time_s - track.time_s[after - 1]))
    return gap <= within_s


def shared_instants(
    first: Flight, second: Flight, begin_s: float, every_s: float, within_s: float
) -> Float[NDArray, "n"]:
    """Instants at about even intervals at which both poses are well known: at samples of either track.

    Args:
        first: One of the pair.
        second: The other.
        begin_s: After the later start of the two.
        every_s: Interval; an instant is at most half of it late or early, or left out.
        within_s: How near both tracks must have a sample.
    """
    begin_s += max(first.span_s[0], second.span_s[0])
    end_s = min(first.span_s[1], second.span_s[1])
    samples = np.unique(np.concatenate([first.odometry.time_s, second.odometry.time_s]))
    samples = samples[(samples >= begin_s - every_s / 2) & (samples >= 0) & (samples <= end_s)]
    samples = samples[(samples >= max(first.span_s[0], second.span_s[0]))]
    for flight in (first, second):
        samples = samples[well_known(flight.odometry, samples, within_s)]
    if not len(samples):
        return samples
    wanted = np.arange(begin_s, end_s, every_s)
    nearest = samples[np.abs(samples[None] - wanted[:, None]).argmin(1)]
    return np.unique(nearest[np.abs(nearest - wanted) <= every_s / 2])


def turned_about_vertical(
    source_m: Float[NDArray, "n 3"], target_m: Float[NDArray, "n 3"]
) -> Float[NDArray, "4 4"]:
    """Yaw and translation that best lay one path on another (least squares)."""
    a, b = source_m - source_m.mean(0), target_m - target_m.mean(0)
    yaw = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a[:, :2] * b[:, :2]).sum())
    R = so3.about_z(np.array(yaw))
    return se3.from_parts(R, target_m.mean(0) - R @ source_m.mean(0))


def resampled(track: OdometryTrack, rate_hz: float) -> OdometryTrack:
    """A sparse key-frame track filled in: cubic positions, geodesic attitudes.

    The key frames themselves are kept. A straight line between key frames a second apart would cut the
    curves a flying robot takes.
    """
    time_s = np.unique(
        np.concatenate([track.time_s, np.arange(track.time_s[0], track.time_s[-1], 1 / rate_hz)])
    )
    T = se3.interpolate(track.time_s, track.T_odom_body, time_s)
    T[:, :3, 3] = CubicSpline(track.time_s, track.T_odom_body[:, :3, 3])(time_s)
    return OdometryTrack(time_s, T, None)


def as_robot(flight: Flight, photo_s: Float[NDArray, "n"]) -> RobotLog:
    """The log the localization takes: radio antennas at the body's origin, photographs without content."""
    begin_s, end_s = flight.span_s
    inside = photo_s[(photo_s >= begin_s) & (photo_s <= end_s)]
    return RobotLog(
        name=flight.name,
        camera=_NO_CAMERA,
        T_body_camera=np.eye(4),
        wifi_antenna_body_m=np.zeros(3),
        uwb_antenna_body_m=np.zeros(3),
        photos=tuple(Photo(float(t), "png", b"") for t in inside),
        odometry=flight.odometry,
        csi={},
        ranges={},
        ground_truth=flight.truth,
    )
