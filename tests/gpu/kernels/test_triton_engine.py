from dataclasses import replace

import pytest
import torch

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch
from mulan.radiance.gpu.launch import MatrixPrecision, TritonConfig
from mulan.radiance.gpu.triton_engine import TritonEngine
from mulan.radiance.kernels.native_grid import NativeGridConfig
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.loss import GaussianLikelihoodLoss, HuberLoss
from mulan.radiance.native_engine import NativeConfig, NativeEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine
from tests.gpu.kernels.blocks import blocks
from tests.gpu.kernels.place import DEVICE, relative_error
from tests.native.spheres import batch_around, rays_around

FIELD = FieldConfig(levels=3, log2_table_size=9, base_resolution=8, finest_resolution=32, width=16)
MARCH = MarchConfig(steps=48, occupancy_resolution=16, cascades=2)
GRID = NativeGridConfig(warm_up_refreshes=2)
CONFIG = TritonConfig(
    precision=MatrixPrecision.FP32,
    room=4096,
    occupancy=GRID,
    blocks=blocks(samples=8192, matrix_samples=4096, rays=128, steps=64, matrix_programs=1),
)
PLAIN = OptimiserConfig(occupancy_every=2)
HUBER = OptimiserConfig(
    loss=HuberLoss(0.1),
    entropy_weight=0.01,
    distortion_weight=0.03,
    random_background=True,
    occupancy_every=2,
)
LIKELIHOOD = OptimiserConfig(loss=GaussianLikelihoodLoss(), distortion_weight=0.03, occupancy_every=2)
SPACES = pytest.mark.parametrize(
    "space",
    [SceneSpace((0.0, 0.0, 0.0), 0.8, unbounded) for unbounded in (False, True)],
    ids=["bounded", "unbounded"],
)
BOX = SceneSpace((0.0, 0.0, 0.0), 0.8, False)


def make_engine(
    space: SceneSpace = BOX, config: TritonConfig = CONFIG, optimiser: OptimiserConfig = PLAIN
) -> TritonEngine:
    return TritonEngine(FIELD, MARCH, space, True, 3, DEVICE, optimiser, config)


def learnt_state(space: SceneSpace) -> dict[str, torch.Tensor]:
    """A field the torch engine has trained a little."""
    engine, g = TorchEngine(FIELD, MARCH, space, True, 3), torch.Generator().manual_seed(0)
    for _ in range(120):
        engine.train_step(batch_around(200, g), 1.0)
    return engine.state()


@pytest.fixture(scope="module")
def learnt() -> dict[bool, dict[str, torch.Tensor]]:
    return {
        unbounded: learnt_state(SceneSpace((0.0, 0.0, 0.0), 0.8, unbounded)) for unbounded in (False, True)
    }


@SPACES
def test_answers_are_the_torch_engines(space, learnt):
    engine, reference = make_engine(space), TorchEngine(FIELD, MARCH, space, True)
    engine.load_state(learnt[space.unbounded])
    reference.load_state(learnt[space.unbounded])
    o, d = rays_around(100, torch.Generator().manual_seed(1))
    o[0], d[0] = torch.tensor([3.0, 3.0, 3.0]), torch.tensor([1.0, 0.0, 0.0])  # sees nothing near
    got, want = engine.render(o, d), reference.render(o, d)
    torch.testing.assert_close(got.colour, want.colour, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(got.opacity, want.opacity, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(got.variance, want.variance, rtol=1e-3, atol=1e-5)
    hit = want.opacity > 0.05
    torch.testing.assert_close(got.depth_m[hit], want.depth_m[hit], rtol=1e-3, atol=1e-3)
    points = torch.rand(200, 3, generator=torch.Generator().manual_seed(2)) * 2 - 1
    torch.testing.assert_close(engine.density(points), reference.density(points), rtol=1e-3, atol=1e-4)
    mine, theirs = engine.sample(o, d), reference.sample(o, d)
    assert torch.equal(mine.ray_index, theirs.ray_index)
    for name in ("blend", "colour", "variance", "distance_m"):
        torch.testing.assert_close(getattr(mine, name), getattr(theirs, name), rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("unbounded", "optimiser"),
    [(False, PLAIN), (True, PLAIN), (False, HUBER), (True, LIKELIHOOD)],
    ids=["bounded", "unbounded", "huber, entropy, distortion, random background", "likelihood, distortion"],
)
def test_learning_is_the_native_engines(unbounded, optimiser, learnt):
    """Same samples, same loss, same gradients: steps from one state end in one state but for rounding."""
    library, reason = find_native_library()
    if library is None:
        pytest.skip(f"no native engine to compare with: {reason}")
    space = SceneSpace((0.0, 0.0, 0.0), 0.8, unbounded)
    engine = make_engine(space, optimiser=optimiser)
    native = NativeEngine(
        FIELD, MARCH, space, True, 3, optimiser, NativeConfig(occupancy=GRID), library=library
    )
    engine.load_state(learnt[unbounded])
    native.load_state(engine.state())
    g, R = torch.Generator().manual_seed(8), torch.linalg.qr(torch.randn(2, 3, 3))[0]
    for turn in range(2):
        batch = batch_around(120, g)
        batch.weights[:10] = 0.0
        batch.colours[:10] = torch.nan
        batch = replace(batch, opacity=torch.rand(120, generator=g), image_index=torch.arange(120) % 2)
        if turn == 0:
            mine, to_rays = engine.train_step_with_ray_gradients(batch, 1.0)
            theirs, want = native.train_step_with_ray_gradients(batch, 1.0)
            assert relative_error(to_rays.origins, want.origins) < 2e-3
            assert relative_error(to_rays.directions, want.directions) < 2e-3
        else:
            mine, to_poses = engine.train_step_with_pose_gradients(batch, 1.0, R)
            theirs, want = native.train_step_with_pose_gradients(batch, 1.0, R)
            assert relative_error(to_poses, want) < 5e-3
        assert mine.loss == pytest.approx(theirs.loss, rel=1e-4)
        assert mine.mean_squared_error == pytest.approx(theirs.mean_squared_error, rel=1e-4)
        assert mine.samples == theirs.samples
    a, b = engine.state(), native.state()
    assert a.keys() == b.keys()
    for name in a:
        if a[name].is_floating_point():
            assert relative_error(a[name], b[name]) < 1e-2, name
    assert torch.equal(a["counters"], b["counters"])
    assert torch.equal(a["generator"], b["generator"])
    assert (a["occupancy.occupied"] == b["occupancy.occupied"]).float().mean() > 0.999


def test_every_engine_reads_every_other_ones_state(learnt):
    engine, reference = make_engine(), TorchEngine(FIELD, MARCH, BOX, True)
    state = learnt[False]
    engine.load_state(state)
    given = engine.state()
    assert given.keys() == state.keys()
    assert all(torch.equal(given[name], state[name]) for name in state)
    reference.load_state(given)
    with pytest.raises(ValueError, match="colour_out"):
        engine.load_state({name: tensor for name, tensor in state.items() if name != "colour_out"})


def test_an_untrained_field_is_the_torch_engines():
    mine, theirs = make_engine().state(), TorchEngine(FIELD, MARCH, BOX, True, 3).state()
    assert all(torch.equal(mine[name], theirs[name]) for name in theirs)


def test_waves_learn_the_same_as_one_go(learnt):
    engines = [make_engine(), make_engine(config=replace(CONFIG, wave_rays=40))]
    batch = batch_around(60, torch.Generator().manual_seed(4))
    reports = []
    for engine in engines:
        engine.load_state(learnt[False])
        reports.append(engine.train_step(batch, 1.0))
    assert reports[0].loss == pytest.approx(reports[1].loss, rel=1e-5)
    assert reports[0].samples == reports[1].samples
    a, b = (engine.state() for engine in engines)
    assert relative_error(a["table"], b["table"]) < 1e-3
    assert relative_error(a["exp_avg.colour_hidden_1"], b["exp_avg.colour_hidden_1"]) < 1e-4


def test_ray_gradients_of_a_colour_gradient_leave_the_field_as_it_is(learnt):
    engine = make_engine()
    engine.load_state(learnt[False])
    o, d = rays_around(60, torch.Generator().manual_seed(1))
    upstream = torch.randn(60, 3, generator=torch.Generator().manual_seed(2))
    rendering, gradients = engine.ray_gradients(o, d, upstream)
    torch.testing.assert_close(rendering.opacity, engine.render(o, d).opacity)
    after = engine.state()
    assert all(torch.equal(after[name], learnt[False][name]) for name in after)
    library, _ = find_native_library()
    if library is not None:
        native = NativeEngine(FIELD, MARCH, BOX, True, library=library)
        native.load_state(learnt[False])
        _, want = native.ray_gradients(o, d, upstream)
        assert relative_error(gradients.origins, want.origins) < 2e-3
        assert relative_error(gradients.directions, want.directions) < 2e-3


def test_bad_and_empty_arguments():
    engine = make_engine()
    o, d = rays_around(10, torch.Generator().manual_seed(0))
    with pytest.raises(ValueError, match="finite"):
        engine.render(o * torch.nan, d)
    with pytest.raises(ValueError, match="3 finite weights"):
        engine.set_level_weights(torch.ones(2))
    with pytest.raises(ValueError, match="power of two"):
        TritonEngine(FieldConfig(features=3), MARCH, BOX, True, device=DEVICE)
    none, nothing = torch.zeros(0, 3), torch.zeros(0)
    assert len(engine.render(none, none).colour) == 0
    assert len(engine.sample(none, none).blend) == 0
    assert len(engine.density(none)) == 0
    report = engine.train_step(RayBatch(none, none, none, nothing, nothing.long()), 1.0)
    assert (report.loss, report.samples) == (0, 0)
