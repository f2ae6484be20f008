import pytest
import torch

from mulan.radiance.config import FieldConfig
from mulan.radiance.kernels.hash_encoding import HashEncoding, corner_index, encode_reference

SMALL = FieldConfig(levels=4, log2_table_size=7, base_resolution=3, finest_resolution=24)


def inputs(points=12, seed=0):
    g = torch.Generator().manual_seed(seed)
    table = torch.rand(4, 128, 2, generator=g, dtype=torch.float64)
    return torch.rand(points, 3, generator=g, dtype=torch.float64), table


def test_small_config_has_dense_and_hashed_levels():
    assert [SMALL.level_is_dense(level) for level in range(4)] == [True, False, False, False]


def test_tuned_path_equals_reference_in_value_and_gradients():
    points, table = inputs(200)
    points[0], points[1] = 0.0, 1.0  # both ends of the cube belong to it
    results = []
    for encode in (lambda p, t: encode_reference(p, t, SMALL), HashEncoding(SMALL)):
        p, t = points.clone().requires_grad_(), table.clone().requires_grad_()
        value = encode(p, t)
        value.sin().sum().backward()
        results.append((value.detach(), p.grad, t.grad))
    for mine, reference in zip(*results, strict=True):
        torch.testing.assert_close(mine, reference)


TINY = FieldConfig(levels=2, log2_table_size=3, base_resolution=1, finest_resolution=5)


@pytest.mark.parametrize("encode", [lambda p, t: encode_reference(p, t, TINY), HashEncoding(TINY)])
def test_gradients_to_points_and_table_match_finite_differences(encode):
    assert [TINY.level_is_dense(level) for level in range(2)] == [True, False]
    points, table = inputs(5)[0], inputs()[1][:2, :8].clone()
    assert torch.autograd.gradcheck(encode, (points.requires_grad_(), table.requires_grad_()))


def test_encoding_at_a_grid_corner_is_that_corners_entry():
    _, table = inputs()
    corner = torch.tensor([[1, 2, 3]])
    encoded = HashEncoding(SMALL)(corner.double() / 3, table)
    assert corner_index(corner, 3, True, 128).item() == 1 + 2 * 4 + 3 * 16
    torch.testing.assert_close(encoded[0, :2], table[0, 1 + 2 * 4 + 3 * 16])


def test_hashed_index_is_the_published_hash_in_32_bits():
    x, y, z = 700, 801, 902
    expected = (x ^ (y * 2654435761 % 2**32) ^ (z * 805459861 % 2**32)) % 2**15
    assert corner_index(torch.tensor([[x, y, z]]), 1000, False, 2**15).item() == expected


def test_float32_index_of_a_fine_level_equals_the_reference():
    config = FieldConfig(levels=2, log2_table_size=10, base_resolution=16, finest_resolution=2000)
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(3))
    table = torch.rand(2, 1024, 2, generator=torch.Generator().manual_seed(4))
    torch.testing.assert_close(HashEncoding(config)(points, table), encode_reference(points, table, config))
