from dataclasses import replace

import pytest
import torch

from mulan.radiance.gpu.composite_backward_kernel import SampleGradients
from mulan.radiance.gpu.gpu_networks import GpuNetworks
from mulan.radiance.gpu.launch import MatrixPrecision
from mulan.radiance.gpu.ray_kernels import direction_harmonics
from mulan.radiance.gpu.reach_kernels import ReachedSamples
from mulan.radiance.kernels.spherical_harmonics import spherical_harmonics
from mulan.radiance.native_engine import NETWORKS
from mulan.radiance.networks import RadianceField
from tests.gpu.kernels.blocks import BLOCKS, CONFIG
from tests.gpu.kernels.place import DEVICE, FIELD, random, rays, relative_error
from tests.native.reference import gradient

MARCHED, REACHED, ROOM, RAYS = 700, 500, 1024, 20
KINK = 0.01  # of a layer's spread; a ReLU nearer to its kink falls to either side by rounding


class Problem:
    """Samples of some rays, not all of them reached, and the reference's answer with its gradients."""

    def __init__(self, variance_teaches: bool = False) -> None:
        self.variance_teaches = variance_teaches
        self.field = RadianceField(FIELD, torch.Generator().manual_seed(1))
        with torch.no_grad():
            self.field.density_hidden.mul_(2)
            self.field.variance_out.mul_(20)
        self.flat = torch.cat([getattr(self.field, name).detach().flatten() for name in NETWORKS]).to(DEVICE)
        self.encoded, self.directions = random(FIELD.encoded_width, ROOM), rays(RAYS)[1]
        source = torch.arange(ROOM, dtype=torch.int32, device=DEVICE) * MARCHED // ROOM
        self.ray = (torch.arange(ROOM, dtype=torch.int32, device=DEVICE) * RAYS // ROOM).contiguous()
        offsets = torch.tensor([0, REACHED], dtype=torch.int32, device=DEVICE)
        per_sample = torch.zeros(ROOM, device=DEVICE)
        self.reached = ReachedSamples(
            offsets, source, self.ray, per_sample, per_sample, torch.zeros(3, ROOM, device=DEVICE)
        )
        self.harmonics = direction_harmonics(self.directions, FIELD.harmonics_degree)
        self.gradients = SampleGradients(*(random(*shape, seed=7) for shape in ((3, ROOM), (ROOM,), (ROOM,))))
        self.inputs = self.encoded[:, source[:REACHED].long()].T.cpu().requires_grad_()
        self.bands = spherical_harmonics(self.directions.cpu(), FIELD.harmonics_degree)
        self.bands = self.bands[self.ray[:REACHED].cpu().long()].requires_grad_()
        self.at_a_kink = torch.zeros(REACHED, dtype=torch.bool)
        self.evaluate()

    def relu(self, before: torch.Tensor) -> torch.Tensor:
        self.at_a_kink |= (before.detach().abs() < KINK * before.detach().std()).any(-1)
        return before.relu()

    def evaluate(self) -> None:
        f, linear = self.field, torch.nn.functional.linear
        hidden = self.relu(linear(self.inputs, f.density_hidden))
        features = linear(hidden, f.density_out)
        first = self.relu(linear(torch.cat([self.bands, features], -1), f.colour_hidden_0))
        logits = linear(self.relu(linear(first, f.colour_hidden_1)), f.colour_out)
        self.density, self.colour = torch.exp(features[:, 0] - 1.5), logits.sigmoid()
        self.variance = f.variance(hidden, features, self.variance_teaches)
        assert 100 < self.at_a_kink.sum() < REACHED - 100
        for x in (self.gradients.logits, self.gradients.log_density, self.gradients.variance):
            x[..., :REACHED][..., self.at_a_kink.to(DEVICE)] = 0
        upstream = [
            x[..., :REACHED].cpu() for x in (self.gradients.logits.T[:REACHED].T, self.gradients.log_density)
        ]
        total = (logits * upstream[0].T).sum() + (features[:, 0] * upstream[1]).sum()
        (total + (self.variance * self.gradients.variance[:REACHED].cpu()).sum()).backward()


@pytest.fixture(scope="module")
def problem():
    return Problem()


@pytest.mark.parametrize(
    ("precision", "tolerance"),
    # TF32 keeps 10 bits on a GPU; the interpreter multiplies in full float32
    [(MatrixPrecision.FP32, 1e-5), (MatrixPrecision.TF32, 4e-3), (MatrixPrecision.BF16, 4e-2)],
)
def test_values_and_all_gradients_are_the_references(problem, precision, tolerance):
    # several blocks a program
    sizes = replace(BLOCKS, matrix_samples=min(256, BLOCKS.matrix_samples))
    networks = GpuNetworks(FIELD, replace(CONFIG, precision=precision, blocks=sizes))
    encoded = problem.encoded.to(precision.storage)
    density = networks.density(
        problem.encoded[:, problem.reached.source.long()].to(encoded.dtype), problem.flat, REACHED
    )
    assert relative_error(density[:REACHED], problem.density.detach()) < tolerance
    seen = networks.colour(encoded, problem.reached, problem.harmonics, problem.flat)
    assert relative_error(seen.colour[:, :REACHED].T, problem.colour.detach()) < tolerance
    assert relative_error(seen.variance[:REACHED], problem.variance.detach()) < tolerance
    got = networks.backward(
        encoded,
        problem.reached,
        problem.harmonics,
        problem.flat,
        seen,
        problem.gradients,
        learn=True,
        rays=True,
        variance_teaches=False,
    )
    # the interpreter truncates to bf16, a GPU rounds
    tolerance *= 4
    assert relative_error(got.encoded[:, :REACHED].T, gradient(problem.inputs)) < tolerance
    assert got.harmonics is not None
    assert relative_error(got.harmonics[:9, :REACHED].T, gradient(problem.bands)) < tolerance
    assert got.parameters is not None
    parts = got.parameters.split([getattr(problem.field, name).numel() for name in NETWORKS])
    for name, part in zip(NETWORKS, parts, strict=True):
        want = gradient(getattr(problem.field, name))
        assert relative_error(part.view_as(want), want) < tolerance, name


def test_gradients_to_rays_alone_are_those_of_the_whole(problem):
    networks = GpuNetworks(FIELD, CONFIG)
    arguments = problem.encoded, problem.reached, problem.harmonics, problem.flat
    seen = networks.colour(*arguments)
    got = networks.backward(
        *arguments, seen, problem.gradients, learn=False, rays=True, variance_teaches=False
    )
    assert got.parameters is None
    assert relative_error(got.encoded[:, :REACHED].T, gradient(problem.inputs)) < 1e-4
    assert got.harmonics is not None
    assert relative_error(got.harmonics[:9, :REACHED].T, gradient(problem.bands)) < 1e-4


def test_a_variance_that_teaches_reaches_the_trunk():
    problem, networks = Problem(variance_teaches=True), GpuNetworks(FIELD, CONFIG)
    arguments = problem.encoded, problem.reached, problem.harmonics, problem.flat
    seen = networks.colour(*arguments)
    for learn in (True, False):
        got = networks.backward(
            *arguments, seen, problem.gradients, learn=learn, rays=False, variance_teaches=True
        )
        assert relative_error(got.encoded[:, :REACHED].T, gradient(problem.inputs)) < 1e-4
