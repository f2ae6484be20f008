"""The fused step against the same loss in double precision by autograd, at the same sample distances."""

import numpy as np
import pytest
import torch
from torch import Tensor

from mulan.geometry import se3
from mulan.radiance.kernels.native_buffers import address, native_field, native_scene
from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import (
    NativeGradients,
    NativeObjective,
    NativeParameters,
    NativePoses,
    NativeStepReport,
)
from mulan.radiance.loss import GaussianLikelihoodLoss, HuberLoss
from tests.native import reference
from tests.native.fields import FIELD, native_rays
from tests.native.step_problem import MARCH, RAYS, Costs, make_problem, native_answer

PLAIN = Costs()
# the rays of a pixel share one, whether a pixel has one or three rays
BACKGROUNDS = torch.rand(RAYS // 3, 3, generator=torch.Generator().manual_seed(1)).repeat_interleave(3, 0)
COSTS = {
    "squared": PLAIN,
    "huber": Costs(HuberLoss(0.2)),
    "likelihood": Costs(GaussianLikelihoodLoss()),
    "distortion": Costs(distortion=0.5),
    "entropy": Costs(entropy=0.1),
    "random background": Costs(GaussianLikelihoodLoss(), 0.3, 0.2, BACKGROUNDS),
}


def relative(got: Tensor, want: Tensor) -> float:
    return float((got.double() - want).norm() / want.norm())


@pytest.mark.parametrize("rays_a_pixel", [1, 3])
@pytest.mark.parametrize("costs", COSTS.values(), ids=COSTS.keys())
@pytest.mark.parametrize("unbounded", [False, True], ids=["bounded", "unbounded"])
def test_all_gradients_match_autograd(
    build: NativeLibrary, unbounded: bool, costs: Costs, rays_a_pixel: int
) -> None:
    p = make_problem(build, unbounded, rays_a_pixel)
    leaves = [x.double().requires_grad_() for x in (p.table, p.networks, p.origins, p.directions)]
    total, plain, colours = p.reference_loss(leaves[0], leaves[1], leaves[2], leaves[3], costs)
    total.backward()
    got = native_answer(build, p, costs)
    assert got.report.loss == pytest.approx(float(plain.detach()), rel=1e-4)
    assert got.report.rays == RAYS - 6
    marched = int(p.count[6:].sum())
    # an unbounded ray's unreached samples are forgotten before they are counted
    assert 0 < got.report.kept < marched
    assert got.report.samples == (got.report.kept if unbounded else marched)
    used = p.weights > 0
    torch.testing.assert_close(got.colour[used], colours[used].float().detach(), rtol=1e-4, atol=1e-4)
    errors = [
        relative(mine, reference.gradient(leaf))
        for mine, leaf in zip((got.table, got.networks, got.origins, got.directions), leaves, strict=True)
    ]
    assert max(errors[:2]) < 1e-3
    # near a cell's wall single precision may take the neighbour's slope
    assert max(errors[2:]) < 2e-2


def test_the_variance_head_teaches_nothing_to_the_rest(library: NativeLibrary) -> None:
    p = make_problem(library, False)
    leaves = [x.double().requires_grad_() for x in (p.table, p.networks)]
    _, plain, _ = p.reference_loss(leaves[0], leaves[1], p.origins.double(), p.directions.double(), PLAIN)
    plain.backward()
    got = native_answer(library, p, PLAIN)
    head = FIELD.width + FIELD.geometry_features
    assert relative(got.table, reference.gradient(leaves[0])) < 1e-3
    assert relative(got.networks[:-head], reference.gradient(leaves[1])[:-head]) < 1e-3
    assert got.networks[-head:].abs().max() > 0


def test_pose_gradients_match_finite_differences_of_the_loss(library: NativeLibrary) -> None:
    """Two cameras moved by T exp(xi), samples' distances held."""
    p = make_problem(library, False)
    rng = np.random.default_rng(0)
    poses = se3.exp(rng.normal(size=(2, 6)))
    image = torch.arange(RAYS) % 2
    d_camera = np.stack([poses[i, :3, :3].T @ x for i, x in zip(image, p.directions.numpy(), strict=True)])
    o = p.origins.double().numpy()
    answer = native_answer(library, p, PLAIN)
    R = torch.tensor(poses[:, :3, :3], dtype=torch.float32).contiguous()
    out = torch.zeros(2, 6)
    check(
        library.functions.mulan_pose_gradients(
            RAYS,
            address(p.directions),
            address(answer.origins),
            address(answer.directions),
            NativePoses(2, address(image), address(R), address(out)),
        )
    )

    @torch.no_grad()
    def loss(xi: np.ndarray) -> float:
        delta = se3.exp(xi)
        R_moved = poses[:, :3, :3] @ delta[:, :3, :3]
        shift = (poses[:, :3, :3] @ delta[:, :3, 3, None])[..., 0]
        turned = np.stack([R_moved[i] @ d for i, d in zip(image, d_camera, strict=True)])
        moved = torch.tensor(o + shift[image.numpy()])
        return float(
            p.reference_loss(p.table.double(), p.networks.double(), moved, torch.tensor(turned), PLAIN)[1]
        )

    step = 1e-6
    for camera in range(2):
        for axis in range(6):
            xi = np.zeros((2, 6))
            xi[camera, axis] = step
            slope = (loss(xi) - loss(-xi)) / (2 * step)
            assert float(out[camera, axis]) == pytest.approx(
                slope, rel=2e-2, abs=2e-2 * float(out.abs().max())
            )


def test_gradients_are_equal_bit_for_bit_at_any_number_of_threads(build: NativeLibrary) -> None:
    p = make_problem(build, False)
    one, three = native_answer(build, p, PLAIN, threads=1), native_answer(build, p, PLAIN, threads=3)
    assert one.report.loss == three.report.loss
    for name in ("colour", "table", "networks", "origins", "directions"):
        assert torch.equal(getattr(one, name), getattr(three, name))


def test_a_given_colour_gradient_takes_the_place_of_the_loss(library: NativeLibrary) -> None:
    p = make_problem(library, True)
    leaves = [x.double().requires_grad_() for x in (p.origins, p.directions)]
    _, _, colours = p.reference_loss(p.table.double(), p.networks.double(), leaves[0], leaves[1], PLAIN)
    upstream = torch.randn(RAYS, 3, generator=torch.Generator().manual_seed(0))
    colours.backward(upstream.double())
    got = [torch.zeros(RAYS, 3), torch.zeros(RAYS, 3)]
    c = library.functions
    workspace = c.mulan_workspace_create(1)
    check(
        c.mulan_gradients(
            workspace,
            native_field(FIELD),
            native_scene(MARCH, p.space, True),
            p.grid.native,
            NativeParameters(address(p.table), address(p.networks)),
            native_rays(p.origins, p.directions),
            NativeObjective(colour_gradient=address(upstream), rays_a_pixel=1),
            NativeGradients(origins=address(got[0]), directions=address(got[1])),
            None,
            NativeStepReport(),
        )
    )
    c.mulan_workspace_destroy(workspace)
    assert relative(got[0], reference.gradient(leaves[0])) < 2e-2
    assert relative(got[1], reference.gradient(leaves[1])) < 2e-2
