"""One link measured and compared with the truth."""

import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from mulan.evaluation.aoa.folder import Reported
from mulan.evaluation.aoa.truth import TrueAzimuth, true_azimuth
from mulan.wireless.azimuth_density import azimuth_mixture, wrapped
from mulan.wireless.bearing import BearingConfig
from mulan.wireless.link_bearing import DisplacementSource, link_bearing
from mulan.wireless.recordings.wsr import WsrLink, WsrRun
from mulan.wireless.types import Bearing


@dataclass(frozen=True)
class ScoredLink:
    """A bearing beside the truth and beside what others reported; a row of links.csv.

    Errors are signed, estimate minus truth, of the first hypothesis; degrees because people read the rows.

    Attributes:
        set, run, link, source: Which one.
        azimuth_deg, true_azimuth_deg: Ours, and the truth "origin" of ``truth.DEFINITIONS``.
        error_deg, error_start_deg, error_own_axes_deg: Against each of the three truths.
        best_of_three_deg: Smallest absolute error among the first three hypotheses (truth "origin").
        sigma_deg: Root mean square of the whole mixture about the first hypothesis.
        mean_abs_deg: Its mean absolute deviation.
        first_sigma_deg, first_weight, outlier_mass, hypotheses: The first hypothesis and the rest.
        level: Smallest highest-density region that contains the truth, 0..1.
        nll: Negative log-likelihood of the truth [nats, density per radian].
        kappa_paper: The paper's uncertainty.
        faults: How many findings about the packets were told (phase jumps, antennas without a channel).
        packets, milliseconds: Used and taken, from decoded CSI to the bearing.
        reported_error_deg, reported_error_origin_deg: Of the others' azimuth against the truths "start"
            (their own definition) and "origin"; None where they report nothing.
        reported_variance: Their uncertainty.
        reported_packets: How many they used.
    """

    set: str
    run: str
    link: str
    source: str
    azimuth_deg: float
    true_azimuth_deg: float
    error_deg: float
    error_start_deg: float
    error_own_axes_deg: float
    best_of_three_deg: float
    sigma_deg: float
    mean_abs_deg: float
    first_sigma_deg: float
    first_weight: float
    outlier_mass: float
    hypotheses: int
    level: float
    nll: float
    kappa_paper: float
    faults: int
    packets: int
    milliseconds: float
    reported_error_deg: float | None
    reported_error_origin_deg: float | None
    reported_variance: float | None
    reported_packets: int | None

    def row(self) -> dict[str, Any]:
        """Columns of links.csv."""
        return asdict(self)


@dataclass(frozen=True)
class MeasuredLink:
    """A scored link with the bearing itself (its profile left out) and its truths."""

    scored: ScoredLink
    bearing: Bearing
    truth: TrueAzimuth


@dataclass(frozen=True)
class FailedLink:
    """A link (or a whole file, if ``link`` is empty) without a bearing, and why."""

    set: str
    run: str
    link: str
    source: str
    reason: str


def _off_deg(azimuth_rad: float, truth_rad: float) -> float:
    return float(np.degrees(wrapped(np.array(azimuth_rad - truth_rad))))


def timed_bearing(
    run: WsrRun, link: WsrLink, source: DisplacementSource, config: BearingConfig
) -> tuple[Bearing | None, float]:
    """The bearing and the milliseconds from decoded CSI to it."""
    began = time.perf_counter()
    bearing = link_bearing(run, link, source, config)
    return bearing, 1e3 * (time.perf_counter() - began)


def measured_link(
    set_name: str,
    run: WsrRun,
    link: WsrLink,
    source: DisplacementSource,
    bearing: Bearing,
    milliseconds: float,
    reported: Reported | None,
) -> MeasuredLink:
    """Compare one bearing with the truth."""
    origin = bearing.origin_odom_m if bearing.origin_odom_m is not None else bearing.T_odom_body[:3, 3]
    truth: TrueAzimuth = true_azimuth(run, link, source, origin)
    mixture = azimuth_mixture(bearing)
    azimuth = float(mixture.mean_rad[0])
    at_truth = np.array([truth.origin_rad])
    theirs = np.radians(reported.azimuth_deg) if reported else None
    scored = ScoredLink(
        set=set_name,
        run=run.name,
        link=link.name,
        source=source.value,
        azimuth_deg=float(np.degrees(azimuth)),
        true_azimuth_deg=float(np.degrees(truth.origin_rad)),
        error_deg=_off_deg(azimuth, truth.origin_rad),
        error_start_deg=_off_deg(azimuth, truth.start_rad),
        error_own_axes_deg=_off_deg(azimuth, truth.own_axes_rad),
        best_of_three_deg=min(abs(_off_deg(float(a), truth.origin_rad)) for a in mixture.mean_rad[:3]),
        sigma_deg=float(np.degrees(mixture.sigma_azimuth_rad)),
        mean_abs_deg=float(np.degrees(mixture.mean_abs_azimuth_rad)),
        first_sigma_deg=float(np.degrees(mixture.sigma_rad[0])),
        first_weight=float(mixture.weight[0]),
        outlier_mass=mixture.outlier_mass,
        hypotheses=len(mixture.weight),
        level=float(mixture.level_of(at_truth)[0]),
        nll=float(-mixture.log_density(at_truth)[0]),
        kappa_paper=bearing.kappa_paper,
        faults=len(bearing.faults),
        packets=bearing.packets,
        milliseconds=milliseconds,
        reported_error_deg=None if theirs is None else _off_deg(theirs, truth.start_rad),
        reported_error_origin_deg=None if theirs is None else _off_deg(theirs, truth.origin_rad),
        reported_variance=reported.variance if reported else None,
        reported_packets=reported.packets if reported else None,
    )
    return MeasuredLink(scored, replace(bearing, profile=None), truth)
