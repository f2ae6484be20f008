"""The last minute of a team's graph: solved anew at every update, what leaves it kept as a prior."""

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.belief import belief
from mulan.localization.graph import RangeNode
from mulan.localization.least_squares import Problem, minimise
from mulan.localization.measurement_terms import huber, quadratic
from mulan.localization.relative_prior import relative_prior
from mulan.localization.window_measurements import OnlineMeasurement, window_terms

_LEAST_TRUST = 0.02  # below it a measurement is left out
_JOINING_INFLATION = (3.0, 1.0, 1.0)  # wide at first: a poor start rejects nothing for good
_SETTLED_STEP = 5e-3  # radians, metres: a smaller Gauss-Newton step needs no further one
_MOST_STEPS = 4


class SlidingWindow:
    """Recent keyframes, the measurements on them, and what the past says about them.

    Attributes:
        values: Poses of the keyframes in the window and all range biases.
    """

    def __init__(self, range_outlier_mass: float) -> None:
        self.values = gtsam.Values()
        self._mass = range_outlier_mass
        self._order: dict[int, float] = {}
        self._motion: dict[int, list[gtsam.NonlinearFactor]] = {}
        self._prior: list[gtsam.NonlinearFactor] = []
        self._biases: list[int] = []
        self._measurements: list[OnlineMeasurement] = []

    def __len__(self) -> int:
        return len(self._order)

    def __contains__(self, key: int) -> bool:
        return key in self._order

    @property
    def measurements(self) -> Sequence[OnlineMeasurement]:
        """In the window."""
        return self._measurements

    def add_keyframe(
        self, key: int, order: float, pose: gtsam.Pose3, factors: list[gtsam.NonlinearFactor]
    ) -> None:
        """A keyframe with the factors that tie it to the one before and to gravity.

        Args:
            key: Of the pose.
            order: Keyframes of all robots are eliminated by this: about when they arrived.
            pose: First guess.
            factors: Over this keyframe and earlier ones.
        """
        self.values.insert(key, pose)
        self._order[key] = order
        self._motion[key] = factors

    def add_bias(self, key: int, prior: gtsam.NonlinearFactor) -> None:
        """A constant that stays in the window for good."""
        self.values.insert(key, np.zeros(1))
        self._biases.append(key)
        self._prior.append(prior)

    def add(self, measurement: OnlineMeasurement) -> None:
        """A measurement between keyframes of the window."""
        self._measurements.append(measurement)

    def settle(self, newest: Sequence[int], joined: bool) -> Float[NDArray, "n n"]:
        """Improve all poses of the window and judge its measurements; joint covariance of some poses.

        Args:
            newest: Keys of those poses.
            joined: A robot has just been placed: start carefully, as the batch solution does.
        """
        motion = self._motion_graph(self._order)
        if joined:
            for inflation in _JOINING_INFLATION:
                first = inflation == _JOINING_INFLATION[0]
                problem = self._problem(self._measurements, motion, True, inflation, first)
                self.values = minimise(problem, self.values)
        problem = self._problem(self._measurements, motion, True)
        ordering = self._ordering(newest)
        net = None
        for _ in range(_MOST_STEPS):
            net = problem.linear(self.values)[0].eliminateSequential(ordering)
            step = net.optimize()
            self.values = self.values.retract(step)
            if max((np.abs(step.at(key)).max() for key in newest), default=0.0) < _SETTLED_STEP:
                break
        for m in self._measurements:
            m.spread = None
        assert net is not None
        return _joint_covariance(net, newest)

    def forget(self, keys: Iterable[int]) -> None:
        """Replace keyframes and all that hangs on them by a prior on those they were tied to."""
        gone = sorted(keys, key=lambda k: self._order[k])
        if not gone:
            return
        lost = set(gone)
        touching = [m for m in self._measurements if m.sight.observer_key in lost or m.sight.peer_key in lost]
        # a motion factor is stored with its later keyframe, one of which may stay in the window
        tied = [key for key in self._motion if any(lost & set(f.keys()) for f in self._motion[key])]
        motion, kept_prior = gtsam.NonlinearFactorGraph(), []
        for key in tied:
            stay = []
            for factor in self._motion[key]:
                (motion.add if lost & set(factor.keys()) else stay.append)(factor)
            self._motion[key] = stay
        for factor in self._prior:
            (motion.add if lost & set(factor.keys()) else kept_prior.append)(factor)
        linear = self._problem(touching, motion, False).linear(self.values)[0]
        ordering = gtsam.Ordering()
        for key in gone:
            ordering.push_back(key)
        _, remaining = linear.eliminatePartialSequential(ordering)
        told = set().union(*(remaining.at(i).keys() for i in range(remaining.size())))
        if told:
            poses = [key for key in self._order if key in told]
            constants = [key for key in self._biases if key in told]
            kept_prior.append(relative_prior(remaining, self.values, sorted(poses), constants))
        self._prior = kept_prior
        removed = set(map(id, touching))
        self._measurements = [m for m in self._measurements if id(m) not in removed]
        for key in gone:
            self.values.erase(key)
            del self._order[key], self._motion[key]

    def _motion_graph(self, keys: Iterable[int]) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        for factor in self._prior:
            graph.add(factor)
        for key in keys:
            for factor in self._motion[key]:
                graph.add(factor)
        return graph

    def _problem(
        self,
        measurements: Sequence[OnlineMeasurement],
        motion: gtsam.NonlinearFactorGraph,
        judged: bool,
        inflation: float = 1.0,
        unknown: bool = False,
    ) -> Problem:
        """Least squares over measurements, judged anew at the present values if asked."""
        bearings = [m for m in measurements if not isinstance(m.node, RangeNode)]
        ranges = [m for m in measurements if isinstance(m.node, RangeNode)]
        terms = window_terms(bearings, ranges, self._mass)
        both = [*bearings, *ranges]
        if judged and both:
            nothing = np.zeros((12, 12))
            spread = np.array([nothing if m.spread is None else m.spread for m in both])
            trust, chosen = belief(terms, terms.poses(self.values), inflation, spread)
            for m, probability in zip(both, trust, strict=True):
                m.trust = float(probability)
            for m, k in zip(bearings, chosen, strict=True):
                m.hypothesis = int(k)
        trust = np.array([m.trust for m in both], dtype=float)
        believed = np.ones_like(trust) if unknown else np.where(trust < _LEAST_TRUST, 0.0, trust)
        chosen = np.array([m.hypothesis for m in bearings], dtype=int)
        return Problem(motion, terms, chosen, believed, inflation, huber if unknown else quadratic)

    def _ordering(self, newest: Sequence[int]) -> gtsam.Ordering:
        """Old to new, then the biases, then the poses whose joint covariance is wanted."""
        last = set(newest)
        ordering = gtsam.Ordering()
        for key in sorted(self._order, key=lambda k: self._order[k]):
            if key not in last:
                ordering.push_back(key)
        for key in (*self._biases, *newest):
            ordering.push_back(key)
        return ordering


def _joint_covariance(net: gtsam.GaussianBayesNet, newest: Sequence[int]) -> Float[NDArray, "n n"]:
    """From the last conditionals of an elimination, which know only each other."""
    n = len(newest)
    at = {key: 6 * i for i, key in enumerate(newest)}
    root = np.zeros((6 * n, 6 * n))
    found, i = 0, net.size()
    while found < n:  # near the end, though independent robots may stand in any order
        i -= 1
        conditional = net.at(i)
        keys = list(conditional.keys())
        if keys[0] not in at:
            continue
        found, row = found + 1, at[keys[0]]
        root[row : row + 6, row : row + 6] = conditional.R()
        if len(keys) > 1:
            S = conditional.S()
            for j, key in enumerate(keys[1:]):
                root[row : row + 6, at[key] : at[key] + 6] = S[:, 6 * j : 6 * j + 6]
    inverse = np.linalg.solve(root, np.eye(6 * n)) if n else root
    return inverse @ inverse.T
