"""The rules compared, each choosing one of a robot's eight moves."""

from collections.abc import Callable
from dataclasses import dataclass

from mulan.planning.score import LiteralPosterior
from mulan.planning.scores.coverage import Coverage
from mulan.planning.scores.farthest_point import FarthestPoint
from mulan.planning.scores.random_order import RandomOrder
from mulan.planning.scores.rank_sum import default_score
from mulan.planning.scores.score import Score
from mulan.planning.scores.variance_posterior import VariancePosterior


@dataclass(frozen=True)
class Policy:
    """One row of the table.

    Attributes:
        name: Its key in metrics.json.
        title: What a person reads.
        score: The rule for one seed.
    """

    name: str
    title: str
    score: Callable[[int], Score]


POLICIES = (
    Policy("random", "random", RandomOrder),
    Policy("farthest-point", "farthest point", lambda _: FarthestPoint()),
    Policy("coverage", "coverage", lambda _: Coverage()),
    Policy(
        "activenerf-literal",
        "learned variance, as printed",
        lambda _: VariancePosterior(LiteralPosterior()),
    ),
    Policy("ours", "ours", lambda _: default_score()),
)
TITLES = {policy.name: policy.title for policy in POLICIES}
