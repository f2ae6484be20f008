"""A folder in the WSR layout: every sub-folder with ``npz/`` and ``reference.csv`` is one set."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mulan.errors import InputError
from mulan.wireless.link_bearing import DisplacementSource

_PREFIX = {
    DisplacementSource.MOCAP: "ref_groundtruth",
    DisplacementSource.T265: "ref_t265",
    DisplacementSource.T265_WHEELS: "ref_t265",
}


@dataclass(frozen=True)
class Reported:
    """What another estimator reported for a link.

    Attributes:
        azimuth_deg: Of its top peak.
        variance: Its "profile variance", no angle.
        packets: How many it used.
    """

    azimuth_deg: float
    variance: float
    packets: int


@dataclass(frozen=True)
class Reference:
    """One row of reference.csv.

    Attributes:
        true_azimuth_deg: From the start of the motion to the source.
        reported: By displacement source.
    """

    true_azimuth_deg: float
    reported: Mapping[DisplacementSource, Reported]


@dataclass(frozen=True)
class LinkSet:
    """Recordings made in one place.

    Attributes:
        name: Of the folder.
        runs: The .npz files in order.
        reference: By (run, link).
    """

    name: str
    runs: tuple[Path, ...]
    reference: Mapping[tuple[str, str], Reference]


def link_sets(folder: Path) -> tuple[LinkSet, ...]:
    """The sets of a folder in order of their names.

    Raises:
        InputError: There are none, one has no recordings, or a reference.csv cannot be read.
    """
    found = [
        path.parent for path in sorted(Path(folder).glob("*/reference.csv")) if (path.parent / "npz").is_dir()
    ]
    if not found:
        raise InputError(
            folder,
            "sets",
            "no sub-folder holds npz/ and reference.csv",
            "give the folder above the sets, such as wsr_aoa",
        )
    return tuple(_link_set(path) for path in found)


def _link_set(folder: Path) -> LinkSet:
    runs = tuple(sorted((folder / "npz").glob("*.npz")))
    if not runs:
        raise InputError(folder / "npz", "recordings", "there are none", "put the .npz runs of the set there")
    return LinkSet(folder.name, runs, _reference(folder / "reference.csv"))


def _reference(path: Path) -> dict[tuple[str, str], Reference]:
    rows: dict[tuple[str, str], Reference] = {}
    try:
        with path.open(newline="") as lines:
            for row in csv.DictReader(lines):
                rows[row["run"], row["tx"]] = _row(row)
    except (OSError, UnicodeDecodeError, csv.Error) as fault:
        raise InputError(path, "file", f"cannot be read ({fault})", "restore it from the source") from fault
    except (KeyError, ValueError, TypeError) as fault:
        raise InputError(
            path, f"row {len(rows) + 2}", f"lacks or garbles {fault}", "restore it from the source"
        ) from fault
    return rows


def _row(row: dict[str, str]) -> Reference:
    reported = {}
    for source, prefix in _PREFIX.items():
        # a link the other estimator failed on has an empty cell
        if row[f"{prefix}_azimuth_deg"].strip():
            reported[source] = Reported(
                float(row[f"{prefix}_azimuth_deg"]),
                float(row[f"{prefix}_variance"]),
                int(float(row[f"{prefix}_packets"])),
            )
    return Reference(float(row["true_azimuth_deg"]), reported)
