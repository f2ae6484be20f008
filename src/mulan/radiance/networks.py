"""The small networks behind the hash grid: density, colour and colour variance. No biases anywhere."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from mulan.radiance.config import FieldConfig
from mulan.radiance.kernels.hash_encoding import HashEncoding
from mulan.radiance.kernels.spherical_harmonics import spherical_harmonics

LOG_DENSITY_OFFSET = -1.5
LOG_DENSITY_MAX = 15.0
VARIANCE_FLOOR = 1e-4


class RadianceField(nn.Module):
    """Density, colour and colour variance at unit-cube points.

    Parameters (all float32, no biases; the names are those of the saved file):

    * ``table`` [levels, 2^log2_table_size, features], uniform in ±1e-4 at first;
    * ``density_hidden`` [width, encoded], ``density_out`` [geometry_features, width];
    * ``colour_hidden_0`` [width, degree² + geometry_features], ``colour_hidden_1`` [width, width],
      ``colour_out`` [3, width];
    * ``variance_out`` [1, width + geometry_features].
    """

    def __init__(self, config: FieldConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.config = config
        self.encoding = HashEncoding(config)
        self.level_weights: Tensor | None = None
        width, features = config.width, config.geometry_features

        def matrix(rows: int, columns: int, gain: float = math.sqrt(2)) -> nn.Parameter:
            # Glorot's bound as in tiny-cuda-nn, larger before a ReLU
            bound = gain * math.sqrt(3 / columns)
            return nn.Parameter((torch.rand(rows, columns, generator=generator) * 2 - 1) * bound)

        shape = (config.levels, 2**config.log2_table_size, config.features)
        self.table = nn.Parameter((torch.rand(shape, generator=generator) * 2 - 1) * 1e-4)
        self.density_hidden = matrix(width, config.encoded_width)
        self.density_out = matrix(features, width, gain=1.0)
        self.colour_hidden_0 = matrix(width, config.harmonics_degree**2 + features)
        self.colour_hidden_1 = matrix(width, width)
        self.colour_out = matrix(3, width, gain=1.0)
        self.variance_out = matrix(1, width + features, gain=0.1)

    def geometry(
        self, unit: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, "n"], Float[Tensor, "n hidden"], Float[Tensor, "n geometry"]]:
        """Density per scene radius, hidden activations and geometry features.

        The density is ``exp(min(features[0] - 1.5, 15))``: 0.22 a radius before any learning, so that light
        crosses an empty scene.
        """
        encoded = self.encoding(unit, self.table)
        if self.level_weights is not None:
            encoded = encoded * self.level_weights.repeat_interleave(self.config.features)
        hidden = functional.relu(functional.linear(encoded, self.density_hidden))
        features = functional.linear(hidden, self.density_out)
        density = torch.exp((features[:, 0] + LOG_DENSITY_OFFSET).clamp_max(LOG_DENSITY_MAX))
        return density, hidden, features

    def colour(
        self, features: Float[Tensor, "n geometry"], directions: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 3"]:
        """Colour in (0, 1) seen along unit directions."""
        harmonics = spherical_harmonics(directions, self.config.harmonics_degree)
        hidden = functional.relu(
            functional.linear(torch.cat([harmonics, features], -1), self.colour_hidden_0)
        )
        hidden = functional.relu(functional.linear(hidden, self.colour_hidden_1))
        return torch.sigmoid(functional.linear(hidden, self.colour_out))

    def variance(
        self,
        hidden: Float[Tensor, "n hidden"],
        features: Float[Tensor, "n geometry"],
        teaches_trunk: bool = False,
    ) -> Float[Tensor, "n"]:
        """Colour variance, at least 1e-4 (ActiveNeRF, Pan et al. 2022, eq. 7).

        The inputs are detached unless a loss asks otherwise: the head's loss must not reach the shared trunk.
        """
        inputs = torch.cat([hidden, features], -1)
        if not teaches_trunk:
            inputs = inputs.detach()
        return functional.softplus(functional.linear(inputs, self.variance_out))[:, 0] + VARIANCE_FLOOR
