"""Robots whose measurements contradict the rest of the team are found, named, and set aside."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool
from numpy.typing import NDArray

from mulan.localization.court import FEWEST, Court, Progress, Verdict
from mulan.localization.graph import LocalizationConfig, LocalizationGraph
from mulan.localization.information import Undetermined
from mulan.localization.lies import Lie, Suspect
from mulan.localization.likelihood import wrong_bearing_log_likelihood, wrong_range_log_likelihood
from mulan.localization.solve import Solution
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing, Range

_WRONG = 0.65  # part of a robot's measurements that went wrong without a common reason
_WRONG_PRIOR = 0.9  # the same, of a broken radio
_AS_GOOD_NATS = 5.0


@dataclass(frozen=True)
class TrustedSolution:
    """The team solved without its liars.

    Attributes:
        graph: Without the measurements set aside, and only of robots that could be placed.
        solution: Of that graph.
        bearings, ranges: All between placed robots, those set aside included.
        is_kept: Which of the bearings are in the graph.
        suspects: Liars, the surest first.
        undetermined: Robots that could not be placed.
    """

    graph: LocalizationGraph
    solution: Solution
    bearings: tuple[Bearing, ...]
    is_kept: Bool[NDArray, "m"]
    ranges: tuple[Range, ...]
    suspects: tuple[Suspect, ...]
    undetermined: tuple[Undetermined, ...]


def solve_trusting(
    robots: Sequence[RobotLog],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    config: LocalizationConfig,
    progress: Progress | None = None,
) -> TrustedSolution:
    """Place and solve a team; measurements of a robot that lies are left out and the robot is named.

    Every lie that could explain what went wrong is tried: the team is placed and solved again without the
    measurements it concerns, and these are then scored as turned or biased by the best common amount. The lie
    under which all measurements and the odometry are likeliest by a wide margin is believed, and the search
    goes on with the next, as long as fewer than half of the robots lie.

    Which lies can be told: a bearing turn shows only against a heading known from elsewhere (bearings to the
    robot, or ranges, while it moves); with two robots a bias of their ranges may be either's, and both are
    named.

    Raises:
        InputError: A photograph lies outside its robot's odometry.
    """
    court = Court(
        robots, tuple(bearings), tuple(ranges), config,
        wrong_bearing_log_likelihood(bearings), wrong_range_log_likelihood(config.range_outlier_mass),
    )  # fmt: skip
    verdict = court.judge((), progress)
    suspects: list[Suspect] = []
    allowed = max(1, (len(robots) - 1) // 2) if config.trust.check and len(robots) > 1 else 0
    while len(suspects) < allowed:
        trials = _trials(court, verdict)
        best = max(trials, key=lambda t: t.nats, default=None)
        if best is None or best.nats < verdict.nats + config.trust.least_evidence_nats:
            break
        accusation = best.accused[-1]
        others = {t.accused[-1].robot for t in trials if t.nats > best.nats - _AS_GOOD_NATS}
        suspects.append(
            Suspect(
                accusation.robot,
                accusation.lie,
                best.nats - verdict.nats,
                best.amounts[-1],
                accusation.count,
                tuple(sorted(others - {accusation.robot})),
            )
        )
        verdict = best
    if config.trust.check:
        suspects += _broken_radios(court, verdict)
    return _trusted(court, verdict, suspects)


def _trials(court: Court, verdict: Verdict) -> list[Verdict]:
    """The plausible ones, up to the first that leaves nothing to explain (two robots may explain alike)."""
    trials = []
    for accusation in court.worth_a_trial(verdict):
        trial = court.judge((*verdict.accused, accusation))
        if not court.is_plausible(trial):
            continue
        trials.append(trial)
        is_clear = trial.nats > verdict.nats + court.config.trust.least_evidence_nats
        if len(court.robots) > 2 and is_clear and not court.worth_a_trial(trial):
            break
    return trials


def _broken_radios(court: Court, verdict: Verdict) -> list[Suspect]:
    """Robots most of whose own measurements went wrong with no common turn or bias."""
    wrong = dict(zip(Lie, [court.wrongness(verdict)[0]] * 2 + [court.wrongness(verdict)[1]] * 2, strict=True))
    has = dict(zip(Lie, [verdict.has_bearing] * 2 + [verdict.has_range] * 2, strict=True))
    accused = {(a.robot, lie) for a in verdict.accused for lie in _KIN[a.lie]}
    found: dict[tuple[str, Lie], Suspect] = {}
    for a in court.accusations():
        lie = _KIN[a.lie][1]
        mask = (a.bearings if a.lie is Lie.BEARINGS_TURNED else a.ranges) & has[lie]
        parts = wrong[lie][mask]
        mass = 0.05 if lie is Lie.BEARINGS_WRONG else court.config.range_outlier_mass
        if lie is Lie.BEARINGS_WRONG:
            masses = [b.outlier_mass for b, on in zip(court.bearings, mask, strict=True) if on]
            mass = float(np.mean(masses)) if masses else mass
        mass = float(np.clip(mass, 0.01, 0.8))
        if (a.robot, lie) in accused or len(parts) < FEWEST or parts.mean() < _WRONG:
            continue
        nats = float(
            parts.sum() * np.log(_WRONG_PRIOR / mass)
            + (1 - parts).sum() * np.log((1 - _WRONG_PRIOR) / (1 - mass))
        )
        known = found.get((a.robot, lie))
        if nats > court.config.trust.least_evidence_nats and (known is None or nats > known.evidence_nats):
            found[a.robot, lie] = Suspect(a.robot, lie, nats, None, int((parts > 0.5).sum()))
    return sorted(found.values(), key=lambda s: -s.evidence_nats)


_KIN = {
    Lie.BEARINGS_TURNED: (Lie.BEARINGS_TURNED, Lie.BEARINGS_WRONG),
    Lie.RANGES_BIASED: (Lie.RANGES_BIASED, Lie.RANGES_WRONG),
}


def _trusted(court: Court, verdict: Verdict, suspects: Sequence[Suspect]) -> TrustedSolution:
    aside = np.zeros(len(court.bearings), dtype=bool)
    for accusation in verdict.accused:
        aside |= accusation.bearings
    has = verdict.has_bearing
    return TrustedSolution(
        graph=verdict.kept,
        solution=verdict.solution,
        bearings=tuple(b for b, on in zip(court.bearings, has, strict=True) if on),
        is_kept=~aside[has],
        ranges=tuple(r for r, on in zip(court.ranges, verdict.has_range, strict=True) if on),
        suspects=tuple(suspects),
        undetermined=verdict.undetermined,
    )
