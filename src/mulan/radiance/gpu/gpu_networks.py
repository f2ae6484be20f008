"""The networks on the GPU: launching ``network_kernels.py``."""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.config import FieldConfig
from mulan.radiance.gpu.composite_backward_kernel import SampleGradients
from mulan.radiance.gpu.launch import TritonConfig, padded, programs
from mulan.radiance.gpu.network_kernels import (
    HARMONICS,
    colour_backward_kernel,
    colour_kernel,
    density_backward_kernel,
    density_kernel,
)
from mulan.radiance.gpu.reach_kernels import ReachedSamples


@dataclass(frozen=True)
class NetworkOutputs:
    """Geometry features, colours and colour variances of the reached samples."""

    geometry: Float[Tensor, "geometry room"]
    colour: Float[Tensor, "3 room"]
    variance: Float[Tensor, "room"]


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
            "num_warps": config.blocks.matrix_warps,
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
    ) -> NetworkOutputs:
        """What the reached samples look like; encodings are those of all marched ones."""
        room = encoded.shape[1]
        out = NetworkOutputs(
            encoded.new_empty(self._field.geometry_features, room),
            torch.empty_like(reached.unit),
            torch.empty_like(reached.density),
        )
        colour_kernel[(programs(room, self._config.blocks.matrix_samples),)](
            *(encoded, reached.source, reached.ray, harmonics, networks, reached.count),
            *(out.geometry, out.colour, out.variance, room),
            **self._all_sizes,
        )
        return out

    def backward(
        self,
        encoded: Float[Tensor, "encoded room"],
        reached: ReachedSamples,
        harmonics: Float[Tensor, "r 16"],
        networks: Float[Tensor, "parameters"],
        outputs: NetworkOutputs,
        gradients: SampleGradients,
        learn: bool,
        rays: bool,
        variance_teaches: bool,
    ) -> NetworkGradients:
        """Gradients to the encodings and, where asked for, to the parameters and to the harmonics.

        Each program sums the parameters' gradient over its samples; the parts are added in a fixed order.
        The variance's gradient reaches the trunk where ``variance_teaches``.
        """
        room, blocks = encoded.shape[1], self._config.blocks
        work = programs(room, blocks.matrix_samples)
        grid = (min(work, blocks.matrix_programs) if learn else work,)
        device = encoded.device
        to_geometry, to_encoded = (
            torch.empty_like(outputs.geometry),
            torch.empty(encoded.shape, device=device),
        )
        to_harmonics = torch.empty(HARMONICS.value, room, device=device) if rays else None
        partial = torch.empty(*grid, len(networks), device=device) if learn else None
        partial_or_any = to_encoded if partial is None else partial
        colour_backward_kernel[grid](
            *(
                outputs.geometry,
                reached.ray,
                harmonics,
                networks,
                reached.count,
                gradients.logits,
                to_geometry,
            ),
            to_encoded if to_harmonics is None else to_harmonics,
            *(partial_or_any, room, len(networks)),
            **self._all_sizes,
            LEARN=learn,
            RAYS=rays,
        )
        density_backward_kernel[grid](
            *(encoded, reached.source, outputs.geometry, networks, reached.count, to_geometry),
            *(gradients.log_density, gradients.variance, to_encoded, partial_or_any, room, len(networks)),
            **self._all_sizes,
            LEARN=learn,
            TEACH=variance_teaches,
        )
        return NetworkGradients(to_encoded, to_harmonics, None if partial is None else partial.sum(0))

    @property
    def _all_sizes(self) -> dict[str, Any]:
        return {**self._sizes, **self._colour_sizes, **self._products}
