import ctypes

import pytest
import torch

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels.native_buffers import address, native_field, native_scene
from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import NativeRendering
from mulan.radiance.space import SceneSpace
from tests.native import reference
from tests.native.fields import FIELD, random_networks, random_table, unit_vectors

G = 300  # more than one tile of samples


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("config", [FIELD, FieldConfig()], ids=["odd sizes", "default sizes"])
def test_encoding_and_its_gradients(build: NativeLibrary, config: FieldConfig) -> None:
    g = seeded()
    table, points = random_table(g, config), torch.rand(G, 3, generator=g)
    points[:3] = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 0.0, 0.5]])  # the cube's rim
    upstream = torch.randn(G, 2 * config.levels, generator=g)
    encoded, to_table, to_points = (
        torch.zeros_like(upstream),
        torch.zeros_like(table),
        torch.zeros_like(points),
    )
    field, c = native_field(config), build.functions
    check(c.mulan_encode(field, address(table), G, address(points), address(encoded)))
    arrays = (address(x) for x in (upstream, to_table, to_points))
    check(c.mulan_encode_backward(field, address(table), G, address(points), *arrays))

    table64, points64 = table.double().requires_grad_(), points.double().requires_grad_()
    expected = reference.encode(points64, table64, config)
    expected.backward(upstream.double())
    # single precision places a point within a cell to 1e-7 * resolution
    torch.testing.assert_close(encoded, expected.float().detach(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(to_table, reference.gradient(table64).float(), rtol=1e-4, atol=3e-4)
    torch.testing.assert_close(to_points[3:], reference.gradient(points64).float()[3:], rtol=1e-3, atol=5e-2)


def test_a_level_of_weight_zero_neither_acts_nor_learns(library: NativeLibrary) -> None:
    g = seeded()
    table, points = random_table(g), torch.rand(50, 3, generator=g)
    field = native_field(FIELD)
    field.level_weight[1], field.level_weight[3] = 0.0, 0.5
    encoded, to_table = torch.zeros(50, 10), torch.zeros_like(table)
    c = library.functions
    check(c.mulan_encode(field, address(table), 50, address(points), address(encoded)))
    ones = torch.ones(50, 10)
    check(
        c.mulan_encode_backward(
            field, address(table), 50, address(points), address(ones), address(to_table), None
        )
    )
    full = reference.encode(points.double(), table.double(), FIELD).float()
    torch.testing.assert_close(encoded[:, 6:8], 0.5 * full[:, 6:8], rtol=1e-4, atol=1e-5)
    assert encoded[:, 2:4].abs().max() == 0
    assert to_table[1].abs().max() == 0
    assert to_table[3].sum() == pytest.approx(0.5 * 50 * 2, rel=1e-4)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_harmonics_and_their_gradient(build: NativeLibrary, degree: int) -> None:
    g = seeded(degree)
    d = unit_vectors(64, g)
    values, upstream = torch.zeros(64, degree**2), torch.randn(64, degree**2, generator=g)
    gradient = torch.zeros_like(d)
    check(build.functions.mulan_harmonics(degree, 64, address(d), address(values)))
    check(
        build.functions.mulan_harmonics_backward(degree, 64, address(d), address(upstream), address(gradient))
    )
    d64 = d.double().requires_grad_()
    expected = reference.harmonics(d64, degree)
    expected.backward(upstream.double())
    torch.testing.assert_close(values, expected.float().detach(), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(gradient, reference.gradient(d64).float(), rtol=1e-5, atol=1e-5)


def test_harmonics_are_orthonormal_on_the_sphere(library: NativeLibrary) -> None:
    n = 20000
    d = unit_vectors(n, seeded())
    values = torch.zeros(n, 16)
    check(library.functions.mulan_harmonics(4, n, address(d), address(values)))
    gram = values.T @ values * (4 * torch.pi / n)
    assert (gram - torch.eye(16)).abs().max() < 0.06


@pytest.mark.parametrize("config", [FIELD, FieldConfig()], ids=["odd sizes", "default sizes"])
def test_networks_and_their_gradients(build: NativeLibrary, config: FieldConfig) -> None:
    g = seeded()
    c, field = build.functions, native_field(config)
    networks = random_networks(g, build, config)
    encoded, d = torch.randn(G, 2 * config.levels, generator=g), unit_vectors(G, g)
    log_density, variance, colour = torch.zeros(G), torch.zeros(G), torch.zeros(G, 3)
    workspace = c.mulan_workspace_create(1)
    inputs = (workspace, field, address(networks), G, address(encoded), address(d))
    check(c.mulan_networks(*inputs, *(address(x) for x in (log_density, colour, variance))))
    up = [torch.randn(*x.shape, generator=g) for x in (log_density, colour, variance)]
    gradients = [torch.zeros_like(x) for x in (networks, encoded, d)]
    check(c.mulan_networks_backward(*inputs, *(address(x) for x in (*up, *gradients))))
    c.mulan_workspace_destroy(workspace)

    leaves = [x.double().requires_grad_() for x in (networks, encoded, d)]
    expected = reference.networks(leaves[0], leaves[1], leaves[2], config)
    torch.autograd.backward(expected, [x.double() for x in up])
    for got, want in zip((log_density, colour, variance), expected, strict=True):
        torch.testing.assert_close(got, want.float().detach(), rtol=1e-4, atol=1e-5)
    for got, leaf in zip(gradients, leaves, strict=True):
        assert (got - reference.gradient(leaf).float()).norm() < 2e-5 * reference.gradient(leaf).norm()


def test_compositing_and_its_gradients(build: NativeLibrary) -> None:
    g = seeded()
    lengths = [0, 1, 2, 37, 150, 5]
    offsets = torch.tensor([0, *lengths]).cumsum(0)
    s = int(offsets[-1])
    density = torch.rand(s, generator=g) * 40
    density[50:] *= 1e-4  # thin samples
    dt = torch.rand(s, generator=g) * 0.02
    t, colour = torch.rand(s, generator=g), torch.rand(s, 3, generator=g)
    variance, blend = torch.rand(s, generator=g), torch.zeros(s)
    out = [torch.zeros(6, 3), torch.zeros(6), torch.zeros(6), torch.zeros(6)]
    scene = native_scene(MarchConfig(), SceneSpace((0.0, 0.0, 0.0), 1.0, False), True)
    rendering = NativeRendering(*(address(x) for x in out))
    c = build.functions
    arrays = [address(x) for x in (offsets, density, dt, t, colour, variance, blend)]
    check(c.mulan_composite(scene, 6, *arrays, rendering))
    upstream = torch.randn(6, 3, generator=g)
    to_density, to_colour = torch.zeros(s), torch.zeros(s, 3)
    arrays = [address(x) for x in (offsets, density, dt, colour, upstream, to_density, to_colour)]
    check(c.mulan_composite_backward(scene, 6, *arrays))

    density64, colour64 = density.double().requires_grad_(), colour.double().requires_grad_()
    for ray in range(6):
        part = slice(int(offsets[ray]), int(offsets[ray + 1]))
        b = reference.blend(density64[part] * dt[part].double(), 1e-4)
        rendered = b @ colour64[part] + 1 - b.sum()
        rendered.backward(upstream[ray].double(), retain_graph=True)
        torch.testing.assert_close(blend[part], b.float().detach(), rtol=2e-5, atol=1e-9)
        torch.testing.assert_close(out[0][ray], rendered.float().detach(), rtol=1e-5, atol=1e-6)
        assert out[2][ray] == pytest.approx(float(b.detach().sum()), abs=1e-5)
        assert out[3][ray] == pytest.approx(
            float((b.detach() ** 2 * variance[part].double()).sum()), rel=1e-4
        )
    torch.testing.assert_close(to_density, reference.gradient(density64).float(), rtol=1e-4, atol=1e-7)
    torch.testing.assert_close(to_colour, reference.gradient(colour64).float(), rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("skip", [0, 1])
def test_adam_is_torchs_and_can_leave_untouched_entries_alone(build: NativeLibrary, skip: int) -> None:
    g = seeded()
    start = torch.randn(1003, generator=g)
    parameter = torch.nn.Parameter(start.double())
    adam = torch.optim.Adam([parameter], lr=0.01, betas=(0.9, 0.99), eps=1e-15)
    value, mean, square = start.clone(), torch.zeros(1003), torch.zeros(1003)
    untouched = torch.arange(1003) % 3 == 0
    for step in range(1, 6):
        gradient = torch.randn(1003, generator=g)
        gradient[untouched] = 0.0 if step > 2 or skip else gradient[untouched]
        parameter.grad = gradient.double()
        adam.step()
        arrays = (address(x) for x in (value, mean, square, gradient))
        check(build.functions.mulan_adam(1003, *arrays, 0.01, 0.9, 0.99, 1e-15, step, skip))
    torch.testing.assert_close(
        value[~untouched], parameter.detach().float()[~untouched], rtol=1e-5, atol=1e-6
    )
    if skip:
        assert torch.equal(value[untouched], start[untouched])
    else:
        torch.testing.assert_close(value, parameter.detach().float(), rtol=1e-5, atol=1e-6)


def test_struct_layouts_agree_with_the_c_header(library: NativeLibrary) -> None:
    """A scene whose last member is nonsense is refused, so the members before it have the library's sizes."""
    scene = native_scene(MarchConfig(), SceneSpace((0.0, 0.0, 0.0), 1.0, False), True)
    scene.occupancy_resolution = 63
    assert library.functions.mulan_composite(scene, 0, 1, *[None] * 6, NativeRendering()) == 1
    scene.occupancy_resolution = 64
    assert library.functions.mulan_composite(scene, 0, 1, *[None] * 6, NativeRendering()) == 0
    field = native_field(FIELD)
    assert library.functions.mulan_network_parameters(field) > 0
    assert ctypes.sizeof(field) == 4 * (5 + 3 * 32 + 3)
