"""The setups compared: which poses, which weights, refined or not."""

from collections.abc import Callable
from dataclasses import dataclass

from mulan.evaluation.table1.team import Team, of_robot, without_covariance
from mulan.mission.posed_images import PosedImageSet
from mulan.reconstruction.paper_weights import PaperCorrectedWeights, PaperWeights
from mulan.reconstruction.weights import NoWeights, UncertaintyWeights, Weighting


@dataclass(frozen=True)
class Setup:
    """One row of the table.

    Attributes:
        name: Its key in metrics.json.
        title: What a person reads.
        images: The photographs it learns from, out of the team's.
        weighting: How far each pixel is trusted.
        refines: Whether poses are corrected while learning.
    """

    name: str
    title: str
    images: Callable[[Team], PosedImageSet]
    weighting: Weighting
    refines: bool = False


SETUPS = (
    Setup("A", "A  true poses", lambda team: without_covariance(team.true), NoWeights()),
    Setup("B", "B  wireless poses", lambda team: without_covariance(team.believed), NoWeights()),
    Setup("C", "C  paper's weights", lambda team: team.believed, PaperCorrectedWeights()),
    Setup("paper_literal", "C  paper's, as printed", lambda team: team.believed, PaperWeights()),
    Setup(
        "alone",
        "first robot alone",
        lambda team: without_covariance(of_robot(team.believed, team.anchor)),
        NoWeights(),
    ),
    Setup("ours_weights", "ours, weights", lambda team: team.believed, UncertaintyWeights()),
    Setup("ours", "ours, refined", lambda team: team.believed, UncertaintyWeights(), refines=True),
)
