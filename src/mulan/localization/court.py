"""One trial of a team: placed and solved under accusations, and how likely that makes what was measured."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from mulan.localization.graph import LocalizationConfig, LocalizationGraph, build_graph
from mulan.localization.information import Undetermined
from mulan.localization.initialization import align_team
from mulan.localization.lies import Lie
from mulan.localization.likelihood import (
    bearing_log_likelihood,
    motion_log_likelihood,
    range_log_likelihood,
    range_residuals_m,
)
from mulan.localization.score_test import misfits
from mulan.localization.solve import Solution, solve_graph
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing, Range

Progress = Callable[[int, int, str], None]

FEWEST = 4
"""Measurements a robot is judged by."""
_TURNS_RAD = np.deg2rad(np.arange(-179.0, 181.0))
_MOST_BIASES = 60
_SUSPICIOUS = 0.45  # part of a robot's measurements to or of one peer that went wrong
_WORTH_A_TRIAL_NATS = 7.0
_MOST_TRIALS = 6
_EXPLAINED = 0.6  # part of a liar's measurements its lie must explain


@dataclass(frozen=True)
class Accusation:
    """One robot's one lie, and which of the team's measurements it concerns."""

    robot: str
    lie: Lie
    bearings: Bool[NDArray, "m"]
    ranges: Bool[NDArray, "r"]

    @property
    def count(self) -> int:
        """How many."""
        return int(self.bearings.sum() + self.ranges.sum())


@dataclass(frozen=True)
class Verdict:
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

    accused: tuple[Accusation, ...]
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
        """Log-likelihood of all that was measured, with odometry and priors."""
        return float(self.bearing_nats.sum() + self.range_nats.sum()) + self.motion_nats


@dataclass(frozen=True)
class Court:
    """The evidence, and how it is judged.

    Attributes:
        robots, bearings, ranges, config: What the team recorded, and the options.
        wrong_bearing, wrong_range: Log-likelihood of each bearing, and of any range, as an outlier.
        graphs: Those built already, by the names of the placed robots.
    """

    robots: Sequence[RobotLog]
    bearings: tuple[Bearing, ...]
    ranges: tuple[Range, ...]
    config: LocalizationConfig
    wrong_bearing: Float[NDArray, "m"]
    wrong_range: float
    graphs: dict[tuple[str, ...], LocalizationGraph] = field(default_factory=dict)

    def judge(self, accused: tuple[Accusation, ...], progress: Progress | None = None) -> Verdict:
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
        return Verdict(
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
        accused: tuple[Accusation, ...],
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

    def accusations(self) -> Iterator[Accusation]:
        """Every lie that could be told: about own bearings, ranges reported, and ranges taken part in."""
        none_b, none_r = np.zeros(len(self.bearings), dtype=bool), np.zeros(len(self.ranges), dtype=bool)
        for robot in self.robots:
            name = robot.name
            own = np.array([b.observer == name for b in self.bearings], dtype=bool)
            reported = np.array([r.observer == name for r in self.ranges], dtype=bool)
            shared = np.array([name in (r.observer, r.peer) for r in self.ranges], dtype=bool)
            if own.sum() >= FEWEST:
                yield Accusation(name, Lie.BEARINGS_TURNED, own, none_r)
            if shared.sum() >= FEWEST:
                yield Accusation(name, Lie.RANGES_BIASED, none_b, shared)
            if FEWEST <= reported.sum() < shared.sum():
                yield Accusation(name, Lie.RANGES_BIASED, none_b, reported)

    def wrongness(self, verdict: Verdict) -> tuple[Float[NDArray, "m"], Float[NDArray, "r"]]:
        """Probability that each measurement is an outlier in a verdict."""
        bearing = np.exp(np.minimum(self.wrong_bearing - verdict.bearing_nats, 0.0))
        return bearing, np.exp(np.minimum(self.wrong_range - verdict.range_nats, 0.0))

    def worth_a_trial(self, verdict: Verdict) -> list[Accusation]:
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

    def _scores(self, verdict: Verdict, possible: Sequence[Accusation]) -> list[float]:
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

    def _gain_as_things_stand(self, verdict: Verdict, accusation: Accusation) -> float:
        """How much likelier an accusation makes the measurements it concerns, without solving again."""
        if accusation.lie is Lie.BEARINGS_TURNED:
            mask = accusation.bearings & verdict.has_bearing
            _, nats = self._best_turn(verdict.graph, verdict.solution, mask, verdict.has_bearing)
            return float(nats.sum() - verdict.bearing_nats[mask].sum())
        mask = accusation.ranges & verdict.has_range
        concerned = [
            node for node, on in zip(verdict.graph.ranges, mask[verdict.has_range], strict=True) if on
        ]
        residual = np.zeros(len(self.ranges))
        residual[mask] = range_residuals_m(verdict.solution.values, concerned)
        _, nats = self._best_bias(residual, mask)
        return float(nats.sum() - verdict.range_nats[mask].sum())

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
                first, second = sorted((r.observer, r.peer))
                groups.setdefault(("range", first, second), []).append(float(wrong))
        parts = [float(np.mean(group)) for group in groups.values() if len(group) >= FEWEST]
        return (float(np.mean(parts)), max(parts)) if parts else (0.0, 0.0)

    def is_plausible(self, verdict: Verdict) -> bool:
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
