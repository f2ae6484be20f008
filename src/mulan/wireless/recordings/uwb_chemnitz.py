"""The Labyrinth robot of TU Chemnitz: ranges behind walls, odometry, truth (Pfeifer, libRSF ``Indoor_UWB``).

Text, one measurement a line, SI units, planar: ``range2 t range variance anchor_x anchor_y anchor_id snr``,
``odom2diff t v_right v_left v_y wheel_base cov cov cov`` and, in the truth, ``point2 t x y`` and covariances.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.wireless.recordings.uwb_samples import RangeSamples, check_ranges, finite_numbers, read_lines

ROBOT = "robot"
_FIELDS = {"range2": 7, "odom2diff": 8, "point2": 7}
_LONGEST_GAP_S = 0.5


@dataclass(frozen=True)
class ChemnitzRun:
    """One drive.

    Attributes:
        samples: Ranges with truth.
        range_anchor_m: Anchor of each link [links, 2].
        position_m: True place of the robot at each range [n, 2].
        odometry_time_s: [m].
        wheel_speed_m_per_s: Right and left wheel [m, 2].
        wheel_base_m: As the recording gives it.
    """

    samples: RangeSamples
    range_anchor_m: Float[NDArray, "l 2"]
    position_m: Float[NDArray, "n 2"]
    odometry_time_s: Float[NDArray, "m"]
    wheel_speed_m_per_s: Float[NDArray, "m 2"]
    wheel_base_m: float


def _records(path: Path, kinds: tuple[str, ...]) -> dict[str, NDArray]:
    rows: dict[str, list[list[float]]] = {kind: [] for kind in kinds}
    for number, line in enumerate(read_lines(path), start=1):
        kind, *words = line.split()
        if kind not in rows:
            raise InputError(
                path, f"line {number}", f"kind '{kind[:30]}' is unknown", f"keep {', '.join(kinds)}"
            )
        if len(words) != _FIELDS[kind]:
            raise InputError(
                path, f"line {number}", f"{kind} has {len(words)} of {_FIELDS[kind]} values", "fetch it again"
            )
        rows[kind].append(finite_numbers(path, number, words))
    tables = {kind: np.array(values) for kind, values in rows.items()}
    for kind, table in tables.items():
        if not len(table):
            raise InputError(path, kind, "there are none", "fetch it again")
        if (np.diff(table[:, 0]) < 0).any():
            raise InputError(path, kind, "the time goes backwards", "sort the lines by time")
    return tables


def read_chemnitz(measurements: Path, truth: Path) -> ChemnitzRun:
    """Ranges, odometry and truth of the drive; truth is interpolated to each range.

    Raises:
        InputError: A file is missing or not text, a line has an unknown kind, too few values or one that is
            not finite, time goes backwards, an anchor moves, or the truth does not cover the ranges.
    """
    tables = _records(measurements, ("range2", "odom2diff"))
    points = _records(truth, ("point2",))["point2"]
    ranges, odometry = tables["range2"], tables["odom2diff"]
    check_ranges(measurements, ranges[:, 1])
    if (ranges[:, 2] <= 0).any():
        raise InputError(measurements, "range2 variance", "is not positive", "fetch it again")
    anchors, link = np.unique(ranges[:, 5], return_inverse=True)
    places = np.array([ranges[link == i, 3:5][0] for i in range(len(anchors))])
    if np.abs(places[link] - ranges[:, 3:5]).max() > 0:
        raise InputError(measurements, "range2 anchor", "stands at two places", "give each anchor one place")
    time_s = ranges[:, 0]
    if time_s[0] < points[0, 0] - _LONGEST_GAP_S or time_s[-1] > points[-1, 0] + _LONGEST_GAP_S:
        raise InputError(truth, "time", "does not cover the ranges", "give the truth of the same run")
    position = np.stack([np.interp(time_s, points[:, 0], points[:, k]) for k in (1, 2)], axis=1)
    samples = RangeSamples(
        "Indoor_UWB",
        tuple((f"anchor{anchor:.0f}", ROBOT) for anchor in anchors),
        link,
        time_s,
        ranges[:, 1],
        np.linalg.norm(position - places[link], axis=1),
        np.sqrt(ranges[:, 2]),
    )
    return ChemnitzRun(samples, places, position, odometry[:, 0], odometry[:, 1:3], float(odometry[0, 4]))
