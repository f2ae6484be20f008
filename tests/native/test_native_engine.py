import math
from dataclasses import replace

import pytest
import torch

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.native_grid import NativeGridConfig
from mulan.radiance.kernels.native_library import NativeLibrary
from mulan.radiance.loss import ColourLoss
from mulan.radiance.native_engine import NativeConfig, NativeEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.ray_gradients import pose_gradients
from mulan.radiance.rendering import evaluate_rays
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine
from tests.native.spheres import batch_around, colours_seen, rays_around

FIELD = FieldConfig(levels=6, log2_table_size=12, finest_resolution=64, width=16, geometry_features=8)
MARCH = MarchConfig(steps=96, occupancy_resolution=32)
BOX = SceneSpace((0.0, 0.0, 0.0), 0.8, False)
WORLD = SceneSpace((0.0, 0.0, 0.0), 0.8, True)


def make_engine(
    library: NativeLibrary,
    space: SceneSpace = BOX,
    warm_up: int = 6,
    threads: int = 0,
    update_untouched: bool = False,
    march: MarchConfig = MARCH,
) -> NativeEngine:
    native = NativeConfig(threads, update_untouched, NativeGridConfig(warm_up_refreshes=warm_up))
    return NativeEngine(FIELD, march, space, True, seed=3, native=native, library=library)


def train(
    engine: NativeEngine | TorchEngine, steps: int, seed: int = 0, rays_a_pixel: int = 1
) -> list[float]:
    g = torch.Generator().manual_seed(seed)
    batches = (batch_around(400, g, rays_a_pixel) for _ in range(steps))
    return [engine.train_step(batch, 1.0).loss for batch in batches]


def states_equal(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[k], b[k]) for k in a)


def test_a_small_scene_is_learnt(library: NativeLibrary) -> None:
    engine, g = make_engine(library), torch.Generator().manual_seed(0)
    for step in range(300):
        engine.train_step(batch_around(600, g), 0.5 * (1 + math.cos(math.pi * step / 300)))
    o, d = rays_around(4000, torch.Generator().manual_seed(99))
    rendering = engine.render(o, d)
    psnr = -10 * math.log10(float((rendering.colour - colours_seen(o, d)).square().mean()))
    assert psnr > 25
    inside, outside = torch.tensor([[0.25, 0.0, 0.1]]), torch.tensor([[0.0, -0.7, 0.6], [9.0, 0.0, 0.0]])
    assert engine.density(inside)[0] > 5 > 0.5 > engine.density(outside)[0]
    assert engine.density(outside)[1] == 0


@pytest.mark.parametrize("cascades", [1, 2])
@pytest.mark.parametrize("space", [BOX, WORLD], ids=["bounded", "unbounded"])
def test_answers_are_the_torch_engines(library: NativeLibrary, space: SceneSpace, cascades: int) -> None:
    march = replace(MARCH, cascades=cascades)
    native = make_engine(library, space, march=march)
    train(native, 100)
    assert native.state()["occupancy.occupied"].float().mean() < 1
    torch_engine = TorchEngine(FIELD, march, space, True)
    torch_engine.load_state(native.state())
    o, d = rays_around(300, torch.Generator().manual_seed(1))
    got, want = native.render(o, d), torch_engine.render(o, d)
    torch.testing.assert_close(got.colour, want.colour, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(got.opacity, want.opacity, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(got.variance, want.variance, rtol=1e-3, atol=1e-5)
    hit = want.opacity > 0.05
    torch.testing.assert_close(got.depth_m[hit], want.depth_m[hit], rtol=1e-3, atol=1e-3)
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(2)) * 2 - 1
    torch.testing.assert_close(native.density(points), torch_engine.density(points), rtol=1e-3, atol=1e-4)
    samples = native.sample(o, d)
    colour = torch.zeros(300, 3).index_add(0, samples.ray_index, samples.blend[:, None] * samples.colour)
    blend = torch.zeros(300).index_add(0, samples.ray_index, samples.blend)
    torch.testing.assert_close(colour + 1 - blend[:, None], got.colour, rtol=1e-4, atol=1e-4)
    assert abs(len(samples.blend) - len(torch_engine.sample(o, d).blend)) <= 0.001 * len(samples.blend) + 2


@pytest.mark.parametrize("rays_a_pixel", [1, 2])
def test_learning_follows_the_torch_engine(library: NativeLibrary, rays_a_pixel: int) -> None:
    torch_engine = TorchEngine(FIELD, MARCH, BOX, True, seed=3)
    native = make_engine(library, update_untouched=True)
    assert states_equal(native.state(), torch_engine.state())
    a, b = (train(engine, 25, rays_a_pixel=rays_a_pixel) for engine in (torch_engine, native))
    # the jitter differs, so the losses agree in the mean only
    assert sum(a[-8:]) == pytest.approx(sum(b[-8:]), rel=0.15)


def test_saved_state_continues_as_if_never_interrupted(library: NativeLibrary) -> None:
    steps = 70  # some before and some after cells are first switched off
    whole = make_engine(library, warm_up=2)
    train(whole, steps)
    train(whole, steps, seed=1)
    first = make_engine(library, warm_up=2)
    train(first, steps)
    second = make_engine(library, warm_up=2)
    second.load_state(first.state())
    train(second, steps, seed=1)
    assert states_equal(whole.state(), second.state())


def test_large_batches_are_learnt_in_waves_without_loss(library: NativeLibrary) -> None:
    """More samples than fit one wave give the gradient step of all of them."""
    o, d = rays_around(9000, torch.Generator().manual_seed(0))
    march = MarchConfig(steps=256, occupancy_resolution=32)
    ones, index = torch.ones(9000), torch.zeros(9000, dtype=torch.int64)
    batch = RayBatch(o, d, colours_seen(o, d), ones, index)
    engines = [NativeEngine(FIELD, march, BOX, True, seed=3, library=library) for _ in range(2)]
    report = engines[0].train_step(batch, 1.0)
    assert report.samples > 2**18
    rays, doubled_ones = torch.cat([o, o]), torch.ones(18000)
    twice = RayBatch(rays, torch.cat([d, d]), batch.colours.repeat(2, 1), doubled_ones, index.repeat(2))
    doubled = engines[1].train_step(twice, 1.0)
    # the same rays twice: the same mean loss but for the jitter, twice the samples
    assert doubled.loss == pytest.approx(report.loss, rel=1e-2)
    assert doubled.samples == pytest.approx(2 * report.samples, rel=1e-2)


def test_ray_gradients_of_a_step_are_those_before_it(library: NativeLibrary) -> None:
    engine = make_engine(library)
    train(engine, 20)
    batch = batch_around(50, torch.Generator().manual_seed(8))
    before = engine.state()
    report, gradients = engine.train_step_with_ray_gradients(batch, 1.0)
    after = engine.state()
    engine.load_state(before)
    assert engine.train_step(batch, 1.0) == report
    assert states_equal(engine.state(), after)
    assert gradients.origins.abs().sum() > 0


def test_pose_gradients_of_a_step_are_those_of_its_rays_bit_for_bit(library: NativeLibrary) -> None:
    g = torch.Generator().manual_seed(8)
    batch = replace(batch_around(700, g), image_index=torch.arange(700) % 3)
    batch.weights[::5] = 0.0
    R = torch.linalg.qr(torch.randn(3, 3, 3, generator=g)).Q.contiguous()
    answers = []
    for threads in (1, 3):
        engine = make_engine(library, threads=threads)
        train(engine, 20)
        before = engine.state()
        report, poses = engine.train_step_with_pose_gradients(batch, 1.0, R)
        after = engine.state()
        engine.load_state(before)
        by_rays, rays = engine.train_step_with_ray_gradients(batch, 1.0)
        assert report == by_rays
        assert states_equal(after, engine.state())
        assert torch.equal(poses, pose_gradients(library, rays, batch.directions, batch.image_index, R))
        answers.append(poses)
    assert torch.equal(answers[0], answers[1])
    assert bool((answers[0].abs().sum(1) > 0).all())


@pytest.mark.parametrize("space", [BOX, WORLD], ids=["bounded", "unbounded"])
def test_pose_gradients_are_autograds_of_the_torch_engine_in_double_precision(
    library: NativeLibrary, space: SceneSpace
) -> None:
    native = make_engine(library, space)
    train(native, 40)
    torch_engine = TorchEngine(FIELD, MARCH, space, True)
    torch_engine.load_state(native.state())
    g = torch.Generator().manual_seed(4)
    o, d = rays_around(200, g)
    image = torch.arange(200) % 3
    R = torch.linalg.qr(torch.randn(3, 3, 3, generator=g)).Q.contiguous()
    to_colour = torch.randn(200, 3, generator=g)
    _, rays = native.ray_gradients(o, d, to_colour)
    got = pose_gradients(library, rays, d, image, R)

    field, occupied = torch_engine.field.double(), torch_engine.state()["occupancy.occupied"]
    xi = torch.zeros(3, 6, dtype=torch.float64, requires_grad=True)
    turn, shift = (torch.einsum("iab,ib->ia", R.double(), part)[image] for part in xi.split(3, 1))
    origins = o.double() + shift
    directions = d.double() + torch.cross(turn, d.double(), dim=-1)
    middle = torch.full((200,), 0.5, dtype=torch.float64)
    samples = evaluate_rays(field, space, MARCH, occupied, origins, directions, middle)
    assert samples.marched > 1000
    c = samples.composite(200)
    ((c.colour + 1 - c.opacity[:, None]) * to_colour.double()).sum().backward()
    assert xi.grad is not None
    # near a cell's wall single precision may take the neighbour's slope
    assert float((got - xi.grad).norm() / xi.grad.norm()) < 1e-2


def test_random_backgrounds_are_learnt_before_as_by_the_torch_engine(library: NativeLibrary) -> None:
    optimiser = OptimiserConfig(random_background=True)
    native = NativeEngine(FIELD, MARCH, BOX, True, 3, optimiser, NativeConfig(update_untouched=True), library)
    torch_engine = TorchEngine(FIELD, MARCH, BOX, True, 3, optimiser)
    g = torch.Generator().manual_seed(0)
    losses = []
    for _ in range(25):
        batch = batch_around(400, g)
        hit = (batch.colours < 1).any(-1).float()
        with_opacity = replace(batch, opacity=hit)
        losses.append([e.train_step(with_opacity, 1.0).loss for e in (native, torch_engine)])
    got, want = torch.tensor(losses)[-8:].sum(0).tolist()
    # jitter and backgrounds differ, so the losses agree in the mean only
    assert got == pytest.approx(want, rel=0.15)
    with pytest.raises(ValueError, match="opacity"):
        native.train_step(batch_around(10, g), 1.0)


def test_a_loss_the_library_does_not_know_is_refused(library: NativeLibrary) -> None:
    class Other(ColourLoss):
        def __call__(self, error, variance):
            return error.abs().mean(-1)

    engine = NativeEngine(FIELD, MARCH, BOX, True, 3, OptimiserConfig(loss=Other()), library=library)
    with pytest.raises(ValueError, match="does not know"):
        engine.train_step(batch_around(10, torch.Generator()), 1.0)


def test_a_ray_of_an_unknown_image_is_refused_and_nothing_is_changed(library: NativeLibrary) -> None:
    engine = make_engine(library)
    before = engine.state()["table"]
    batch = replace(batch_around(50, torch.Generator().manual_seed(0)), image_index=torch.full((50,), 2))
    with pytest.raises(ValueError, match="refused"):
        engine.train_step_with_pose_gradients(batch, 1.0, torch.eye(3).expand(2, 3, 3))
    assert torch.equal(engine.state()["table"], before)


def test_rays_of_weight_zero_change_nothing(library: NativeLibrary) -> None:
    a, b = make_engine(library), make_engine(library)
    batch = batch_around(100, torch.Generator().manual_seed(0))
    ignored = batch_around(60, torch.Generator().manual_seed(1))
    longer = RayBatch(
        torch.cat([batch.origins, ignored.origins]),
        torch.cat([batch.directions, ignored.directions]),
        torch.cat([batch.colours, torch.full((60, 3), torch.nan)]),
        torch.cat([batch.weights, torch.zeros(60)]),
        torch.cat([batch.image_index, ignored.image_index]),
    )
    assert a.train_step(batch, 1.0) == b.train_step(longer, 1.0)
    assert states_equal(a.state(), b.state())


def test_a_level_switched_off_stays_as_it_is(library: NativeLibrary) -> None:
    engine = make_engine(library)
    before = engine.state()["table"]
    engine.set_level_weights(torch.tensor([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
    train(engine, 5)
    after = engine.state()["table"]
    assert torch.equal(after[3:], before[3:])
    assert not torch.equal(after[:3], before[:3])


def test_a_ray_may_have_more_samples_than_a_tile(library: NativeLibrary) -> None:
    march = MarchConfig(steps=700, occupancy_resolution=32)
    engine = NativeEngine(FIELD, march, BOX, True, seed=3, library=library)
    losses = train(engine, 20)
    o, d = rays_around(100, torch.Generator().manual_seed(1))
    torch_engine = TorchEngine(FIELD, march, BOX, True)
    torch_engine.load_state(engine.state())
    torch.testing.assert_close(
        engine.render(o, d).colour, torch_engine.render(o, d).colour, rtol=1e-4, atol=1e-4
    )
    assert losses[-1] < 0.9 * losses[0]


def test_no_rays_at_all(library: NativeLibrary) -> None:
    engine = make_engine(library)
    empty, none = torch.zeros(0, 3), torch.zeros(0)
    assert len(engine.render(empty, empty).colour) == 0
    assert len(engine.sample(empty, empty).blend) == 0
    report = engine.train_step(RayBatch(empty, empty, empty, none, none.long()), 1.0)
    assert report.loss == 0
    assert report.samples == 0


def test_a_field_the_library_cannot_hold_is_refused(library: NativeLibrary) -> None:
    with pytest.raises(ValueError, match="2 features"):
        NativeEngine(FieldConfig(features=4), MARCH, BOX, True, library=library)
    with pytest.raises(ValueError, match="multiple of 4"):
        NativeEngine(FIELD, MarchConfig(occupancy_resolution=30), BOX, True, library=library)


def test_a_saved_field_of_another_shape_is_refused(library: NativeLibrary) -> None:
    engine = make_engine(library)
    state = engine.state()
    del state["colour_out"]
    with pytest.raises(ValueError, match="colour_out"):
        engine.load_state(state)
