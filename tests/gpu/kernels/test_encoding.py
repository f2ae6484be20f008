import torch

from mulan.radiance.gpu.hash_kernels import GpuEncoding
from mulan.radiance.kernels.hash_encoding import encode_reference
from tests.gpu.kernels.blocks import CONFIG
from tests.gpu.kernels.place import DEVICE, FIELD, random

POINTS, ROOM = 300, 512


def test_values_and_both_gradients_are_the_references():
    g = torch.Generator().manual_seed(0)
    points = torch.rand(POINTS, 3, generator=g).requires_grad_()
    points.data[0], points.data[1] = 0.0, 1.0  # both ends of the cube
    table = random(4, 512, 2).cpu().requires_grad_()
    want = encode_reference(points, table, FIELD)
    upstream = random(POINTS, 8, seed=1)
    want.backward(upstream.cpu())
    unit, gradient = torch.zeros(3, ROOM, device=DEVICE), torch.zeros(8, ROOM, device=DEVICE)
    unit[:, :POINTS], gradient[:, :POINTS] = points.detach().T.to(DEVICE), upstream.T
    gradient[:, POINTS:] = torch.nan  # beyond the count nothing is read
    encoding = GpuEncoding(FIELD, CONFIG, DEVICE)
    on_device, count = table.detach().to(DEVICE), torch.tensor([POINTS], dtype=torch.int32, device=DEVICE)
    got = encoding.encode(unit, on_device, POINTS)
    torch.testing.assert_close(got[:, :POINTS].T.cpu(), want, rtol=1e-5, atol=1e-5)
    to_table = torch.zeros_like(on_device)
    encoding.scatter(unit, gradient, count, to_table)
    torch.testing.assert_close(to_table.cpu(), table.grad, rtol=1e-4, atol=1e-4)
    to_points = encoding.point_gradients(unit, on_device, gradient, count)
    torch.testing.assert_close(to_points[:, :POINTS].T.cpu(), points.grad, rtol=1e-3, atol=1e-3)


def test_a_level_of_weight_zero_neither_acts_nor_learns():
    encoding = GpuEncoding(FIELD, CONFIG, DEVICE)
    encoding.level_weight.copy_(torch.tensor([1.0, 0.5, 0.0, 1.0]))
    table, unit = random(4, 512, 2), torch.rand(3, ROOM, device=DEVICE)
    got = encoding.encode(unit, table, POINTS)[:, :POINTS]
    encoding.level_weight.fill_(1.0)
    plain = encoding.encode(unit, table, POINTS)[:, :POINTS]
    torch.testing.assert_close(got[2:4], 0.5 * plain[2:4])
    assert not got[4:6].any()
    encoding.level_weight.copy_(torch.tensor([1.0, 0.5, 0.0, 1.0]))
    to_table = torch.zeros_like(table)
    count = torch.tensor([POINTS], dtype=torch.int32, device=DEVICE)
    encoding.scatter(unit, torch.ones(8, ROOM, device=DEVICE), count, to_table)
    assert not to_table[2].any()
    torch.testing.assert_close(
        to_table[1].sum(), torch.tensor(POINTS * 1.0, device=DEVICE)
    )  # 2 features × 0.5
