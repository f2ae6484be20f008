import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.kernels.native_buffers import address
from mulan.radiance.kernels.native_library import NativeLibrary
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine
from tests.native.odd_inputs import LARGE_AND_SMALL
from tests.native.spheres import batch_around, rays_around

FIELD = FieldConfig(levels=4, log2_table_size=10, finest_resolution=40, width=16, geometry_features=8)
MARCH = MarchConfig(steps=64, occupancy_resolution=16)
BOX, WORLD = SceneSpace((0.0, 0.0, 0.0), 0.8, False), SceneSpace((0.0, 0.0, 0.0), 0.8, True)
OTHER_TYPES = (torch.float64, torch.float16, torch.int8, torch.int32, torch.bool)
NOT_FINITE = [math.nan, math.inf, -math.inf]


@pytest.fixture(params=["native", "torch"])
def engine(library: NativeLibrary, request: pytest.FixtureRequest) -> RadianceEngine:
    if request.param == "torch":
        return TorchEngine(FIELD, MARCH, BOX, True)
    return NativeEngine(FIELD, MARCH, BOX, True, library=library)


def with_one(array: Tensor, value: float) -> Tensor:
    changed = array.clone()
    changed.view(-1)[7] = value
    return changed


@pytest.mark.parametrize("value", NOT_FINITE)
def test_rays_are_refused(engine: RadianceEngine, value: float) -> None:
    o, d = rays_around(10, torch.Generator().manual_seed(0))
    for rays in ((with_one(o, value), d), (o, with_one(d, value))):
        with pytest.raises(ValueError, match="rays must be finite"):
            engine.render(*rays)
        with pytest.raises(ValueError, match="rays must be finite"):
            engine.sample(*rays)


@pytest.mark.parametrize("value", NOT_FINITE)
@pytest.mark.parametrize("part", ["origins", "directions", "colours", "weights"])
def test_nothing_is_learnt_from_them(engine: RadianceEngine, part: str, value: float) -> None:
    batch, before = batch_around(10, torch.Generator().manual_seed(0)), engine.state()
    with pytest.raises(ValueError, match="must be finite"):
        engine.train_step(replace(batch, **{part: with_one(getattr(batch, part), value)}), 1.0)
    after = engine.state()
    assert all(torch.equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("value", NOT_FINITE)
def test_gradients_are_refused(library: NativeLibrary, value: float) -> None:
    engine = NativeEngine(FIELD, MARCH, BOX, True, library=library)
    o, d = rays_around(10, torch.Generator().manual_seed(0))
    with pytest.raises(ValueError, match="colour gradients must be finite"):
        engine.ray_gradients(o, d, with_one(torch.ones(10, 3), value))


def test_finite_numbers_are_not(engine: RadianceEngine) -> None:
    """Their sum overflows; they do not."""
    o, d = rays_around(10, torch.Generator().manual_seed(0))
    assert engine.render(torch.full_like(o, 3e38), d).opacity.abs().max() == 0
    batch = batch_around(10, torch.Generator().manual_seed(0))
    engine.train_step(replace(batch, origins=torch.full_like(o, 3e38)), 1.0)


@pytest.mark.parametrize(
    "wrong",
    [
        torch.zeros(4, 3),
        torch.zeros(5, 2),
        torch.zeros(3, 5).T,
        *(torch.zeros(5, 3).to(t) for t in OTHER_TYPES),
    ],
    ids=str,
)
def test_arrays_of_the_wrong_kind_do_not_reach_the_library(wrong: Tensor) -> None:
    """Without the shape checks of the tests, too."""
    with pytest.raises(ValueError, match=r"shape|float32|contiguous"):
        address(wrong, (5, 3))


@settings(max_examples=40)
@given(
    numbers=st.lists(
        st.one_of(
            st.sampled_from([float(np.float32(x)) for x in LARGE_AND_SMALL]),
            st.floats(width=32, allow_nan=False, allow_infinity=False),
        ),
        min_size=6,
        max_size=6,
    ),
    unbounded=st.booleans(),
)
def test_a_strange_ray_does_not_disturb_its_neighbours(
    library: NativeLibrary, numbers: list[float], unbounded: bool
) -> None:
    engine = NativeEngine(FIELD, MARCH, WORLD if unbounded else BOX, True, library=library)
    o, d = rays_around(9, torch.Generator().manual_seed(0))
    alone = engine.render(o, d)
    ray = torch.tensor(numbers)
    among = engine.render(torch.cat([o[:4], ray[None, :3], o[4:]]), torch.cat([d[:4], ray[None, 3:], d[4:]]))
    rest = torch.tensor([0, 1, 2, 3, 5, 6, 7, 8, 9])
    # places in a vector round differently
    torch.testing.assert_close(among.colour[rest], alone.colour, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(among.depth_m[rest], alone.depth_m, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(among.variance[rest], alone.variance, rtol=1e-4, atol=1e-5)
