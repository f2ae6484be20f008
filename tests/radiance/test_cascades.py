import pytest
import torch

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels.cascades import cell_at, consulted_cells, unit_points
from mulan.radiance.kernels.march import march_rays
from mulan.radiance.occupancy import OccupancyGrid
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine

BOX = SceneSpace((0.0, 0.0, 0.0), 1.0, unbounded=False)
MARCH = MarchConfig(steps=64, occupancy_resolution=16, cascades=3)


def test_a_point_is_found_in_the_finest_cascade_that_holds_it():
    unit = torch.tensor([[0.5, 0.5, 0.61], [0.5, 0.5, 0.63], [0.26, 0.5, 0.5], [0.2, 0.5, 0.5], [1.0, 0, 7]])
    cascade = cell_at(unit.unbind(-1), 3, 16) // 16**3
    assert cascade.tolist() == [0, 1, 1, 2, 2]


def test_every_consulted_cell_holds_the_points_drawn_in_it():
    consulted = consulted_cells(MARCH).view(-1).nonzero()[:, 0]
    within = torch.rand(len(consulted), 3, generator=torch.Generator().manual_seed(0)) * 0.98 + 0.01
    unit = unit_points(consulted, within, 3, 16)
    assert torch.equal(cell_at(unit.unbind(-1), 3, 16).long(), consulted)


def test_the_consulted_cells_fill_the_cube_once():
    volume = (consulted_cells(MARCH).sum((1, 2, 3)) * torch.tensor([1 / 64, 1 / 8, 1.0])).sum() / 16**3
    assert volume == pytest.approx(1 / 64 * 1 + 1 / 8 * 7 / 8 + 7 / 8)


def test_full_cascades_give_the_samples_of_one_full_grid():
    g = torch.Generator().manual_seed(0)
    origins = 3 * torch.nn.functional.normalize(torch.randn(50, 3, generator=g), dim=-1)
    directions = torch.nn.functional.normalize(torch.rand(50, 3, generator=g) - 0.5 - origins, dim=-1)
    one = MarchConfig(steps=64, occupancy_resolution=16)
    jitter = torch.rand(50, generator=g)
    a, b = (march_rays(origins, directions, BOX, m, consulted_cells(m), jitter) for m in (one, MARCH))
    assert torch.equal(a.distance_m, b.distance_m)


def test_a_finer_cascade_tells_apart_what_one_cell_of_the_coarse_grid_holds():
    """Matter in one fine cell switches that cell on and not its neighbours."""
    grid = OccupancyGrid(MARCH, BOX, warm_up=1)
    generator = torch.Generator().manual_seed(0)
    cells = grid.choose_cells(generator)
    unit = grid.points_in(cells, generator)
    matter = ((unit - 0.5).abs() < 1 / 64).all(-1)  # the 8 finest cells about the centre
    grid.refresh(cells, unit, torch.where(matter, 1e3, 0.0))
    assert grid.occupied.sum((1, 2, 3)).tolist() == [8, 0, 0]


def test_cells_that_are_not_consulted_stay_off():
    grid = OccupancyGrid(MARCH, BOX, warm_up=1)
    generator = torch.Generator().manual_seed(0)
    for _ in range(3):
        cells = grid.choose_cells(generator)
        grid.refresh(cells, grid.points_in(cells, generator), torch.full((len(cells),), 1e3))
    assert torch.equal(grid.occupied, consulted_cells(MARCH))


def test_a_state_with_another_number_of_cascades_is_refused_by_name():
    field = FieldConfig(levels=2, log2_table_size=8, finest_resolution=32)
    one, three = (
        TorchEngine(field, MarchConfig(occupancy_resolution=16, cascades=k), BOX, True) for k in (1, 3)
    )
    with pytest.raises(ValueError, match=r"'occupancy.opacity' has shape \(1, 16, 16, 16\)"):
        three.load_state(one.state())
    old = one.state()
    old["occupancy.opacity"] = old["occupancy.opacity"][0]  # as it was saved before there were cascades
    with pytest.raises(ValueError, match=r"'occupancy.opacity' has shape \(16, 16, 16\)"):
        one.load_state(old)


@pytest.mark.parametrize(
    "options", [{"cascades": 0}, {"cascades": 9}, {"cascades": 2, "occupancy_resolution": 24}]
)
def test_grids_that_do_not_nest_are_refused(options):
    with pytest.raises(ValueError, match="cascades"):
        MarchConfig(**options)
