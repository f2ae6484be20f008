import math
from dataclasses import replace

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.march import march_rays
from mulan.radiance.kernels.native_library import NativeLibrary
from mulan.radiance.space import SceneSpace
from tests.native import reference
from tests.native.fields import march, pack, rays_towards

BOX = SceneSpace((0.0, 0.0, 0.0), 1.3, False)
WORLD = SceneSpace((0.0, 0.0, 0.0), 1.3, True)
CONFIG = MarchConfig(steps=200, occupancy_resolution=32)


def scattered_cells(seed: int, share: float, cascades: int = 1) -> Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.rand(cascades, 32, 32, 32, generator=g) < share


def is_occupied(unit: Tensor, cells: Tensor) -> bool:
    """The cell of a unit point in the smallest cube about the centre that holds it."""
    cascades = len(cells)
    for k in range(cascades):
        side = 2.0 ** (k + 1 - cascades)
        within = (unit - 0.5) / side + 0.5
        if k == cascades - 1 or bool(((within > 0) & (within < 1)).all()):
            x, y, z = (within * 32).long().clamp(0, 31).tolist()
            return bool(cells[k, z, y, x])
    raise AssertionError


def plain_walk(o: Tensor, d: Tensor, cells: Tensor, space: SceneSpace) -> list[float]:
    """All steps of one ray, each tested on its own, in double precision."""
    o, d, taken = o.double(), d.double(), []
    step = 2 * math.sqrt(3) * space.radius_m / CONFIG.steps
    enter, leave = 0.0, math.inf
    if not space.unbounded:
        a, b = (-space.radius_m - o) / d, (space.radius_m - o) / d
        enter, leave = max(float(torch.minimum(a, b).max()), 0.0), float(torch.maximum(a, b).min())
    for i in range(CONFIG.steps):
        if space.unbounded:
            k = math.asinh(64 - 0.02)
            t = space.radius_m * (0.02 + math.sinh(k * (i + 0.5) / CONFIG.steps))
        else:
            t = enter + (i + 0.5) * step
            if t >= leave:
                break
        unit = reference.to_unit((o + t * d)[None], space.radius_m, space.unbounded)[0]
        if is_occupied(unit, cells):
            taken.append(t)
    return taken


@pytest.mark.parametrize("space", [BOX, WORLD], ids=["bounded", "unbounded"])
@pytest.mark.parametrize(("share", "cascades"), [(0.002, 1), (0.1, 1), (1.0, 1), (0.1, 3)])
def test_steps_in_occupied_cells_and_no_others(
    build: NativeLibrary, space: SceneSpace, share: float, cascades: int
) -> None:
    cells = scattered_cells(1, share, cascades)
    config = replace(CONFIG, cascades=cascades)
    g = torch.Generator().manual_seed(2)
    o, d = rays_towards(40, 3.0 if not space.unbounded else 1.0, g)
    count, t, dt = march(build, config, space, pack(build, cells), o, d)
    different = 0
    for ray in range(40):
        expected = torch.tensor(plain_walk(o[ray], d[ray], cells, space))
        got = t[ray, : count[ray]]
        # a sample on a cell's very wall may fall to either side in single precision
        off = {round(float(x), 3) for x in got} ^ {round(float(x), 3) for x in expected}
        different += len(got) != len(expected) or bool(((got - expected).abs() > 1e-4 * expected).any())
        assert len(off) <= 4
        assert (dt[ray, : count[ray]] > 0).all()
    assert different <= 2


@pytest.mark.parametrize("space", [BOX, WORLD], ids=["bounded", "unbounded"])
@pytest.mark.parametrize("cascades", [1, 2, 3])
def test_samples_are_those_of_the_torch_reference(
    library: NativeLibrary, space: SceneSpace, cascades: int
) -> None:
    config, cells = replace(CONFIG, cascades=cascades), scattered_cells(4, 0.2, cascades)
    o, d = rays_towards(200, 3.0 if not space.unbounded else 1.0, torch.Generator().manual_seed(3))
    count, t, _ = march(library, config, space, pack(library, cells), o, d)
    want = march_rays(o, d, space, config, cells, torch.full((200,), 0.5))
    assert abs(int(count.sum()) - len(want.distance_m)) <= 5
    for ray in range(200):
        got, expected = t[ray, : count[ray]], want.distance_m[want.ray_index == ray]
        # a sample on a cell's very wall may fall to either side
        off = {round(float(x), 3) for x in got} ^ {round(float(x), 3) for x in expected}
        assert len(off) <= 2


def test_an_empty_grid_has_no_samples(library: NativeLibrary) -> None:
    o, d = rays_towards(100, 3.0, torch.Generator().manual_seed(0))
    count, _, _ = march(library, CONFIG, BOX, pack(library, torch.zeros(32, 32, 32, dtype=torch.bool)), o, d)
    assert count.sum() == 0


def test_rays_beside_and_behind_the_box_have_no_samples(library: NativeLibrary) -> None:
    full = pack(library, torch.ones(32, 32, 32, dtype=torch.bool))
    o = torch.tensor([[0.0, 0.0, 3.0], [5.0, 0.0, 0.0], [0.0, 0.0, 1.31], [0.0, 0.0, 0.0]])
    d = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    count, t, _ = march(library, CONFIG, BOX, full, o, d)
    assert count[:3].tolist() == [0, 0, 0]
    assert float(t[3, count[3] - 1]) <= 1.3


def test_steps_of_an_unbounded_ray_cover_it(library: NativeLibrary) -> None:
    full = pack(library, torch.ones(32, 32, 32, dtype=torch.bool))
    o, d = torch.zeros(1, 3), torch.tensor([[1.0, 0.0, 0.0]])
    count, t, dt = march(library, CONFIG, WORLD, full, o, d)
    assert int(count) == CONFIG.steps
    gaps = t[0, 1:] - t[0, :-1]
    torch.testing.assert_close(gaps, 0.5 * (dt[0, 1:] + dt[0, :-1]), rtol=2e-3, atol=0.0)


numbers = st.floats(width=32, allow_nan=False, allow_infinity=False)
small = st.floats(-3, 3, width=32)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    ray=st.lists(
        st.one_of(small, numbers, st.sampled_from([0.0, -0.0, 1e-30, 1.3, -1.3])), min_size=6, max_size=6
    ),
    unbounded=st.booleans(),
    share=st.sampled_from([0.0, 0.01, 1.0]),
    cascades=st.sampled_from([1, 2]),
)
def test_any_finite_ray_has_a_bounded_number_of_ordered_samples(
    library: NativeLibrary, ray: list[float], unbounded: bool, share: float, cascades: int
) -> None:
    values = torch.tensor(ray)
    o, d = values[None, :3].contiguous(), values[None, 3:].contiguous()
    grid = pack(library, scattered_cells(0, share, cascades))
    config = replace(CONFIG, cascades=cascades)
    count, t, _ = march(library, config, WORLD if unbounded else BOX, grid, o, d)
    n = int(count)
    assert 0 <= n <= CONFIG.steps
    assert bool((t[0, 1:n] >= t[0, : max(n - 1, 0)]).all())
