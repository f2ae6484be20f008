"""The setups of the hardware experiment: whose poses, which weights, refined or not."""

from mulan.evaluation.table1.setups import Setup
from mulan.evaluation.table1.team import without_covariance
from mulan.mission.posed_images import PosedImageSet
from mulan.reconstruction.paper_weights import PaperCorrectedWeights
from mulan.reconstruction.weights import NoWeights, UncertaintyWeights

TITLES = {
    "A": "A  motion capture",
    "B": "B  motion capture, radio between",
    "C": "C  odometry, radio between",
    "D": "D  as C, paper's weights",
    "ours": "ours, as C, refined",
    "E": "E  odometry, COLMAP between",
    "E_poses": "E  COLMAP's own poses",
}

BY_RADIO = {
    "A": Setup("A", TITLES["A"], lambda team: without_covariance(team.true), NoWeights()),
    "B": Setup("B", TITLES["B"], lambda team: without_covariance(team.believed), NoWeights()),
    "C": Setup("C", TITLES["C"], lambda team: without_covariance(team.believed), NoWeights()),
    "D": Setup("D", TITLES["D"], lambda team: team.believed, PaperCorrectedWeights()),
    "ours": Setup("ours", TITLES["ours"], lambda team: team.believed, UncertaintyWeights(), refines=True),
}
"""B is learnt from the team whose own tracks are by motion capture."""


def by_colmap(name: str, images: PosedImageSet) -> Setup:
    """A setup whose poses COLMAP had a part in."""
    return Setup(name, TITLES[name], lambda _: images, NoWeights())
