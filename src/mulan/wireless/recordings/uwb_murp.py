"""MURP: ranges between three agents of six antennas, with motion capture (Fishberg, Quiter, How, RA-L 2024).

One csv(.gz) a trial and pair, ``<trial>_base-<A>_targ-<B>_win-1_step-1.csv.gz``: 1 s moving averages at 1 Hz.
"""

import re
from pathlib import Path

import numpy as np

from mulan.errors import InputError
from mulan.wireless.recordings.uwb_samples import RangeSamples, check_ranges, finite_numbers, read_lines

ANTENNAS = 6
_NAME = re.compile(r"(?P<trial>\w+)_base-(?P<base>\d+)_targ-(?P<target>\d+)_win-1_step-1\.csv(\.gz)?")
_CONSISTENT_M = 1e-6


def trial_of(path: Path) -> tuple[str, int, int]:
    """Trial, base agent and target agent from the file's name.

    Raises:
        InputError: The name has another form.
    """
    match = _NAME.fullmatch(path.name)
    if match is None:
        raise InputError(
            path, "name", "is not <trial>_base-<A>_targ-<B>_win-1_step-1.csv.gz", "keep the data set's names"
        )
    return match["trial"], int(match["base"]), int(match["target"])


def read_murp_pair(path: Path) -> RangeSamples:
    """All 36 antenna pairs of one trial and pair of agents; the reported sigma is that of the 1 s window.

    Raises:
        InputError: The file is missing, damaged, lacks a column, holds a number that is not finite, a range
            below zero, time that goes backwards, or an error column that is not measured minus true.
    """
    trial, base, target = trial_of(path)
    lines = read_lines(path)
    header = lines[0].split(",") if lines else []
    column = {name: i for i, name in enumerate(header)}
    pairs = [(i, j) for i in range(1, ANTENNAS + 1) for j in range(1, ANTENNAS + 1)]
    for name in ("t", *(f"{i}_{j}{suffix}" for i, j in pairs for suffix in ("", "_std", "_t", "_err"))):
        if name not in column:
            raise InputError(path, f"column {name}", "is missing", "give the data set's parsed csv files")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        words = line.split(",")
        if len(words) != len(header):
            raise InputError(
                path, f"line {number}", f"has {len(words)} of {len(header)} columns", "fetch it again"
            )
        rows.append(finite_numbers(path, number, words))
    if not rows:
        raise InputError(path, "rows", "there are none", "fetch it again")
    table = np.array(rows)
    range_m, sigma_m, true_m, error_m = (
        table[:, [column[f"{i}_{j}{suffix}"] for i, j in pairs]] for suffix in ("", "_std", "_t", "_err")
    )
    check_ranges(path, range_m)
    check_ranges(path, true_m)
    if (sigma_m < 0).any():
        raise InputError(path, "columns *_std", "are negative", "fetch it again")
    if np.abs(range_m - true_m - error_m).max() > _CONSISTENT_M:
        raise InputError(path, "columns *_err", "are not measured minus true", "fetch it again")
    time_s = table[:, column["t"]]
    if (np.diff(time_s) <= 0).any():
        raise InputError(path, "column t", "does not increase", "sort the rows by time")
    count = len(time_s)
    return RangeSamples(
        f"{trial} {base}-{target}",
        tuple((f"{base}.{i}", f"{target}.{j}") for i, j in pairs),
        np.tile(np.arange(len(pairs)), count),
        np.repeat(time_s, len(pairs)),
        range_m.ravel(),
        true_m.ravel(),
        sigma_m.ravel(),
    )


def murp_files(folder: Path) -> dict[str, list[Path]]:
    """Files by trial.

    Raises:
        InputError: There are none.
    """
    files: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("*_base-*_targ-*_win-1_step-1.csv*")):
        files.setdefault(trial_of(path)[0], []).append(path)
    if not files:
        raise InputError(folder, "trials", "there are none", "give the folder of MURP's parsed csv files")
    return files
