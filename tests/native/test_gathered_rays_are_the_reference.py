import pytest
import torch

from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.native_library import NativeLibrary
from mulan.radiance.kernels.ray_gather import PixelTable, gather_rays, gather_rays_reference


def random_table(g: torch.Generator, cut_out: bool = False) -> PixelTable:
    """Three images of two cameras, 20 and 30 pixels."""
    image = torch.tensor([0, 1, 2], dtype=torch.int32).repeat_interleave(torch.tensor([20, 30, 20]))
    T = torch.randn(3, 4, 4, generator=g)
    T[:, :3, :3] = torch.linalg.qr(T[:, :3, :3]).Q
    return PixelTable(
        torch.randint(256, (70, 3), generator=g, dtype=torch.uint8),
        torch.rand(70, generator=g),
        image,
        torch.randn(50, 3, generator=g),
        torch.tensor([0, 0, -50]),  # the third image has the first one's camera
        T,
        torch.randint(256, (70,), generator=g, dtype=torch.uint8) if cut_out else None,
    )


@pytest.mark.parametrize("cut_out", [False, True])
def test_rays_of_pixels_are_the_references(library: NativeLibrary, cut_out: bool) -> None:
    g = torch.Generator().manual_seed(0)
    table = random_table(g, cut_out)
    pixel = torch.randint(70, (500,), generator=g)
    got, want = gather_rays(table, pixel, library), gather_rays_reference(table, pixel)
    for name in RayBatch.__dataclass_fields__:
        torch.testing.assert_close(getattr(got, name), getattr(want, name), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("wrong", [-1, 70])
def test_pixels_out_of_range_are_refused(library: NativeLibrary, wrong: int) -> None:
    table = random_table(torch.Generator().manual_seed(0))
    with pytest.raises(ValueError, match="refused"):
        gather_rays(table, torch.tensor([3, wrong]), library)


def test_no_pixels_give_no_rays(library: NativeLibrary) -> None:
    table = random_table(torch.Generator().manual_seed(0))
    assert len(gather_rays(table, torch.zeros(0, dtype=torch.long), library).weights) == 0
