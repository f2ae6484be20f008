import pytest
import torch

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch
from mulan.radiance.loss import GaussianLikelihoodLoss, HuberLoss
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine

FIELD = FieldConfig(levels=4, log2_table_size=11, base_resolution=8, finest_resolution=48, width=16)
MARCH = MarchConfig(steps=48, occupancy_resolution=16)
BOX = SceneSpace((0.0, 0.0, 0.0), 1.0, unbounded=False)


def new_engine(seed=0, space=BOX, white=True, **options):
    return TorchEngine(FIELD, MARCH, space, white, seed, OptimiserConfig(**options))


def coloured_cube_rays(rays, generator):
    """Rays towards a cube of half side 0.5 whose colour is its surface position, on white."""
    origins = 3 * torch.nn.functional.normalize(torch.randn(rays, 3, generator=generator), dim=-1)
    target = torch.rand(rays, 3, generator=generator) * 1.6 - 0.8
    directions = torch.nn.functional.normalize(target - origins, dim=-1)
    a, b = (-0.5 - origins) / directions, (0.5 - origins) / directions
    near, far = torch.minimum(a, b).amax(-1), torch.maximum(a, b).amin(-1)
    surface = (origins + near[:, None] * directions).clamp(-0.5, 0.5) + 0.5
    colours = torch.where((near < far)[:, None], surface, torch.ones(()))
    return RayBatch(origins, directions, colours, torch.ones(rays), torch.zeros(rays, dtype=torch.long))


def train(engine, steps, seed=0, rays=256):
    g = torch.Generator().manual_seed(seed)
    return [engine.train_step(coloured_cube_rays(rays, g), 1.0) for _ in range(steps)]


@pytest.fixture(scope="module")
def trained():
    engine = new_engine(occupancy_every=8)
    train(engine, 400)
    return engine


def test_a_tiny_scene_is_learnt_above_22_db(trained):
    batch = coloured_cube_rays(2000, torch.Generator().manual_seed(99))
    mse = (trained.render(batch.origins, batch.directions).colour - batch.colours).square().mean()
    assert -10 * mse.log10() > 22


def test_depth_of_a_learnt_cube_is_the_distance_to_its_surface(trained):
    origins, directions = torch.tensor([[3.0, 0.1, 0.1]]), torch.tensor([[-1.0, 0.0, 0.0]])
    rendering = trained.render(origins, directions)
    assert rendering.opacity[0] > 0.9
    assert abs(float(rendering.depth_m[0]) - 2.5) < 0.2


def test_density_is_high_on_the_surface_and_zero_outside_the_box(trained):
    on_surface, outside = trained.density(torch.tensor([[0.47, 0.1, 0.1], [0.0, 0.0, 7.0]]))
    assert on_surface > 2
    assert outside == 0


def test_occupancy_drops_empty_cells_and_keeps_the_cube(trained):
    occupied = trained.state()["occupancy.occupied"][0]
    assert occupied.float().mean() < 0.6
    assert occupied[4:12, 4:12, 11].float().mean() > 0.9  # cells of the face x = 0.5 from inside


def test_samples_add_up_to_the_rendering(trained):
    batch = coloured_cube_rays(100, torch.Generator().manual_seed(5))
    samples, rendering = (f(batch.origins, batch.directions) for f in (trained.sample, trained.render))
    opacity = torch.zeros(100).index_add(0, samples.ray_index, samples.blend)
    torch.testing.assert_close(opacity, rendering.opacity)
    variance = torch.zeros(100).index_add(0, samples.ray_index, samples.blend**2 * samples.variance)
    torch.testing.assert_close(variance, rendering.variance)
    assert (samples.variance >= 1e-4).all()


def test_same_seed_gives_the_same_field_bit_for_bit_and_another_does_not():
    engines = [new_engine(seed=s) for s in (3, 3, 4)]
    for engine in engines:
        train(engine, 20, rays=64)
    first, again, other = (engine.state() for engine in engines)
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["table"], other["table"])


def test_going_on_from_a_saved_state_equals_never_having_stopped():
    whole, first, second = (new_engine(occupancy_every=4) for _ in range(3))
    batches = [coloured_cube_rays(64, torch.Generator().manual_seed(i)) for i in range(24)]
    for batch in batches:
        whole.train_step(batch, 0.5)
    for batch in batches[:11]:
        first.train_step(batch, 0.5)
    second.load_state(first.state())
    for batch in batches[11:]:
        second.train_step(batch, 0.5)
    a, b = whole.state(), second.state()
    assert all(torch.equal(a[name], b[name]) for name in a)


def test_variance_loss_leaves_the_trunk_untouched():
    with_head, without = new_engine(), new_engine()
    with torch.no_grad():
        without.field.variance_out.zero_()  # another head, and so another variance loss
    train(with_head, 10)
    train(without, 10)
    a, b = with_head.state(), without.state()
    trunk = ["table", "density_hidden", "density_out", "colour_hidden_0", "colour_out"]
    assert all(torch.equal(a[name], b[name]) for name in trunk)
    assert not torch.equal(a["variance_out"], b["variance_out"])


def test_a_likelihood_as_colour_loss_teaches_the_trunk_through_the_variance():
    states = []
    for scale in (1.0, 3.0):
        engine = new_engine(loss=GaussianLikelihoodLoss())
        with torch.no_grad():
            engine.field.variance_out.mul_(scale)
        train(engine, 3)
        states.append(engine.state())
    assert not torch.equal(states[0]["density_hidden"], states[1]["density_hidden"])


@pytest.mark.parametrize(
    "options",
    [
        {"loss": HuberLoss(0.1)},
        {"loss": GaussianLikelihoodLoss()},
        {"distortion_weight": 1e-2},
        {"entropy_weight": 1e-2},
    ],
)
def test_every_loss_is_learnt_down(options):
    losses = [report.loss for report in train(new_engine(**options), 60)]
    assert sum(losses[-10:]) < sum(losses[:10])


def test_pose_gradients_match_finite_differences_of_the_loss():
    """In double precision and an unbounded scene, where a sample's distance does not depend on the ray."""
    space = SceneSpace((0.0, 0.0, 0.0), 1.5, unbounded=True)
    batch = coloured_cube_rays(60, torch.Generator().manual_seed(0))
    image = torch.arange(60) % 2
    R = torch.linalg.qr(
        torch.randn(2, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    ).Q

    def loss(xi):
        engine = new_engine(
            space=space, distortion_weight=0.1, table_learning_rate=0.0, network_learning_rate=0.0
        )
        engine.field.double()
        turn, shift = (torch.einsum("iab,ib->ia", R, part)[image] for part in xi.split(3, 1))
        d = batch.directions.double()
        moved = RayBatch(
            batch.origins.double() + shift,
            d + torch.cross(turn, d, dim=-1),
            batch.colours.double(),
            batch.weights.double(),
            image,
        )
        report, gradient = engine.train_step_with_pose_gradients(moved, 1.0, R)
        return report.loss, gradient

    _, gradient = loss(torch.zeros(2, 6, dtype=torch.float64))
    for camera in range(2):
        for axis in range(6):
            step = torch.zeros(2, 6, dtype=torch.float64)
            step[camera, axis] = 1e-6
            slope = (loss(step)[0] - loss(-step)[0]) / 2e-6
            assert float(gradient[camera, axis]) == pytest.approx(
                slope, rel=1e-3, abs=1e-5 * float(gradient.abs().max())
            )


def test_random_backgrounds_need_opacities_and_leave_nothing_painted_in_the_air():
    engine = new_engine(random_background=True)
    batch = coloured_cube_rays(64, torch.Generator().manual_seed(0))
    with pytest.raises(ValueError, match="opacity"):
        engine.train_step(batch, 1.0)
    # a white object before white: without random backgrounds nothing shows that it is there
    hit = (batch.colours < 1).any(-1).float()
    white = RayBatch(
        batch.origins, batch.directions, torch.ones(64, 3), torch.ones(64), batch.image_index, hit
    )
    for _ in range(60):
        engine.train_step(white, 1.0)
    opacity = engine.render(batch.origins, batch.directions).opacity
    assert opacity[hit > 0].mean() > opacity[hit == 0].mean() + 0.3


def test_rays_of_zero_weight_change_nothing():
    batch = coloured_cube_rays(64, torch.Generator().manual_seed(0))
    weights = (torch.arange(64) % 2).float()
    spoilt = torch.where(weights[:, None] > 0, batch.colours, 1 - batch.colours)
    states = []
    for colours in (batch.colours, spoilt):
        engine = new_engine()
        engine.train_step(RayBatch(batch.origins, batch.directions, colours, weights, batch.image_index), 1.0)
        states.append(engine.state())
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])


def test_a_batch_that_misses_everything_is_survived():
    away = torch.tensor([[0.0, 0.0, 1.0]])
    index = torch.zeros(1, dtype=torch.long)
    report = new_engine().train_step(RayBatch(5 * away, away, torch.ones(1, 3), torch.ones(1), index), 1.0)
    assert report.samples == 0
    assert report.loss == 0


@pytest.mark.parametrize("white", [True, False])
def test_rays_that_hit_nothing_see_the_background(white):
    away = torch.tensor([[0.0, 0.0, 1.0]])
    rendering = new_engine(white=white).render(5 * away, away)
    assert rendering.colour.unique().tolist() == [float(white)]
    assert rendering.depth_m[0] == 0


def test_unbounded_scene_sees_far_away():
    engine = new_engine(space=SceneSpace((0.0, 0.0, 0.0), 1.0, unbounded=True), white=False)
    samples = engine.sample(torch.zeros(1, 3), torch.tensor([[0.0, 0.0, 1.0]]))
    assert samples.distance_m.max() > 20


def test_a_state_of_another_size_is_refused_by_name():
    other = TorchEngine(FieldConfig(levels=2), MARCH, BOX, True)
    with pytest.raises(ValueError, match="table"):
        new_engine().load_state(other.state())
