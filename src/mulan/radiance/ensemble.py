"""Several fields of one scene as one: their mean, and as the variance that of their mixture."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.engine import RadianceEngine, Rendering


class FieldEnsemble:
    """Fields learnt from the same views, each from its own start (Lakshminarayanan et al. 2017).

    Renders like one field. What the views leave open, members fill in each in its own way, so they disagree
    where none can know. Where all err alike, as beside fine structure, the variance each learnt from its own
    residuals says so. The variance of the mixture, the sum of both, ranks the true error better than either.

    Attributes:
        members: The fields, at least two.
    """

    def __init__(self, members: Sequence[RadianceEngine]) -> None:
        """Gather the members.

        Raises:
            ValueError: There are fewer than two.
        """
        if len(members) < 2:
            raise ValueError("an ensemble needs two members to disagree")
        self.members = tuple(members)

    def render(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """Means over the members.

        The variance is the colour's sample variance, mean over channels, and the mean of the members' own.
        """
        seen = [member.render(origins, directions) for member in self.members]
        colour = torch.stack([one.colour for one in seen])
        return Rendering(
            colour.mean(0),
            torch.stack([one.depth_m for one in seen]).mean(0),
            torch.stack([one.opacity for one in seen]).mean(0),
            colour.var(0).mean(-1) + torch.stack([one.variance for one in seen]).mean(0),
        )
