"""The rules compared."""

from collections.abc import Callable
from dataclasses import dataclass

from mulan.evaluation.view_selection.pools import Pool, PoolKind
from mulan.planning.score import LiteralPosterior, PropagatedPosterior
from mulan.planning.scores.among_certain import AmongCertain
from mulan.planning.scores.angular_novelty import AngularNovelty
from mulan.planning.scores.coverage import Coverage
from mulan.planning.scores.direction_coverage import DirectionCoverage
from mulan.planning.scores.ensemble import EnsembleVariance
from mulan.planning.scores.farthest_point import FarthestPoint
from mulan.planning.scores.fisher import FisherInformation
from mulan.planning.scores.mean_sum import default_score
from mulan.planning.scores.random_order import RandomOrder
from mulan.planning.scores.score import Score
from mulan.planning.scores.variance_posterior import VariancePosterior


@dataclass(frozen=True)
class Policy:
    """One row of the comparison.

    Attributes:
        name: Its key in metrics.json.
        title: What a person reads.
        score: The rule for one pool and seed.
        blind: Whether it takes every pose as exact.
        pools: Where it is compared unless policies are named.
    """

    name: str
    title: str
    score: Callable[[Pool, int], Score]
    blind: bool = False
    pools: tuple[PoolKind, ...] = tuple(PoolKind)


RANDOM, FARTHEST, CERTAIN, BLIND, OURS = "random", "farthest-point", "farthest-certain", "ours-blind", "ours"

_EXACT = (PoolKind.STANDARD, PoolKind.NARROW)
_NOISE = (PoolKind.NOISY, PoolKind.GRADED)

POLICIES = (
    Policy(RANDOM, "random", lambda _, seed: RandomOrder(seed)),
    Policy(FARTHEST, "farthest point", lambda *_: FarthestPoint()),
    Policy(
        CERTAIN,
        "farthest point, certain views only",
        lambda pool, _: AmongCertain(FarthestPoint(), pool.certain_sigma_m),
        pools=_NOISE,
    ),
    Policy(
        "ours-certain",
        "ours, certain views only",
        lambda pool, _: AmongCertain(default_score(), pool.certain_sigma_m),
        pools=(),
    ),
    Policy("coverage", "coverage", lambda *_: Coverage(), pools=_EXACT),
    Policy("angular", "angular novelty of what is seen", lambda *_: AngularNovelty(), pools=_EXACT),
    Policy("direction", "directions of all that could be seen", lambda *_: DirectionCoverage(), pools=_EXACT),
    Policy("ensemble", "variance of an ensemble", lambda *_: EnsembleVariance(), pools=_EXACT),
    Policy("fisher", "Fisher information", lambda *_: FisherInformation(), pools=_EXACT),
    Policy(
        "activenerf-literal",
        "learned variance, as printed",
        lambda *_: VariancePosterior(LiteralPosterior()),
        pools=_NOISE,
    ),
    Policy("activenerf", "learned variance, corrected", lambda *_: VariancePosterior(PropagatedPosterior())),
    Policy(BLIND, "ours, poses taken as exact", lambda *_: default_score(), blind=True, pools=_NOISE),
    Policy(OURS, "ours", lambda *_: default_score()),
)
TITLES = {policy.name: policy.title for policy in POLICIES}
