"""A WSR run as the robots wrote it: .dat files of the cards, trajectories as csv, positions as json."""

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.wireless.recordings.intel5300 import CHANNEL_108_HZ, Intel5300Packets, read_intel5300
from mulan.wireless.recordings.wsr import (
    OBSERVER,
    PositionTrack,
    WsrLink,
    WsrRun,
    odometry_track,
    position_track,
)

# the cards the recordings were made with; rx is the moving robot
WSR_MACS = {
    "rx": "00:21:6A:53:89:D2",
    "tx2": "00:21:6A:3F:17:5A",
    "tx3": "00:21:6A:30:D2:3C",
    "tx4": "00:21:6A:B2:6E:FA",
}
_MOVED_M = 0.006  # the authors' threshold for the begin and end of the motion
_MAX_TEXT_BYTES = 64 * 2**20
_REMEDY = "copy the run again from its source"


def read_wsr_raw(
    folder: Path, macs: dict[str, str] | None = None, carrier_hz: float = CHANNEL_108_HZ
) -> WsrRun:
    """One original run: every packet of the recording, paired or not, moving or not.

    Args:
        folder: Holds csi_<robot>_*.dat, [t265_|odom_]rx_trajectory_*.csv, groundtruth_positions.json.
        macs: Address of each robot's card; those of the published recordings unless given.
        carrier_hz: Centre of the 20 MHz channel.

    Raises:
        InputError: A file is missing, there twice, or malformed; a link has CSI at one end only.
    """
    folder, macs = Path(folder), WSR_MACS if macs is None else macs
    received = read_intel5300(_only(folder, f"csi_{OBSERVER}_*.dat"))
    positions = _source_positions(folder / "groundtruth_positions.json")
    names = sorted(name for name in macs if name != OBSERVER and any(folder.glob(f"csi_{name}_*.dat")))
    if not names:
        raise InputError(folder, "csi_*.dat", f"none is there but {OBSERVER}'s", _REMEDY)
    links = tuple(_link(folder, name, macs, received, positions, carrier_hz) for name in names)
    time_s, position_m, _ = _trajectory(_only(folder, "rx_trajectory_*.csv"), 0)
    mocap = position_track(folder, "rx_trajectory", time_s, position_m)
    motion_s, start_m = _motion(folder, mocap)
    odometry = [
        odometry_track(folder, field, *_trajectory(_only(folder, f"{field}_*.csv"), 4))
        for field in ("t265_rx_trajectory", "odom_rx_trajectory")
    ]
    return WsrRun(folder.name, links, mocap, odometry[0], odometry[1], start_m, motion_s)


def _only(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        raise InputError(folder, pattern, f"matches {len(found)} files instead of one", _REMEDY)
    return found[0]


def _link(
    folder: Path,
    name: str,
    macs: dict[str, str],
    received: Intel5300Packets,
    positions: dict[str, Float[NDArray, "3"]],
    carrier_hz: float,
) -> WsrLink:
    if name not in positions:
        raise InputError(folder, "groundtruth_positions.json", f"has no position of {name}", _REMEDY)
    replies = read_intel5300(_only(folder, f"csi_{name}_*.dat"))
    return WsrLink(
        name,
        received.track(name, macs[name], carrier_hz),
        replies.track(OBSERVER, macs[OBSERVER], carrier_hz),
        positions[name],
    )


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _MAX_TEXT_BYTES:
            raise InputError(path, "file", f"is larger than {_MAX_TEXT_BYTES} bytes", "split the recording")
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(path, "file", f"cannot be read ({fault})", _REMEDY) from fault


def _source_positions(path: Path) -> dict[str, Float[NDArray, "3"]]:
    try:
        entries = json.loads(_text(path))["true_tx_positions"]["value"]
        found = {
            str(name): np.array([float(entry["position"][axis]) for axis in "xyz"])
            for name, entry in entries.items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as fault:
        raise InputError(
            path, "true_tx_positions", f"is no table of positions ({fault!r})", _REMEDY
        ) from fault
    for name, position in found.items():
        if not np.isfinite(position).all():
            raise InputError(path, name, f"is at {position}, which is not finite", _REMEDY)
    return found


def _trajectory(
    path: Path, quaternion_columns: int
) -> tuple[Float[NDArray, "n"], Float[NDArray, "n 3"], Float[NDArray, "n q"]]:
    """Times, positions and quaternions; columns are seconds, nanoseconds, x, y, z[, qx, qy, qz, qw, ...]."""
    columns = 5 + quaternion_columns
    rows = [line.rstrip(", ").split(",") for line in _text(path).splitlines() if line.strip()]
    if not rows:
        raise InputError(path, "rows", "are missing", _REMEDY)
    try:
        # the seconds keep their digits only if read apart from the nanoseconds
        table = np.array([[float(cell) for cell in row[:columns]] for row in rows])
    except ValueError as fault:
        raise InputError(path, "rows", f"are not all numbers of one width ({fault})", _REMEDY) from fault
    if table.ndim != 2 or table.shape[1] != columns:
        raise InputError(path, "columns", f"are fewer than {columns}", _REMEDY)
    if not np.isfinite(table).all():
        row = int(np.argmax(~np.isfinite(table).all(1)))
        raise InputError(path, "rows", f"hold a value that is not finite in row {row}", _REMEDY)
    return table[:, 0] + table[:, 1] * 1e-9, table[:, 2:5], table[:, 5:]


def _motion(folder: Path, mocap: PositionTrack) -> tuple[tuple[float, float], Float[NDArray, "3"]]:
    """Begin and end of the motion and the first moved position."""
    from_first = np.linalg.norm(mocap.position_m - mocap.position_m[0], axis=1) > _MOVED_M
    from_last = np.linalg.norm(mocap.position_m - mocap.position_m[-1], axis=1) > _MOVED_M
    if not from_first.any() or not from_last.any():
        raise InputError(folder, "rx_trajectory", f"never moves more than {_MOVED_M * 1e3:g} mm", _REMEDY)
    first, last = int(np.argmax(from_first)), int(np.flatnonzero(from_last)[-1])
    if not mocap.time_s[first] < mocap.time_s[last]:
        raise InputError(folder, "rx_trajectory", "jumps once instead of moving", _REMEDY)
    return (float(mocap.time_s[first]), float(mocap.time_s[last])), mocap.position_m[first]
