"""The networks on the GPU: launching ``network_kernels.py``."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.config import FieldConfig
from mulan.radiance.gpu.composite_kernels import SampleGradients
from mulan.radiance.gpu.launch import TritonConfig, padded, programs
from mulan.radiance.gpu.network_kernels import HARMONICS, backward_kernel, colour_kernel, density_kernel
from mulan.radiance.gpu.reach_kernels import ReachedSamples


@dataclass(frozen=True)
class NetworkGradients:
    """What the networks hand back.

    Attributes:
        encoded: Gradient to the encoding of each reached sample.
        harmonics: Gradient to the harmonics of its direction; None where nobody asked.
        parameters: Gradient to the parameters; None where nobody asked.
    """

    encoded: Float[Tensor, "encoded room"]
    harmonics: Float[Tensor, "bands room"] | None
    parameters: Float[Tensor, "parameters"] | None


class GpuNetworks:
    """Density, colour and colour variance from encodings; parameters are given flat."""

    def __init__(self, field: FieldConfig, config: TritonConfig) -> None:
        self._config, self._field = config, field
        precision = config.precision
        self._products = {
            "OPERAND": precision.operand,
            "PRODUCT": precision.product,
            "B": config.blocks.matrix_samples,
        }
        self._sizes = {
            "E": field.encoded_width,
            "W": field.width,
            "EP": padded(field.encoded_width),
            "WP": padded(field.width),
        }
        self._colour_sizes = {
            "G": field.geometry_features,
            "K": field.harmonics_degree**2,
            "GP": padded(field.geometry_features),
        }

    def density(
        self, encoded: Float[Tensor, "encoded room"], networks: Float[Tensor, "parameters"], count: int
    ) -> Float[Tensor, "room"]:
        """Density per scene radius of the first ``count`` points."""
        room = encoded.shape[1]
        density = torch.empty(room, device=encoded.device)
        if count:
            density_kernel[(programs(count, self._config.blocks.matrix_samples),)](
                *(encoded, networks, density, count, room), **self._sizes, **self._products
            )
        return density

    def colour(
        self,
        encoded: Float[Tensor, "encoded room"],
        reached: ReachedSamples,
        harmonics: Float[Tensor, "r 16"],
        networks: Float[Tensor, "parameters"],
    ) -> tuple[Float[Tensor, "3 room"], Float[Tensor, "room"]]:
        """Colour and colour variance of the reached samples; encodings are those of all marched ones."""
        room = encoded.shape[1]
        colour, variance = torch.empty_like(reached.unit), torch.empty_like(reached.density)
        colour_kernel[(programs(room, self._config.blocks.matrix_samples),)](
            *(encoded, reached.source, reached.ray, harmonics, networks, reached.count, colour, variance, room),
            **self._sizes,
            **self._colour_sizes,
            **self._products,
        )
        return colour, variance

    def backward(
        self,
        encoded: Float[Tensor, "encoded room"],
        reached: ReachedSamples,
        harmonics: Float[Tensor, "r 16"],
        networks: Float[Tensor, "parameters"],
        gradients: SampleGradients,
        learn: bool,
        rays: bool,
    ) -> NetworkGradients:
        """Gradients to the encodings and, where asked for, to the parameters and to the harmonics.

        Each program sums the parameters' gradient over its samples; the parts are added in a fixed order.
        """
        room, blocks = encoded.shape[1], self._config.blocks
        work = programs(room, blocks.matrix_samples)
        launched = min(work, blocks.matrix_programs) if learn else work
        device = encoded.device
        to_encoded = torch.empty(encoded.shape, device=device)
        to_harmonics = torch.empty(HARMONICS.value, room, device=device) if rays else None
        partial = torch.empty(launched, len(networks), device=device) if learn else None
        backward_kernel[(launched,)](
            *(encoded, reached.source, reached.ray, harmonics, networks, reached.count),
            *(gradients.logits, gradients.log_density, gradients.variance, to_encoded),
            to_encoded if to_harmonics is None else to_harmonics,
            to_encoded if partial is None else partial,
            *(room, len(networks)),
            **self._sizes,
            **self._colour_sizes,
            **self._products,
            LEARN=learn,
            RAYS=rays,
            num_warps=8,
        )
        return NetworkGradients(to_encoded, to_harmonics, None if partial is None else partial.sum(0))
