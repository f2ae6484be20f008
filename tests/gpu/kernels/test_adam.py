import torch

from mulan.radiance.gpu.adam_kernel import adam_step
from mulan.radiance.optimiser_config import OptimiserConfig
from tests.gpu.kernels.place import DEVICE, random


def test_steps_are_those_of_torch():
    value = random(3, 700)
    reference = value.cpu().clone().requires_grad_()
    adam = torch.optim.Adam([reference], lr=0.02, betas=(0.9, 0.99), eps=1e-15)
    moments = torch.zeros(2, 3, 700, device=DEVICE)
    for step in range(1, 4):
        gradient = random(3, 700, seed=step)
        reference.grad = gradient.cpu().clone()
        adam.step()
        adam_step(value, moments, gradient, 0.02, step, OptimiserConfig(beta2=0.99))
        assert not gradient.any()
    torch.testing.assert_close(value.cpu(), reference.detach(), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(moments[0].cpu(), adam.state[reference]["exp_avg"], rtol=1e-5, atol=1e-7)


def test_untouched_numbers_and_levels_of_weight_zero_stay():
    before = random(3, 700)
    value, moments = before.clone(), random(2, 3, 700, seed=1).abs()
    kept = moments.clone()
    gradient = random(3, 700, seed=2)
    gradient[0, ::2] = 0.0
    weight = torch.tensor([1.0, 0.0, 0.5], device=DEVICE)
    adam_step(value, moments, gradient, 0.02, 1, OptimiserConfig(), skip_untouched=True, level_weight=weight)
    moved = value != before
    assert not moved[0, ::2].any()
    assert moved[0, 1::2].all()
    assert not moved[1].any()
    assert moved[2].all()
    assert torch.equal(moments[:, 0, ::2], kept[:, 0, ::2])
    assert torch.equal(moments[:, 1], kept[:, 1])
