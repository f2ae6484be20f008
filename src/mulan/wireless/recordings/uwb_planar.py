"""Eight anchors, three tags on a trolley, motion capture (CUHK-Shenzhen planar data set, Haodong Jiang 2023).

Ranges: date-time and 24 columns a0-t0, a0-t1, a0-t2, a1-t0, ... a7-t2. Poses: date-time, x, y, z, q1..q4. The
quaternion is (w, x, y, z) of a body whose z points down: the heading that fits the ranges is 2 atan2(q3, q2).
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.wireless.recordings.uwb_samples import RangeSamples, check_ranges, finite_numbers, read_lines

ANCHORS, TAGS = 8, 3
LINKS = tuple((f"a{a}", f"t{t}") for a in range(ANCHORS) for t in range(TAGS))
_STAMP = "%Y-%m-%d %H:%M:%S.%f"
_LONGEST_GAP_S = 0.1
_UNIT = 1e-3


@dataclass(frozen=True)
class PlanarSite:
    """Surveyed places: anchors in the global frame and tags in the trolley's, metres."""

    anchors_m: Float[NDArray, "8 3"]
    tags_m: Float[NDArray, "3 3"]


@dataclass(frozen=True)
class PlanarRun:
    """Ranges of all 24 links with the trolley's true pose at each row.

    Attributes:
        samples: Up to 24 measurements a row, all links of one instant together; those not heard are left out.
        time_s: Of each row [r].
        position_m: Of the trolley at each row [r, 3].
        yaw_rad: Its heading at each row [r].
        site: Anchors and tags.
    """

    samples: RangeSamples
    time_s: Float[NDArray, "r"]
    position_m: Float[NDArray, "r 3"]
    yaw_rad: Float[NDArray, "r"]
    site: PlanarSite


# the source's README (its survey); dynamic set of 15 August, static sets of 20 August 2022
DYNAMIC_SITE = PlanarSite(
    np.array(
        [
            [-3.4203, 3.0053, 1.0442],
            [0.0016, 3.0110, 1.0446],
            [3.6056, 2.9795, 1.0463],
            [3.6011, -0.0008, 1.0422],
            [3.5674, -3.0087, 1.0443],
            [-0.0072, -2.9652, 1.0444],
            [-3.4673, -2.9587, 1.0445],
            [-3.4858, -0.0098, 1.0457],
        ]
    ),
    np.array([[-0.0689, -0.1423, 0.0011], [-0.0750, 0.1402, 0.0016], [0.2034, 0.1451, -0.0008]]),
)
STATIC_SITE = PlanarSite(
    np.array(
        [
            [0.9998, -2.7280, 1.3172],
            [-0.0878, -3.0177, 1.3074],
            [-1.8220, -2.0699, 1.3006],
            [-1.8172, 0.3327, 1.3017],
            [-1.6477, 2.3528, 1.3042],
            [0.1867, 2.7016, 1.3053],
            [1.6764, 2.6419, 1.3152],
            [2.0707, -0.0953, 1.3030],
        ]
    ),
    np.array([[-0.1130, -0.2432, 0.0033], [-0.1316, 0.2363, 0.0020], [0.3492, 0.2542, 0.0000]]),
)
# yaw [rad], x, y [m] of the two poses at rest; the height is not given, the tags stand level with the anchors
STATIC_POSES = {
    "UWB_static_exp_8_20_pos1_deg_0.csv.gz": (np.deg2rad(0.709), -0.0484, -1.2212),
    "UWB_static_exp_8_20_pos1_deg_60.csv.gz": (np.deg2rad(61.488), 0.0256, -1.3399),
}


def true_ranges(
    site: PlanarSite, position_m: Float[NDArray, "r 3"], yaw_rad: Float[NDArray, "r"]
) -> Float[NDArray, "r 24"]:
    """Distances of all links for each pose of the trolley, columns in the order of ``LINKS``."""
    c, s = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    x, y, z = site.tags_m.T
    tags = np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, (len(yaw_rad), TAGS))], -1)
    tags = tags + position_m[:, None]
    return np.linalg.norm(site.anchors_m[None, :, None] - tags[:, None], axis=-1).reshape(len(yaw_rad), -1)


def _table(path: Path, columns: int, header: bool, gaps: bool) -> tuple[NDArray, NDArray]:
    """Times and numbers; where gaps are allowed an empty cell becomes NaN (a range that was not heard)."""
    times, rows = [], []
    for number, line in enumerate(read_lines(path), start=1):
        if header and number == 1:
            continue
        words = line.split(",")
        if len(words) != columns + 1:
            raise InputError(
                path, f"line {number}", f"has not a time and {columns} numbers", "fetch it again"
            )
        try:
            stamp = datetime.strptime(words[0].strip(), _STAMP).replace(tzinfo=UTC)
        except ValueError:
            raise InputError(
                path, f"line {number}", f"'{words[0][:40]}' is no date and time", "fetch it again"
            ) from None
        times.append(stamp.timestamp())
        if gaps:
            heard = [bool(word.strip()) for word in words[1:]]
            row = np.full(columns, np.nan)
            row[heard] = finite_numbers(path, number, [word for word in words[1:] if word.strip()])
            rows.append(row)
        else:
            rows.append(finite_numbers(path, number, words[1:]))
    if not rows:
        raise InputError(path, "rows", "there are none", "fetch it again")
    time_s = np.array(times)
    if (np.diff(time_s) < 0).any():
        line = int(np.argmax(np.diff(time_s) < 0)) + 2 + header
        raise InputError(path, f"line {line}", "the time goes backwards", "sort the rows by time")
    return time_s, np.array(rows)


def _run(
    path: Path, time_s: NDArray, table: NDArray, position_m: NDArray, yaw_rad: NDArray, site: PlanarSite
) -> PlanarRun:
    heard = np.isfinite(table).ravel()
    check_ranges(path, table[np.isfinite(table)])
    count = len(time_s)
    samples = RangeSamples(
        path.name.removesuffix(".csv.gz"),
        LINKS,
        np.tile(np.arange(len(LINKS)), count),
        np.repeat(time_s, len(LINKS)),
        table.ravel(),
        true_ranges(site, position_m, yaw_rad).ravel(),
    )
    return PlanarRun(samples.where(heard), time_s, position_m, yaw_rad, site)


def read_planar_dynamic(ranges: Path, poses: Path, site: PlanarSite = DYNAMIC_SITE) -> PlanarRun:
    """The moving trolley; poses are interpolated to each row of ranges, rows without a near pose left out.

    Raises:
        InputError: A file is missing, damaged, has a wrong number of columns, times that go backwards, a
            quaternion not of unit length, a range below zero, or the two clocks do not overlap.
    """
    time_s, table = _table(ranges, len(LINKS), header=False, gaps=True)
    pose_s, pose = _table(poses, 7, header=True, gaps=False)
    if (np.abs(np.linalg.norm(pose[:, 3:], axis=1) - 1) > _UNIT).any():
        raise InputError(poses, "quaternion", "is not of unit length", "fetch it again")
    fresh = np.r_[True, np.diff(pose_s) > 0]
    pose_s, pose = pose_s[fresh], pose[fresh]
    yaw = np.unwrap(2 * np.arctan2(pose[:, 5], pose[:, 4]))
    after = np.clip(np.searchsorted(pose_s, time_s), 1, len(pose_s) - 1)
    inside = (time_s >= pose_s[0]) & (time_s <= pose_s[-1])
    inside &= pose_s[after] - pose_s[after - 1] <= _LONGEST_GAP_S
    if not inside.any():
        raise InputError(poses, "time", "does not overlap the ranges", "give the poses of the same run")
    time_s, table = time_s[inside], table[inside]
    position = np.stack([np.interp(time_s, pose_s, pose[:, k]) for k in range(3)], axis=1)
    return _run(ranges, time_s, table, position, np.interp(time_s, pose_s, yaw), site)


def read_planar_static(path: Path, site: PlanarSite = STATIC_SITE) -> PlanarRun:
    """The trolley at rest at one of the two surveyed poses, which the file's name tells.

    Raises:
        InputError: The name is none of the two, or the file is missing, damaged or misshapen.
    """
    if path.name not in STATIC_POSES:
        raise InputError(path, "name", "is none of the surveyed poses", f"use {', '.join(STATIC_POSES)}")
    yaw, x, y = STATIC_POSES[path.name]
    time_s, table = _table(path, len(LINKS), header=False, gaps=True)
    height = float(site.anchors_m[:, 2].mean())
    position = np.tile([x, y, height], (len(time_s), 1))
    return _run(path, time_s, table, position, np.full(len(time_s), yaw), site)
