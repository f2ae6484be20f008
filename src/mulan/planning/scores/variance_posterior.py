"""The paper's rule: the expected fall of the variance the field has learnt (ActiveNeRF, Pan et al. 2022)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.planning.knowledge import Knowledge
from mulan.planning.score import CandidateView, Posterior, PropagatedPosterior, variance_reduction
from mulan.planning.scores.score import Score
from mulan.planning.view import View


@dataclass(frozen=True)
class VariancePosterior(Score):
    """Learned variance before and after the photograph; the pose's covariance is part of the posterior."""

    posterior: Posterior = field(default_factory=PropagatedPosterior)
    """The equation as corrected, or as printed."""

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """See :func:`mulan.planning.score.variance_reduction`."""
        columns = knowledge.config.columns
        return np.array(
            [
                variance_reduction(
                    knowledge.fields[0],
                    CandidateView(view.camera, view.T_world_camera, view.covariance, columns),
                    self.posterior,
                )
                for view in candidates
            ]
        )
