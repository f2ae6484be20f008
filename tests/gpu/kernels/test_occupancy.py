import pytest
import torch

from mulan.radiance.config import MarchConfig
from mulan.radiance.gpu.gpu_occupancy import GpuGrid
from mulan.radiance.kernels.cascades import cell_at, consulted_cells
from mulan.radiance.kernels.march import bounded_step_m
from tests.gpu.kernels.blocks import CONFIG
from tests.gpu.kernels.place import BOX, DEVICE, WORLD
from tests.gpu.kernels.test_march import uniform

MARCH = MarchConfig(steps=48, occupancy_resolution=8, occupancy_threshold=0.5)


def half_full(unit: torch.Tensor, count: int) -> torch.Tensor:
    """Dense for z above one half, on [3, room] points."""
    assert count <= unit.shape[1]
    return torch.where(unit[2] > 0.5, 1e4, 0.0)


def test_a_refresh_takes_the_density_at_one_point_of_each_cell():
    grid, seen = GpuGrid(MARCH, BOX, CONFIG, DEVICE), []

    def record(unit: torch.Tensor, count: int) -> torch.Tensor:
        seen.append(unit[:, :count].cpu())
        return unit[0] * 2

    grid.refresh(record, seed=12345678901234)
    (points,) = seen
    cell = torch.arange(8**3)
    corner = torch.stack([cell % 8, cell // 8 % 8, cell // 64])
    place = points * 8 - corner
    assert ((place > -1e-5) & (place < 1 + 1e-5)).all()
    for cell_number in (0, 77, 511):
        for axis in range(3):
            want = uniform(12345678901234, cell_number, axis + 1)
            assert float(place[axis, cell_number]) == pytest.approx(want, abs=1e-5)
    want = points[0] * 2 * bounded_step_m(MARCH, BOX) / BOX.radius_m
    torch.testing.assert_close(grid.opacity.cpu().view(-1), want)
    assert grid.occupied.all()  # nothing is switched off before the grid is warm


@pytest.mark.parametrize("space", [BOX, WORLD], ids=["bounded", "unbounded"])
def test_empty_cells_are_switched_off_once_the_grid_is_warm(space):
    grid = GpuGrid(MARCH, space, CONFIG, DEVICE)
    for refresh in range(CONFIG.occupancy.warm_up_refreshes):
        assert not grid.is_warm
        grid.refresh(half_full, refresh)
    assert grid.is_warm
    assert grid.occupied[0, 4:].all()
    assert not grid.occupied[0, :4].any()
    before = grid.opacity.clone()
    grid.refresh(lambda unit, _: torch.zeros_like(unit[0]), 0)
    share = float((grid.opacity[0, 4:] < before[0, 4:]).float().mean())
    assert 0.5 <= share < 0.7  # half of the occupied cells, and an eighth of all


def test_cells_that_a_finer_cascade_covers_are_never_visited():
    march = MarchConfig(steps=48, occupancy_resolution=16, cascades=2)
    grid, consulted = GpuGrid(march, WORLD, CONFIG, DEVICE), consulted_cells(march)
    seen = []

    def record(unit: torch.Tensor, count: int) -> torch.Tensor:
        seen.append(unit[:, :count].cpu())
        return torch.ones_like(unit[0])

    grid.refresh(record, seed=5)
    assert torch.equal(grid.opacity.cpu() > 0, consulted)
    assert grid.occupied_share == 1
    # every point lies in the cell it stands for
    assert torch.equal(cell_at(seen[0].unbind(0), 2, 16), consulted.view(-1).nonzero()[:, 0].int())
