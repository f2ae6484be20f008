import math

import torch

from mulan.radiance.kernels.composite import blend_weights, composite, transmittance

RAY = torch.tensor([0, 0, 0, 2, 2, 3])
DEPTH = torch.tensor([0.1, 0.7, 0.3, 2.0, 0.5, 0.0], dtype=torch.float64)


def test_transmittance_is_exponential_of_earlier_depth_and_restarts_each_ray():
    expected = torch.exp(-torch.tensor([0.0, 0.1, 0.8, 0.0, 2.0, 0.0], dtype=torch.float64))
    torch.testing.assert_close(transmittance(DEPTH, RAY), expected)


def test_opacity_and_colour_match_the_closed_form_of_a_uniform_slab():
    n, density, length = 400, 1.7, 2.0
    blend = blend_weights(torch.full((n,), density * length / n), torch.zeros(n, dtype=torch.long))
    t = (torch.arange(n) + 0.5) * length / n
    out = composite(
        blend, torch.zeros(n, dtype=torch.long), torch.full((n, 3), 0.4), torch.ones(n), t, rays=2
    )
    opacity = 1 - math.exp(-density * length)
    mean_distance = (1 / density - (length + 1 / density) * math.exp(-density * length)) / opacity
    assert math.isclose(out.opacity[0].item(), opacity, rel_tol=1e-5)
    torch.testing.assert_close(out.colour[0], torch.full((3,), 0.4 * opacity))
    assert math.isclose(out.distance_m[0].item(), mean_distance, rel_tol=1e-3)
    assert out.opacity[1] == 0
    assert out.distance_m[1] == 0


def test_rendered_variance_sums_squared_blend_times_variance():
    blend = blend_weights(DEPTH, RAY)
    variance = torch.linspace(1, 2, 6, dtype=torch.float64)
    out = composite(blend, RAY, torch.zeros(6, 3, dtype=torch.float64), variance, DEPTH, rays=4)
    expected = [sum(blend[i] ** 2 * variance[i] for i in range(6) if RAY[i] == r) for r in range(4)]
    torch.testing.assert_close(out.variance, torch.tensor([float(v) for v in expected], dtype=torch.float64))


def test_gradients_match_finite_differences():
    colour = torch.rand(6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))

    def render(depth, colour):
        blend = blend_weights(depth, RAY)
        out = composite(blend, RAY, colour, depth.square(), depth.cumsum(0), rays=4)
        return out.colour, out.opacity, out.variance

    assert torch.autograd.gradcheck(render, (DEPTH.clone().requires_grad_(), colour.requires_grad_()))


def test_one_opaque_ray_does_not_spoil_the_precision_of_the_next():
    depth = torch.tensor([3e6, 0.25, 0.25])
    blend = blend_weights(depth, torch.tensor([0, 1, 1]))
    expected = torch.tensor([1.0, 1 - math.exp(-0.25), math.exp(-0.25) * (1 - math.exp(-0.25))])
    torch.testing.assert_close(blend, expected)
