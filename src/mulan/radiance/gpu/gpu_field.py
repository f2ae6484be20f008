"""From rays to what they see, a wave of them at a time: march, encode, density, reach, colour, sums."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.gpu.composite_backward_kernel import composite_backward
from mulan.radiance.gpu.composite_kernels import GpuCompositor, RayAnswers
from mulan.radiance.gpu.gpu_networks import GpuNetworks, NetworkOutputs
from mulan.radiance.gpu.gpu_occupancy import GpuGrid
from mulan.radiance.gpu.hash_kernels import GpuEncoding
from mulan.radiance.gpu.launch import TritonConfig
from mulan.radiance.gpu.march_kernels import Marcher
from mulan.radiance.gpu.parameters import FlatParameters
from mulan.radiance.gpu.ray_kernels import direction_harmonics, gather_ray_gradients
from mulan.radiance.gpu.ray_losses import RayLosses
from mulan.radiance.gpu.reach_kernels import ReachedSamples, keep_reached
from mulan.radiance.gpu.space_kernels import SceneArguments
from mulan.radiance.ray_gradients import RayGradients
from mulan.radiance.space import SceneSpace


@dataclass(frozen=True)
class Wave:
    """Consecutive rays, their samples, and what they see.

    Attributes:
        part: Which rays.
        origins, directions: They themselves.
        marched: Samples whose density was evaluated.
        encoded: Encodings of those.
        reached: Samples with a colour.
        harmonics: Of each ray's direction.
        seen: What the networks say of each reached sample.
        blend: Its compositing weight.
        background: Behind all rays, or behind each.
        answers: What each ray collects.
    """

    part: slice
    origins: Float[Tensor, "r 3"]
    directions: Float[Tensor, "r 3"]
    marched: int
    encoded: Float[Tensor, "encoded room"]
    reached: ReachedSamples
    harmonics: Float[Tensor, "r 16"]
    seen: NetworkOutputs
    blend: Float[Tensor, "room"]
    background: Float[Tensor, "*r 3"]
    answers: RayAnswers


class GpuField:
    """The field's kernels in the order in which rays need them.

    Attributes:
        parameters: What it has learnt.
        encoding: The hash grid.
        grid: Where it is worth looking.
    """

    def __init__(
        self,
        field: FieldConfig,
        march: MarchConfig,
        space: SceneSpace,
        white_background: bool,
        generator: torch.Generator,
        config: TritonConfig,
        device: torch.device,
    ) -> None:
        self._field, self._march, self._config = field, march, config
        self._scene = SceneArguments.of(march, space)
        self.parameters = FlatParameters(field, generator, device)
        self.encoding = GpuEncoding(field, config, device)
        self.grid = GpuGrid(march, space, config, device)
        self._networks = GpuNetworks(field, config)
        self._compositor = GpuCompositor(self._scene, config)
        self._background = torch.full((3,), float(white_background), device=device)

    def density_unit(self, unit: Float[Tensor, "3 room"], count: int) -> Float[Tensor, "room"]:
        """Densities per scene radius of the first ``count`` points of the unit cube."""
        encoded = self.encoding.encode(unit, self.parameters.table, count)
        return self._networks.density(encoded, self.parameters.networks, count)

    def waves(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        weights: Float[Tensor, "r"] | None = None,
        seed: int | None = None,
        exploring_share: float = 0.0,
        backgrounds: Float[Tensor, "r 3"] | None = None,
    ) -> Iterator[Wave]:
        """What rays see; with a seed their samples are jittered, rays of weight 0 see the background.

        Backgrounds, where given, take the place of the scene's.
        """
        parameters, config, scene = self.parameters, self._config, self._scene
        least = self._march.least_opacity if scene.unbounded and self.grid.is_warm else 0.0
        for first, marched in Marcher(self.grid.occupied, scene, config, seed).waves(
            origins, directions, weights
        ):
            part = slice(first, first + len(marched.offsets) - 1)
            encoded = self.encoding.encode(marched.unit, parameters.table, marched.samples)
            density = self._networks.density(encoded, parameters.networks, marched.samples)
            reached = keep_reached(
                marched, density, scene, config, least, exploring_share, seed or 0, first_ray=first
            )
            harmonics = direction_harmonics(directions[part], self._field.harmonics_degree)
            seen = self._networks.colour(encoded, reached, harmonics, parameters.networks)
            blend = torch.empty_like(seen.variance)
            background = self._background if backgrounds is None else backgrounds[part]
            answers = self._compositor.composite(
                *(reached.offsets, reached.distance_m, reached.density, seen.colour, seen.variance),
                *(background, blend),
            )
            yield Wave(
                part,
                origins[part],
                directions[part],
                marched.samples,
                encoded,
                reached,
                harmonics,
                seen,
                blend,
                background,
                answers,
            )

    def backward(self, wave: Wave, losses: RayLosses, learn: bool, rays: bool) -> RayGradients | None:
        """Add to the parameters' gradients (``learn``) and give those to the wave's rays (``rays``)."""
        parameters, reached, seen = self.parameters, wave.reached, wave.seen
        to_samples = composite_backward(
            *(reached.offsets, reached.distance_m, reached.density, seen.colour, seen.variance),
            *(wave.background, losses, self._scene, self._config),
        )
        gradients = self._networks.backward(
            *(wave.encoded, reached, wave.harmonics, parameters.networks, seen, to_samples),
            *(learn, rays, losses.variance_teaches),
        )
        if gradients.parameters is not None:
            parameters.network_gradient.add_(gradients.parameters)
            self.encoding.scatter(reached.unit, gradients.encoded, reached.count, parameters.table_gradient)
        if gradients.harmonics is None:
            return None
        to_points = self.encoding.point_gradients(
            reached.unit, parameters.table, gradients.encoded, reached.count
        )
        return gather_ray_gradients(
            *(reached, wave.origins, wave.directions, to_points, gradients.harmonics),
            *(self._field.harmonics_degree, self._scene, self._config),
        )
