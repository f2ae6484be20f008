"""How much a view's colours would say about the field's parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.planning.knowledge import Knowledge
from mulan.planning.look import Look
from mulan.planning.scores.score import Score
from mulan.planning.view import View
from mulan.radiance.split_step import SplitStepEngine


@dataclass(frozen=True)
class FisherInformation(Score):
    """Gain of ``log det`` of the diagonal Fisher information (FisherRF, Jiang et al. 2024).

    ``Σ log(1 + I/(H + λ))`` over the parameters, I the candidate's information, H that of the chosen views.
    The diagonal of JᵀWJ is the mean square of Jᵀ√W z over random signs z (Hutchinson's estimator), so no
    ray's gradient is needed by itself; W holds the certainties.
    """

    probes: int = 4
    """Draws of the signs; the diagonal's relative error falls with their root."""
    prior_quantile: float = 0.5
    """λ is this quantile of H's positive entries; a large λ turns the gain into the view's footprint."""

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """Gain of each candidate [nat].

        Raises:
            TypeError: The field's engine gives no gradients to its parameters.
        """
        engine = knowledge.fields[0]
        if not isinstance(engine, SplitStepEngine):
            raise TypeError("the Fisher information needs the gradients of a CPU engine")
        known = torch.zeros(engine.parameter_count)
        for view in knowledge.chosen:
            known += self.diagonal(engine, knowledge.look(view))
        positive = known[known > 0].numpy()
        prior = float(np.quantile(positive, self.prior_quantile)) if len(positive) else 1.0
        return np.array(
            [
                float(torch.log1p(self.diagonal(engine, knowledge.look(view)) / (known + prior)).sum())
                for view in candidates
            ]
        )

    def diagonal(self, engine: SplitStepEngine, look: Look) -> Float[Tensor, "parameters"]:
        """Diagonal of a look's Fisher information, for colours of unit variance."""
        generator = torch.Generator().manual_seed(0)
        root = look.certainty.sqrt()[:, None]
        total = torch.zeros(engine.parameter_count)
        for _ in range(self.probes):
            signs = torch.randint(2, (len(root), 3), generator=generator) * 2.0 - 1
            total += engine.parameter_gradient(look.origins, look.directions, root * signs).square()
        return total / self.probes
