"""Errors and sigmas of bearings of real links, for simulated robots to make."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mulan.errors import InputError
from mulan.evaluation.aoa.folder import link_sets
from mulan.evaluation.aoa.protocol import AoaProtocolConfig, measure_links
from mulan.evaluation.aoa.scored_link import ScoredLink
from mulan.evaluation.table1.sources import Progress
from mulan.mission.run_folder import read_json, write_json
from mulan.wireless.link_bearing import DisplacementSource


@dataclass(frozen=True)
class RecordedBearing:
    """What one recorded link's bearing was worth.

    Attributes:
        name: Set, run and link.
        error_rad: Of the likeliest hypothesis, estimate minus truth, in the odometry's own axes.
        sigma_rad: Root mean square of the whole mixture, its outlier mass included, about that hypothesis.
    """

    name: str
    error_rad: float
    sigma_rad: float


def recorded_bearings(folder: Path, kept: Path, workers: int, progress: Progress) -> list[RecordedBearing]:
    """Bearings of every link of a folder in the WSR layout, by the VIO displacement a robot has.

    Args:
        folder: The sets.
        kept: File the result is kept in; read instead if it was made from the same folder and options.
        workers: Processes.
        progress: Called with files done and in all.

    Raises:
        InputError: There are no sets, or no link has a bearing.
    """
    config = AoaProtocolConfig(sources=(DisplacementSource.T265,), workers=workers)
    sets = link_sets(folder)
    files = sorted(f"{path.relative_to(folder)} {path.stat().st_size}" for s in sets for path in s.runs)
    made_from = {"files": files, "bearings": repr(config.bearings)}
    if kept.exists():
        record = read_json(kept, "mulan evaluate table1")
        if record.get("made_from") == made_from:
            return [RecordedBearing(**row) for row in record["links"]]
    measured, _ = measure_links(sets, config, progress)
    if not measured:
        raise InputError(folder, "links", "none has a bearing", "name the folder of the recordings")
    links = [recorded(one.scored) for one in measured]
    record: dict[str, Any] = {"made_from": made_from, "links": [vars(link) for link in links]}
    write_json(kept, record)
    return links


def recorded(link: ScoredLink) -> RecordedBearing:
    """The figures of one scored link."""
    return RecordedBearing(
        f"{link.set} {link.run} {link.link}",
        float(np.radians(link.error_own_axes_deg)),
        float(np.radians(link.sigma_deg)),
    )


def draw(links: Sequence[RecordedBearing], n: int, rng: np.random.Generator) -> list[RecordedBearing]:
    """Bearings of links drawn by lot, each at most once as long as there are enough."""
    order = np.concatenate([rng.permutation(len(links)) for _ in range(-(-n // len(links)))])
    return [links[i] for i in order[:n]]
