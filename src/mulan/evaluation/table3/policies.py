"""The rules compared, each choosing one of a robot's eight moves."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.planning.knowledge import Knowledge
from mulan.planning.score import LiteralPosterior
from mulan.planning.scores.angular_novelty import AngularNovelty
from mulan.planning.scores.coverage import Coverage
from mulan.planning.scores.farthest_point import FarthestPoint
from mulan.planning.scores.mean_sum import default_score
from mulan.planning.scores.random_order import RandomOrder
from mulan.planning.scores.score import RayScore, Score
from mulan.planning.scores.surround_coverage import SurroundCoverage
from mulan.planning.scores.variance_posterior import VariancePosterior
from mulan.planning.ways import Way, worth_of_ways


class Rule(ABC):
    """Says how much each of a robot's moves is worth."""

    @property
    @abstractmethod
    def fields_needed(self) -> int:
        """How many fields it must be given."""

    @property
    def looks_ahead(self) -> bool:
        """Whether it asks where each move would lead to, as far as the robot may still go."""
        return False

    @abstractmethod
    def __call__(self, knowledge: Knowledge, ways: Sequence[Way]) -> Float[NDArray, "n"]:
        """Worth of each move, which is the first view of each way."""


@dataclass(frozen=True)
class OneMove(Rule):
    """A score of the view after the move.

    Attributes:
        score: The score.
    """

    score: Score

    @property
    def fields_needed(self) -> int:
        """What the score needs."""
        return self.score.fields_needed

    def __call__(self, knowledge: Knowledge, ways: Sequence[Way]) -> Float[NDArray, "n"]:
        """The score."""
        return self.score(knowledge, [way[0] for way in ways])


@dataclass(frozen=True)
class StraightOn(Rule):
    """Worth of going on straight as often as the robot may still move; it chooses anew after each move.

    Attributes:
        scores: What a view would teach.
    """

    scores: tuple[RayScore, ...]

    @property
    def fields_needed(self) -> int:
        """As many as the most demanding of the scores."""
        return max(score.fields_needed for score in self.scores)

    @property
    def looks_ahead(self) -> bool:
        """Yes."""
        return True

    def __call__(self, knowledge: Knowledge, ways: Sequence[Way]) -> Float[NDArray, "n"]:
        """See :func:`mulan.planning.ways.worth_of_ways`."""
        return worth_of_ways(knowledge, ways, self.scores)


@dataclass(frozen=True)
class Policy:
    """One row of the table.

    Attributes:
        name: Its key in metrics.json.
        title: What a person reads.
        rule: The rule for one seed.
        published: Whether it is compared unless policies are named.
    """

    name: str
    title: str
    rule: Callable[[int], Rule]
    published: bool = True


POLICIES = (
    Policy("random", "random", lambda seed: OneMove(RandomOrder(seed))),
    Policy("farthest-point", "farthest point", lambda _: OneMove(FarthestPoint())),
    Policy("coverage", "coverage", lambda _: OneMove(Coverage())),
    Policy(
        "activenerf-literal",
        "learned variance, as printed",
        lambda _: OneMove(VariancePosterior(LiteralPosterior())),
    ),
    Policy("ours", "ours", lambda _: OneMove(SurroundCoverage())),
    Policy(
        "angular", "angular novelty of what is seen", lambda _: OneMove(AngularNovelty()), published=False
    ),
    Policy("ours-ensemble", "ours with an ensemble", lambda _: OneMove(default_score()), published=False),
    Policy(
        "ours-straight-on",
        "ours, straight on",
        lambda _: StraightOn((AngularNovelty(),)),
        published=False,
    ),
)
TITLES = {policy.name: policy.title for policy in POLICIES}
