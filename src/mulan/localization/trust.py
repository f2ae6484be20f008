"""Robots whose measurements contradict the rest of the team are found, named, and set aside."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from mulan.localization.graph import LocalizationConfig, LocalizationGraph, build_graph
from mulan.localization.information import Undetermined
from mulan.localization.initialization import align_team
from mulan.localization.lies import Lie, Suspect
from mulan.localization.likelihood import (
    bearing_log_likelihood,
    motion_log_likelihood,
    range_log_likelihood,
    range_residuals_m,
    wrong_bearing_log_likelihood,
    wrong_range_log_likelihood,
)
from mulan.localization.score_test import misfits
from mulan.localization.solve import Solution, solve_graph
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing, Range

Progress = Callable[[int, int, str], None]

_TURNS_RAD = np.deg2rad(np.arange(-179.0, 181.0))
_MOST_BIASES = 60
_FEWEST = 4  # measurements a robot is judged by
_SUSPICIOUS = 0.45  # part of a robot's measurements to or of one peer that went wrong
_WORTH_A_TRIAL_NATS = 7.0
_MOST_TRIALS = 6
_EXPLAINED = 0.6  # part of a liar's measurements its lie must explain
_WRONG = 0.65  # part of a robot's measurements that went wrong without a common reason
_WRONG_PRIOR = 0.9  # the same, of a broken radio
_AS_GOOD_NATS = 5.0


@dataclass(frozen=True)
class _Accusation:
    """One robot's one lie, and which of the team's measurements it concerns."""

    robot: str
    lie: Lie
    bearings: Bool[NDArray, "m"]
    ranges: Bool[NDArray, "r"]

    @property
    def count(self) -> int:
        return int(self.bearings.sum() + self.ranges.sum())


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


@dataclass(frozen=True)
class _Verdict:
    """The team solved under some accusations.

    Attributes:
        accused: Measurements of these were left out.
        graph: Of the placed robots, with every measurement between them.
        kept: The same without those left out.
        solution: Of ``kept``.
        has_bearing, has_range: Which of the team's measurements are in ``graph``.
        undetermined: Robots not placed.
        bearing_nats, range_nats: Log-likelihood of every measurement of the team, the accused ones under
            their lie.
        motion_nats: The same of odometry and priors.
        amounts: Best turn [rad] or bias [m] of every accusation.
    """

    accused: tuple[_Accusation, ...]
    graph: LocalizationGraph
    kept: LocalizationGraph
    solution: Solution
    has_bearing: Bool[NDArray, "m"]
    has_range: Bool[NDArray, "r"]
    undetermined: tuple[Undetermined, ...]
    bearing_nats: Float[NDArray, "m"]
    range_nats: Float[NDArray, "r"]
    motion_nats: float
    amounts: tuple[float, ...]

    @property
    def nats(self) -> float:
        return float(self.bearing_nats.sum() + self.range_nats.sum()) + self.motion_nats


@dataclass(frozen=True)
class _Court:
    """The evidence, and how it is judged."""

    robots: Sequence[RobotLog]
    bearings: tuple[Bearing, ...]
    ranges: tuple[Range, ...]
    config: LocalizationConfig
    wrong_bearing: Float[NDArray, "m"]
    wrong_range: float
    graphs: dict[tuple[str, ...], LocalizationGraph] = field(default_factory=dict)

    def judge(self, accused: tuple[_Accusation, ...], progress: Progress | None = None) -> _Verdict:
        """Place and solve the team without the measurements of the accused."""
        config = self.config
        out_b = np.zeros(len(self.bearings), dtype=bool)
        out_r = np.zeros(len(self.ranges), dtype=bool)
        for accusation in accused:
            out_b, out_r = out_b | accusation.bearings, out_r | accusation.ranges
        aligned = align_team(
            self.robots,
            [b for b, out in zip(self.bearings, out_b, strict=True) if not out],
            [r for r, out in zip(self.ranges, out_r, strict=True) if not out],
            config.initialization,
            config.gravity_aligned,
            config.common_floor_sigma_m,
        )
        placed = aligned.T_world_odom
        has_b = np.array([b.observer in placed and b.peer in placed for b in self.bearings], dtype=bool)
        has_r = np.array([r.observer in placed and r.peer in placed for r in self.ranges], dtype=bool)
        graph = self._graph(tuple(r.name for r in self.robots if r.name in placed), has_b, has_r)
        kept = replace(
            graph,
            bearings=tuple(n for n, out in zip(graph.bearings, out_b[has_b], strict=True) if not out),
            ranges=tuple(n for n, out in zip(graph.ranges, out_r[has_r], strict=True) if not out),
        )
        solution = solve_graph(kept, kept.initial(placed), progress)
        bearing_nats, range_nats, amounts = self._likelihoods(graph, solution, accused, has_b, has_r)
        motion = motion_log_likelihood(graph, solution.values)
        return _Verdict(
            accused, graph, kept, solution, has_b, has_r, aligned.undetermined,
            bearing_nats, range_nats, motion, amounts,
        )  # fmt: skip

    def _graph(
        self, placed: tuple[str, ...], has_b: Bool[NDArray, "m"], has_r: Bool[NDArray, "r"]
    ) -> LocalizationGraph:
        if placed not in self.graphs:
            self.graphs[placed] = build_graph(
                [robot for robot in self.robots if robot.name in placed],
                [b for b, has in zip(self.bearings, has_b, strict=True) if has],
                [r for r, has in zip(self.ranges, has_r, strict=True) if has],
                self.config,
            )
        return self.graphs[placed]

    def _likelihoods(
        self,
        graph: LocalizationGraph,
        solution: Solution,
        accused: tuple[_Accusation, ...],
        has_b: Bool[NDArray, "m"],
        has_r: Bool[NDArray, "r"],
    ) -> tuple[Float[NDArray, "m"], Float[NDArray, "r"], tuple[float, ...]]:
        """Of every measurement; those of robots not placed count as wrong."""
        bearing_nats, range_nats = self.wrong_bearing.copy(), np.full(len(self.ranges), self.wrong_range)
        values = solution.values
        bearing_nats[has_b] = bearing_log_likelihood(values, graph.bearings, np.zeros(1))[0]
        residual = np.zeros(len(self.ranges))
        residual[has_r] = range_residuals_m(values, graph.ranges)
        range_nats[has_r] = self._range_nats(residual, has_r, np.zeros(1))[0]
        amounts = []
        for accusation in accused:
            mask = accusation.bearings & has_b
            if accusation.lie is Lie.BEARINGS_TURNED:
                amount, bearing_nats[mask] = self._best_turn(graph, solution, mask, has_b)
            else:
                mask = accusation.ranges & has_r
                amount, range_nats[mask] = self._best_bias(residual, mask)
            amounts.append(amount)
        return bearing_nats, range_nats, tuple(amounts)

    def _range_nats(
        self, residual_m: Float[NDArray, "r"], mask: Bool[NDArray, "r"], bias_m: Float[NDArray, "g"]
    ) -> Float[NDArray, "g q"]:
        sigma = np.array([r.sigma_m for r, on in zip(self.ranges, mask, strict=True) if on], dtype=float)
        return range_log_likelihood(residual_m[mask], sigma, self.config.range_outlier_mass, bias_m)

    def _best_turn(
        self,
        graph: LocalizationGraph,
        solution: Solution,
        mask: Bool[NDArray, "m"],
        has_b: Bool[NDArray, "m"],
    ) -> tuple[float, Float[NDArray, "q"]]:
        """The turn that explains the masked bearings best, to a tenth of a degree, and their likelihoods."""
        nodes = [node for node, on in zip(graph.bearings, mask[has_b], strict=True) if on]
        coarse = bearing_log_likelihood(solution.values, nodes, _TURNS_RAD)
        near = _TURNS_RAD[int(coarse.sum(1).argmax())] + np.deg2rad(np.arange(-10, 11) / 10)
        fine = bearing_log_likelihood(solution.values, nodes, near)
        best = int(fine.sum(1).argmax())
        return float(near[best]), fine[best]

    def _best_bias(
        self, residual_m: Float[NDArray, "r"], mask: Bool[NDArray, "r"]
    ) -> tuple[float, Float[NDArray, "q"]]:
        """The bias that explains the masked ranges best, and their likelihoods."""
        if not mask.any():
            return 0.0, np.zeros(0)
        biases = np.unique(residual_m[mask])
        biases = biases[np.linspace(0, len(biases) - 1, min(len(biases), _MOST_BIASES)).astype(int)]
        nats = self._range_nats(residual_m, mask, biases)
        best = int(nats.sum(1).argmax())
        return float(biases[best]), nats[best]

    def accusations(self) -> Iterator[_Accusation]:
        """Every lie that could be told: about own bearings, ranges reported, and ranges taken part in."""
        none_b, none_r = np.zeros(len(self.bearings), dtype=bool), np.zeros(len(self.ranges), dtype=bool)
        for robot in self.robots:
            name = robot.name
            own = np.array([b.observer == name for b in self.bearings], dtype=bool)
            reported = np.array([r.observer == name for r in self.ranges], dtype=bool)
            shared = np.array([name in (r.observer, r.peer) for r in self.ranges], dtype=bool)
            if own.sum() >= _FEWEST:
                yield _Accusation(name, Lie.BEARINGS_TURNED, own, none_r)
            if shared.sum() >= _FEWEST:
                yield _Accusation(name, Lie.RANGES_BIASED, none_b, shared)
            if _FEWEST <= reported.sum() < shared.sum():
                yield _Accusation(name, Lie.RANGES_BIASED, none_b, reported)

    def wrongness(self, verdict: _Verdict) -> tuple[Float[NDArray, "m"], Float[NDArray, "r"]]:
        """Probability that each measurement is an outlier in a verdict."""
        bearing = np.exp(np.minimum(self.wrong_bearing - verdict.bearing_nats, 0.0))
        return bearing, np.exp(np.minimum(self.wrong_range - verdict.range_nats, 0.0))

    def worth_a_trial(self, verdict: _Verdict) -> list[_Accusation]:
        """Accusations that could explain what went wrong, the likeliest first.

        Those that would explain a robot's outliers as things stand, those that would explain residuals if the
        poses gave way (a lie too small to make outliers bends the solution instead), and those of robots most
        of whose measurements with some peer went wrong, whose lie may have been believed.
        """
        wrong_b, wrong_r = self.wrongness(verdict)
        already = {(a.robot, a.lie) for a in verdict.accused}
        possible = [a for a in self.accusations() if (a.robot, a.lie) not in already]
        scored = self._scores(verdict, possible)
        ranked = []
        for accusation, score in zip(possible, scored, strict=True):
            nats = max(self._gain_as_things_stand(verdict, accusation), score)
            blame, worst = self._blame(accusation.robot, wrong_b, wrong_r)
            if nats > _WORTH_A_TRIAL_NATS or worst > _SUSPICIOUS:
                ranked.append((-nats - 20.0 * blame, len(ranked), accusation))
        return [accusation for _, _, accusation in sorted(ranked)[:_MOST_TRIALS]]

    def _scores(self, verdict: _Verdict, possible: Sequence[_Accusation]) -> list[float]:
        """Nats every accusation would gain to first order; zero for lies too small to be called so."""
        out_b = np.zeros(len(self.bearings), dtype=bool)
        out_r = np.zeros(len(self.ranges), dtype=bool)
        for a in verdict.accused:
            out_b, out_r = out_b | a.bearings, out_r | a.ranges
        in_b, in_r = verdict.has_bearing & ~out_b, verdict.has_range & ~out_r
        found = misfits(
            verdict.kept,
            verdict.solution,
            [a.bearings[in_b] for a in possible],
            [a.ranges[in_r] for a in possible],
        )
        trust = self.config.trust
        smallest = {
            Lie.BEARINGS_TURNED: np.deg2rad(trust.smallest_turn_deg),
            Lie.RANGES_BIASED: trust.smallest_bias_m,
        }
        return [
            misfit.nats if misfit is not None and abs(misfit.amount) > smallest[a.lie] / 2 else 0.0
            for a, misfit in zip(possible, found, strict=True)
        ]

    def _gain_as_things_stand(self, verdict: _Verdict, accusation: _Accusation) -> float:
        """How much likelier an accusation makes the measurements without solving again."""
        bearing, ranged, _ = self._likelihoods(
            verdict.graph,
            verdict.solution,
            (*verdict.accused, accusation),
            verdict.has_bearing,
            verdict.has_range,
        )
        return float(bearing.sum() + ranged.sum() - verdict.bearing_nats.sum() - verdict.range_nats.sum())

    def _blame(
        self, name: str, wrong_b: Float[NDArray, "m"], wrong_r: Float[NDArray, "r"]
    ) -> tuple[float, float]:
        """Part of a robot's measurements that went wrong, and the largest part with any one peer."""
        groups: dict[tuple[str, str, str], list[float]] = {}
        for b, wrong in zip(self.bearings, wrong_b, strict=True):
            if name in (b.observer, b.peer):
                groups.setdefault(("bearing", b.observer, b.peer), []).append(float(wrong))
        for r, wrong in zip(self.ranges, wrong_r, strict=True):
            if name in (r.observer, r.peer):
                groups.setdefault(("range", *sorted((r.observer, r.peer))), []).append(float(wrong))  # type: ignore[arg-type]
        parts = [float(np.mean(group)) for group in groups.values() if len(group) >= _FEWEST]
        return (float(np.mean(parts)), max(parts)) if parts else (0.0, 0.0)

    def is_plausible(self, verdict: _Verdict) -> bool:
        """Whether the last accusation is large enough and explains most of what it concerns."""
        accusation, amount = verdict.accused[-1], verdict.amounts[-1]
        trust = self.config.trust
        wrong_b, wrong_r = self.wrongness(verdict)
        if accusation.lie is Lie.BEARINGS_TURNED:
            explained = 1 - wrong_b[accusation.bearings & verdict.has_bearing]
            is_large = abs(amount) >= float(np.deg2rad(trust.smallest_turn_deg))
        else:
            explained = 1 - wrong_r[accusation.ranges & verdict.has_range]
            is_large = abs(amount) >= trust.smallest_bias_m
        return bool(is_large and len(explained) > 0 and float(explained.mean()) > _EXPLAINED)


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
    court = _Court(
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


def _trials(court: _Court, verdict: _Verdict) -> list[_Verdict]:
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


def _broken_radios(court: _Court, verdict: _Verdict) -> list[Suspect]:
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
        if (a.robot, lie) in accused or len(parts) < _FEWEST or parts.mean() < _WRONG:
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


def _trusted(court: _Court, verdict: _Verdict, suspects: Sequence[Suspect]) -> TrustedSolution:
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
