import math

import pytest
import torch

from mulan.radiance.background import random_background
from mulan.radiance.kernels.composite import blend_weights
from mulan.radiance.kernels.distortion import distortion
from mulan.radiance.loss import (
    GaussianLikelihoodLoss,
    HuberLoss,
    SquaredLoss,
    gaussian_likelihood,
    opacity_entropy,
)

RAY = torch.tensor([0, 0, 0, 0, 2, 2, 3])
PLACE = torch.tensor([0.1, 0.3, 0.35, 0.9, 0.2, 0.6, 0.5], dtype=torch.float64)
BLEND = torch.tensor([0.2, 0.05, 0.3, 0.4, 0.6, 0.3, 0.9], dtype=torch.float64)
ERROR = torch.tensor([[0.05, -0.4, 0.2], [0.0, 0.3, -0.02]], dtype=torch.float64)


def test_distortion_in_one_pass_is_the_double_sum_of_its_equation():
    step = 0.02
    expected = []
    for ray in range(4):
        w, s = BLEND[ray == RAY], PLACE[ray == RAY]
        pairs = sum(w[i] * w[j] * abs(s[i] - s[j]) for i in range(len(w)) for j in range(len(w)))
        expected.append(float(pairs + (w**2).sum() * step / 3))
    got = distortion(BLEND, RAY, PLACE, step, rays=4)
    torch.testing.assert_close(got, torch.tensor(expected, dtype=torch.float64))


def test_gradient_of_the_distortion_matches_finite_differences():
    blend = BLEND.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda w: distortion(w, RAY, PLACE, 0.02, 4), blend)
    depth = torch.linspace(0.1, 2, 7, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: distortion(blend_weights(x, RAY), RAY, PLACE, 0.02, 4), depth)


def test_a_ray_whose_weight_is_in_one_place_is_less_distorted_than_fog():
    fog, index = torch.full((100,), 0.01), torch.zeros(100, dtype=torch.long)
    place = torch.linspace(0, 1, 100)
    wall = torch.zeros(100)
    wall[40:42] = 0.5
    fog_cost, wall_cost = (float(distortion(w, index, place, 0.01, 1)) for w in (fog, wall))
    assert wall_cost < 0.05 * fog_cost
    assert fog_cost == pytest.approx(1 / 3, rel=0.02)


def test_costs_are_those_of_their_equations():
    variance = torch.tensor([0.01, 0.2], dtype=torch.float64)
    squared = ERROR.square().mean(-1)
    torch.testing.assert_close(SquaredLoss()(ERROR, variance), squared)
    huber = HuberLoss(0.1)(ERROR, variance)
    expected = (0.05**2 + 0.1 * (0.8 - 0.1) + 0.1 * (0.4 - 0.1)) / 3
    assert float(huber[0]) == pytest.approx(expected)
    normal = torch.distributions.Normal(torch.zeros(2, 3), variance.sqrt()[:, None])
    likelihood = -normal.log_prob(ERROR).mean(-1) - 0.5 * math.log(2 * math.pi)
    torch.testing.assert_close(GaussianLikelihoodLoss()(ERROR, variance), likelihood)


@pytest.mark.parametrize("loss", [SquaredLoss(), HuberLoss(0.1), GaussianLikelihoodLoss()])
def test_gradients_of_the_costs_match_finite_differences(loss):
    variance = torch.tensor([0.01, 0.2], dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda e, v: loss(e, v + 0 * e.sum()), (ERROR.clone().requires_grad_(), variance)
    )


def test_the_likelihood_is_best_where_the_variance_is_the_squared_error():
    variance = torch.linspace(0.01, 0.2, 400)
    best = variance[gaussian_likelihood(torch.full((400,), 0.07), variance).argmin()]
    assert float(best) == pytest.approx(0.07, abs=1e-3)


def test_opacity_entropy_is_greatest_at_a_half_and_its_gradient_is_right():
    opacity = torch.tensor([0.0, 0.2, 0.5, 0.8, 1.0], dtype=torch.float64)
    entropy = opacity_entropy(opacity)
    assert float(entropy[2]) == pytest.approx(math.log(2))
    assert entropy[0] < entropy[1] < entropy[2] > entropy[3] > entropy[4]
    assert torch.autograd.gradcheck(opacity_entropy, opacity[1:4].clone().requires_grad_())


def test_a_corner_of_zero_is_refused():
    with pytest.raises(ValueError, match="positive"):
        HuberLoss(0.0)


def test_targets_on_a_random_background_are_the_object_over_it():
    object_colour, opacity = torch.tensor([[0.2, 0.4, 0.6]] * 3), torch.tensor([1.0, 0.5, 0.0])
    white = torch.ones(3)
    over_white = object_colour * opacity[:, None] + (1 - opacity)[:, None] * white
    drawn, target = random_background(over_white, opacity, white, torch.Generator().manual_seed(0))
    torch.testing.assert_close(target, object_colour * opacity[:, None] + (1 - opacity)[:, None] * drawn)
    assert len(drawn.unique(dim=0)) == 3
    with pytest.raises(ValueError, match="opacity"):
        random_background(over_white, None, white, torch.Generator())
