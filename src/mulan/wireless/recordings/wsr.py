"""Recordings of the WSR toolbox (Jadhav et al., Harvard REACT): one moving receiver, static transmitters."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3, so3
from mulan.mission.types import CsiTrack, OdometryTrack
from mulan.wireless.recordings.intel5300 import CHANNEL_108_HZ, subcarriers_hz
from mulan.wireless.recordings.strict_npz import read_strict_npz

OBSERVER = "rx"
_REMEDY = "decode the recording again in the layout of docs/recordings.md"
_POSE_COLUMNS = 14  # time, x, y, z, qx, qy, qz, qw, three linear and three angular velocities
_MOST_BACKWARD = 0.05  # share of stamps that may run backwards before the track is refused


@dataclass(frozen=True)
class PositionTrack:
    """Positions without attitude, as motion capture of one marker gives them.

    Attributes:
        time_s: Stamps, strictly increasing.
        position_m: In the motion-capture frame.
    """

    time_s: Float[NDArray, "m"]
    position_m: Float[NDArray, "m 3"]


@dataclass(frozen=True)
class WsrLink:
    """Packets exchanged between the moving robot and one static robot.

    Attributes:
        name: The static robot.
        forward: Its packets as the moving robot received them.
        reverse: The moving robot's packets as it received them, on its own clock.
        source_position_m: Its true position in the motion-capture frame.
    """

    name: str
    forward: CsiTrack
    reverse: CsiTrack
    source_position_m: Float[NDArray, "3"]


@dataclass(frozen=True)
class WsrRun:
    """One recording: a moving robot, its links and three estimates of its path on one clock.

    Attributes:
        name: Of the run, e.g. "L1_2021-06-27_202550".
        links: In the order of the file.
        mocap: True positions of the moving robot.
        t265: Visual-inertial odometry in its own start frame.
        odometry: Wheel odometry in its own frame.
        start_m: Motion-capture position at the first moved sample.
        motion_s: Begin and end of the motion on the moving robot's clock.
    """

    name: str
    links: tuple[WsrLink, ...]
    mocap: PositionTrack
    t265: OdometryTrack
    odometry: OdometryTrack
    start_m: Float[NDArray, "3"]
    motion_s: tuple[float, float]

    def link(self, name: str) -> WsrLink:
        """The link to one static robot.

        Raises:
            KeyError: No link has that name.
        """
        for link in self.links:
            if link.name == name:
                return link
        raise KeyError(name)


class _Arrays:
    """Members of one archive, each demanded with its type and shape."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.by_name = read_strict_npz(path)

    def fault(self, field: str, problem: str) -> InputError:
        return InputError(self.path, field, problem, _REMEDY)

    def take(self, field: str, dtype: type, shape: tuple[int | None, ...]) -> NDArray:
        """The member, with ``None`` matching any length above zero.

        Raises:
            InputError: Missing, of another type or shape, empty, or not finite.
        """
        if field not in self.by_name:
            raise self.fault(field, "is missing")
        array = self.by_name[field]
        wanted = " x ".join("n" if size is None else str(size) for size in shape)
        if array.dtype != np.dtype(dtype):
            raise self.fault(field, f"is of type {array.dtype} instead of {np.dtype(dtype)}")
        fits = array.ndim == len(shape) and all(
            size == want or (want is None and size > 0) for size, want in zip(array.shape, shape, strict=True)
        )
        if not fits:
            raise self.fault(field, f"has shape {array.shape} instead of {wanted}")
        if array.dtype.kind == "f":
            bad = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(1))
            if len(bad):
                raise self.fault(field, f"is not finite in row {bad[0]} ({len(bad)} of {len(array)} rows)")
        return array

    def stamps(self, field: str) -> Float[NDArray, "n"]:
        time_s = self.take(field, np.float64, (None,))
        if (np.diff(time_s) <= 0).any():
            row = int(np.argmax(np.diff(time_s) <= 0)) + 1
            raise self.fault(field, f"does not increase at row {row}")
        return time_s


def read_wsr_run(path: Path, carrier_hz: float = CHANNEL_108_HZ) -> WsrRun:
    """One decoded run (.npz as docs/recordings.md lays it out).

    Args:
        path: The file.
        carrier_hz: Centre of the band, which the cards do not record.

    Raises:
        InputError: The file or a member is missing, damaged, of other type or shape, not finite or all zero.
    """
    arrays = _Arrays(Path(path))
    names = _link_names(arrays)
    motion = arrays.take("move_t0_t1", np.float64, (2,))
    if not motion[0] < motion[1]:
        raise arrays.fault("move_t0_t1", f"begins at {motion[0]} and ends at {motion[1]}")
    mocap = arrays.take("mocap", np.float64, (None, 4))
    return WsrRun(
        name=arrays.path.stem,
        links=tuple(_link(arrays, name, carrier_hz) for name in names),
        mocap=position_track(arrays.path, "mocap", mocap[:, 0], mocap[:, 1:]),
        t265=_odometry(arrays, "t265"),
        odometry=_odometry(arrays, "odom"),
        start_m=arrays.take("start", np.float64, (3,)),
        motion_s=(float(motion[0]), float(motion[1])),
    )


def _link_names(arrays: _Arrays) -> list[str]:
    links = arrays.by_name.get("links")
    if links is None or links.dtype.kind != "U" or links.ndim != 1 or links.size == 0:
        found = "is missing" if links is None else f"is {links.dtype} of shape {links.shape}"
        raise arrays.fault("links", f"{found} instead of a list of names")
    names = [str(name) for name in links]
    if len(set(names)) < len(names):
        raise arrays.fault("links", f"names one twice: {', '.join(names)}")
    unlisted = {field.removesuffix("_csi_rx") for field in arrays.by_name if field.endswith("_csi_rx")} - set(
        names
    )
    if unlisted:
        raise arrays.fault("links", f"does not list {', '.join(sorted(unlisted))}, which has CSI in the file")
    return names


def _link(arrays: _Arrays, name: str, carrier_hz: float) -> WsrLink:
    frame = arrays.take(f"{name}_frame", np.uint32, (None,))
    n = len(frame)
    tracks = []
    for side, sender in (("rx", name), ("tx", OBSERVER)):
        time_s = arrays.stamps(f"{name}_t_{side}")
        csi = arrays.take(f"{name}_csi_{side}", np.int8, (None, 30, 2))
        for field, length in ((f"{name}_t_{side}", len(time_s)), (f"{name}_csi_{side}", len(csi))):
            if length != n:
                raise arrays.fault(field, f"has {length} rows but {name}_frame has {n}")
        if not csi.any():
            raise arrays.fault(f"{name}_csi_{side}", "is zero in every packet")
        channel = csi[..., 0] + 1j * csi[..., 1]
        tracks.append(CsiTrack(sender, time_s, frame, channel[:, None, :], subcarriers_hz(carrier_hz)))
    position = arrays.take(f"{name}_pos", np.float64, (3,))
    return WsrLink(name, tracks[0], tracks[1], position)


def _odometry(arrays: _Arrays, field: str) -> OdometryTrack:
    table = arrays.take(field, np.float64, (None, _POSE_COLUMNS))
    return odometry_track(arrays.path, field, table[:, 0], table[:, 1:4], table[:, 4:8])


def position_track(
    path: Path, field: str, time_s: Float[NDArray, "n"], position_m: Float[NDArray, "n 3"]
) -> PositionTrack:
    """Positions at strictly increasing stamps.

    Raises:
        InputError: Fewer than two rows, or more than one in twenty runs backwards in time.
    """
    keep = _increasing(path, field, time_s)
    return PositionTrack(time_s[keep], position_m[keep])


def odometry_track(
    path: Path,
    field: str,
    time_s: Float[NDArray, "n"],
    position_m: Float[NDArray, "n 3"],
    quaternion: Float[NDArray, "n 4"],
) -> OdometryTrack:
    """Poses at strictly increasing stamps from positions and quaternions (x, y, z, w).

    Raises:
        InputError: As ``position_track``, or a quaternion that is not of unit length.
    """
    length = np.linalg.norm(quaternion, axis=1)
    bad = np.flatnonzero(~(np.abs(length - 1) < 0.01))
    if len(bad):
        raise InputError(
            path, field, f"row {bad[0]} has a quaternion of length {length[bad[0]]:.3g} instead of 1", _REMEDY
        )
    keep = _increasing(path, field, time_s)
    poses = se3.from_parts(so3.from_quaternion(quaternion[keep]), position_m[keep])
    return OdometryTrack(time_s[keep], poses, None)


def _increasing(path: Path, field: str, time_s: Float[NDArray, "n"]) -> NDArray:
    """Rows later than all before them: a few recordings hold one stamp that jumps back by milliseconds."""
    keep = np.flatnonzero(np.diff(np.maximum.accumulate(time_s), prepend=-np.inf) > 0)
    if len(keep) < 2 or len(keep) < (1 - _MOST_BACKWARD) * len(time_s):
        raise InputError(
            path, field, f"only {len(keep)} of {len(time_s)} stamps come after all before them", _REMEDY
        )
    return keep
