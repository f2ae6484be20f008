"""Errors and sigmas of bearings of real links, for simulated robots to make."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import root_scalar
from scipy.special import ndtr

from mulan.errors import InputError
from mulan.evaluation.aoa.folder import link_sets
from mulan.evaluation.aoa.protocol import AoaProtocolConfig, measure_links
from mulan.evaluation.aoa.scored_link import MeasuredLink
from mulan.evaluation.table1.sources import Progress
from mulan.mission.run_folder import read_json, write_json
from mulan.wireless.azimuth_density import AzimuthMixture, azimuth_mixture, wrapped
from mulan.wireless.link_bearing import DisplacementSource

ONE_SIGMA = 0.6827
"""Probability within one standard deviation of a normal distribution."""


@dataclass(frozen=True)
class RecordedBearing:
    """What one recorded link's bearing was worth.

    Attributes:
        name: Set, run and link.
        error_rad: Of the likeliest hypothesis, estimate minus truth, in the odometry's own axes.
        sigma_rad: Half the width of the interval about it that holds 68.3 % of the whole mixture.
            Its standard deviation would be that of the outlier mass, tens of degrees for every link.
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
    made_from = {"files": files, "bearings": repr(config.bearings), "sigma": f"holds {ONE_SIGMA}"}
    if kept.exists():
        record = read_json(kept, "mulan evaluate table1")
        if record.get("made_from") == made_from:
            return [RecordedBearing(**row) for row in record["links"]]
    measured, _ = measure_links(sets, config, progress)
    if not measured:
        raise InputError(folder, "links", "none has a bearing", "name the folder of the recordings")
    links = [recorded(one) for one in measured]
    record: dict[str, Any] = {"made_from": made_from, "links": [vars(link) for link in links]}
    write_json(kept, record)
    return links


def recorded(link: MeasuredLink) -> RecordedBearing:
    """The figures of one measured link."""
    scored = link.scored
    return RecordedBearing(
        f"{scored.set} {scored.run} {scored.link}",
        float(np.radians(scored.error_own_axes_deg)),
        core_sigma_rad(azimuth_mixture(link.bearing)),
    )


def core_sigma_rad(mixture: AzimuthMixture) -> float:
    """Half the width of the interval about the likeliest azimuth that holds 68.3 %, at most π."""
    off = wrapped(mixture.mean_rad - mixture.mean_rad[0])

    def excess(half_rad: float) -> float:
        inside = ndtr((half_rad - off) / mixture.sigma_rad) - ndtr((-half_rad - off) / mixture.sigma_rad)
        return float(mixture.weight @ inside) + mixture.outlier_mass * half_rad / np.pi - ONE_SIGMA

    return float(root_scalar(excess, bracket=(0.0, np.pi)).root) if excess(np.pi) > 0 else float(np.pi)


def draw(links: Sequence[RecordedBearing], n: int, rng: np.random.Generator) -> list[RecordedBearing]:
    """Bearings of links drawn by lot, each at most once as long as there are enough."""
    order = np.concatenate([rng.permutation(len(links)) for _ in range(-(-n // len(links)))])
    return [links[i] for i in order[:n]]
