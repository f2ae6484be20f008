"""A step in two halves, as data-parallel training takes it."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.native_grid import NativeGridConfig
from mulan.radiance.kernels.native_library import NativeLibrary
from mulan.radiance.native_engine import NativeConfig, NativeEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace
from mulan.radiance.split_step import BatchPart, ParameterGradients, SplitStepEngine
from mulan.radiance.torch_engine import TorchEngine
from tests.native.spheres import batch_around

FIELD = FieldConfig(levels=4, log2_table_size=10, finest_resolution=48, width=16, geometry_features=8)
MARCH = MarchConfig(steps=48, occupancy_resolution=32)
OFTEN = OptimiserConfig(occupancy_every=3, random_background=True)
STEPS = 3 * 7 + 5  # past the occupancy grid's warm-up

NewEngine = Callable[[], SplitStepEngine]


@pytest.fixture(params=["bounded", "unbounded"])
def space(request: pytest.FixtureRequest) -> SceneSpace:
    return SceneSpace((0.0, 0.0, 0.0), 0.8, request.param == "unbounded")


@pytest.fixture(params=["native", "native, all entries", "torch"])
def new_engine(request: pytest.FixtureRequest, library: NativeLibrary, space: SceneSpace) -> NewEngine:
    def native() -> SplitStepEngine:
        config = NativeConfig(1, request.param != "native", NativeGridConfig())
        return NativeEngine(FIELD, MARCH, space, True, 3, OFTEN, native=config, library=library)

    return native if request.param != "torch" else lambda: TorchEngine(FIELD, MARCH, space, True, 3, OFTEN)


def batches(steps: int, rays_a_pixel: int = 1) -> list[RayBatch]:
    """Batches of 120 rays; several rays a pixel have the pixel's colour."""
    g = torch.Generator().manual_seed(0)
    drawn = [batch_around(120, g) for _ in range(steps)]
    return [
        replace(
            batch,
            colours=batch.colours[::rays_a_pixel].repeat_interleave(rays_a_pixel, 0),
            opacity=torch.rand(120 // rays_a_pixel, generator=g).repeat_interleave(rays_a_pixel),
            rays_a_pixel=rays_a_pixel,
        )
        for batch in drawn
    ]


def part_of(batch: RayBatch, part: BatchPart) -> RayBatch:
    assert batch.opacity is not None
    return RayBatch(
        origins=part.of(batch.origins),
        directions=part.of(batch.directions),
        colours=part.of(batch.colours),
        weights=part.of(batch.weights),
        image_index=part.of(batch.image_index),
        opacity=part.of(batch.opacity),
        rays_a_pixel=batch.rays_a_pixel,
    )


def assert_equal_states(a: SplitStepEngine, b: SplitStepEngine) -> None:
    first, second = a.state(), b.state()
    assert [name for name in first if not torch.equal(first[name], second[name])] == []


def test_the_two_halves_are_the_whole_step_bit_for_bit(new_engine: NewEngine) -> None:
    whole, halves = new_engine(), new_engine()
    for step, batch in enumerate(batches(STEPS)):
        factor = 0.5 * (1 + math.cos(step / STEPS))
        gradients, report = halves.gradients(batch)
        halves.apply(gradients, factor)
        assert report == whole.train_step(batch, factor)
    assert_equal_states(whole, halves)


@pytest.mark.parametrize("rays_a_pixel", [1, 2])
def test_weighted_mean_of_the_parts_gradients_is_the_joint_batchs(
    new_engine: NewEngine, rays_a_pixel: int
) -> None:
    whole, left, right = new_engine(), new_engine(), new_engine()
    values = torch.empty(left.parameter_count), torch.empty(left.parameter_count)
    for batch in batches(STEPS, rays_a_pixel):
        joint, report = whole.gradients(batch)
        sides = [
            engine.gradients(part_of(batch, part), part, out)
            for engine, out, part in zip(
                (left, right), values, (BatchPart.of_process(120, rank, 2) for rank in (0, 1)), strict=True
            )
        ]
        assert sides[0][1].samples + sides[1][1].samples == report.samples
        assert sides[0][0].rays + sides[1][0].rays == joint.rays
        weight = sum(g.weight for g, _ in sides)
        assert weight == pytest.approx(joint.weight)
        mean = sum(g.values * (g.weight / weight) for g, _ in sides)
        torch.testing.assert_close(mean, joint.values, rtol=1e-3, atol=1e-6 * float(joint.values.abs().max()))
        assert sum(r.loss * g.weight for g, r in sides) / weight == pytest.approx(report.loss, rel=1e-5)
        # the same gradients, so that all three stay equal and their sampling noise agrees
        for engine in (whole, left, right):
            engine.apply(ParameterGradients(joint.values.clone(), joint.weight, joint.rays), 1.0)
    assert_equal_states(left, right)
    assert_equal_states(whole, left)


@pytest.mark.parametrize("array", ["origins", "directions", "colours", "weights"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_numbers_that_are_not_finite_never_reach_a_kernel(
    new_engine: NewEngine, array: str, value: float
) -> None:
    engine, batch = new_engine(), batches(1)[0]
    before = engine.state()
    getattr(batch, array)[3] = value
    name = "rays" if array in ("origins", "directions") else array
    for attempt in (lambda: engine.train_step(batch, 1.0), lambda: engine.gradients(batch)):
        with pytest.raises(ValueError, match=f"{name} must be finite"):
            attempt()
    after = engine.state()
    assert [n for n in before if not torch.equal(before[n], after[n])] == []
