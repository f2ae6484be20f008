from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from mulan.geometry.camera import PinholeCamera
from mulan.planning.candidates import look_at
from mulan.planning.cells import CellGrid
from mulan.planning.knowledge import Knowledge, LookConfig
from mulan.planning.score import LiteralPosterior, PropagatedPosterior
from mulan.planning.scores.among_certain import AmongCertain
from mulan.planning.scores.angular_novelty import AngularNovelty
from mulan.planning.scores.coverage import Coverage
from mulan.planning.scores.ensemble import EnsembleVariance
from mulan.planning.scores.farthest_point import FarthestPoint
from mulan.planning.scores.mean_sum import MeanSum, default_score
from mulan.planning.scores.random_order import RandomOrder
from mulan.planning.scores.score import Score
from mulan.planning.scores.surround_coverage import SurroundCoverage, surrounding
from mulan.planning.scores.variance_posterior import VariancePosterior
from mulan.planning.selection import choose_views
from mulan.planning.view import View
from mulan.radiance.ensemble import FieldEnsemble
from mulan.radiance.space import SceneSpace

from .analytic_engine import BallEngine

SPACE = SceneSpace((0.0, 0.0, 0.0), 0.7, unbounded=False)
CAMERA = PinholeCamera(100, 100, 120.0, 120.0, 50.0, 50.0)


def view(azimuth_deg, sigma_m=0.0, target=(0.0, 0.0, 0.0), distance_m=2.0):
    a = np.radians(azimuth_deg)
    T = look_at(distance_m * np.array([np.cos(a), np.sin(a), 0.1]), np.array(target), np.array([0, 1.0, 0]))
    return View(CAMERA, T, np.diag([0.0] * 3 + [sigma_m**2] * 3))


@dataclass
class HalfPainted(BallEngine):
    """A member that paints the half x > 0 in a grey of its own."""

    grey: float = 0.5

    def sample(self, origins, directions):
        s = super().sample(origins, directions)
        x = (origins[s.ray_index] + s.distance_m[:, None] * directions[s.ray_index])[:, 0]
        return replace(s, colour=torch.where(x[:, None] > 0, self.grey, s.colour))


MEMBERS = (HalfPainted(grey=0.2), HalfPainted(grey=0.5), HalfPainted(grey=0.8))


PLAIN = (BallEngine(),)
LOOKS = LookConfig()


def knowing(*chosen, fields=PLAIN, looks=LOOKS):
    return Knowledge(fields, SPACE, chosen, looks)


INFORMATION = [
    AngularNovelty(),
    Coverage(),
    EnsembleVariance(),
    VariancePosterior(PropagatedPosterior()),
    VariancePosterior(LiteralPosterior()),
]


@pytest.mark.parametrize("score", INFORMATION, ids=lambda s: type(s).__name__)
def test_a_view_is_worth_less_the_worse_its_pose_is_known(score):
    candidates = [view(20, sigma_m) for sigma_m in (0.0, 0.02, 0.05, 0.1)]
    worth = score(knowing(view(180), fields=MEMBERS), candidates)
    assert (np.diff(worth) < 0).all()
    assert worth[-1] < 0.9 * worth[0]
    trusted = score(knowing(view(180), fields=MEMBERS), [c.taken_as_exact() for c in candidates])
    np.testing.assert_allclose(trusted, worth[0], rtol=1e-5)


@pytest.mark.parametrize(
    "score", [AngularNovelty(), Coverage(), FarthestPoint()], ids=lambda s: type(s).__name__
)
def test_the_far_side_is_worth_more_than_the_seen_one(score):
    worth = score(knowing(view(0)), [view(10), view(60), view(180)])
    assert (np.diff(worth) > 0).all()


def test_a_camera_that_stood_near_but_looked_elsewhere_does_not_count():
    candidate = [view(5)]
    looked_away = view(0, target=(4.0, 3.0, 0.2))
    none = AngularNovelty()(knowing(view(180)), candidate)
    assert AngularNovelty()(knowing(view(180), looked_away), candidate) == pytest.approx(none)
    assert AngularNovelty()(knowing(view(180), view(0)), candidate) < 0.2 * none
    assert FarthestPoint()(knowing(view(180), looked_away), candidate) < 0.2


@pytest.mark.parametrize("score", [AngularNovelty(), Coverage()], ids=lambda s: type(s).__name__)
def test_a_seen_place_stays_worth_a_visit_if_whoever_saw_it_hardly_knew_where_it_was(score):
    again = [view(5)]
    certain, unsure = (score(knowing(view(0, sigma_m)), again)[0] for sigma_m in (0.0, 0.15))
    never = score(knowing(), again)[0]
    assert certain < unsure < never


def test_a_second_look_at_the_same_cells_covers_about_a_quarter():
    first, second = Coverage()(knowing(), [view(0)])[0], Coverage()(knowing(view(0)), [view(0)])[0]
    # rays of different views graze different cells
    assert second == pytest.approx(first / 4, rel=0.4)


def test_an_ensemble_looks_where_its_members_disagree():
    worth = EnsembleVariance()(knowing(fields=MEMBERS), [view(0), view(90), view(180)])
    assert worth[0] > worth[1] > worth[2]
    same = EnsembleVariance()(knowing(fields=(BallEngine(),) * 3), [view(0)])
    assert same == pytest.approx(0, abs=1e-6)


def test_an_ensemble_renders_the_mean_and_variance_of_its_members_mixture():
    o, d = torch.tensor([[2.0, 0.0, 0.0]]), torch.tensor([[-1.0, 0.0, 0.0]])
    together = FieldEnsemble(MEMBERS).render(o, d)
    alone = [member.render(o, d) for member in MEMBERS]
    colour, variance = (torch.stack([getattr(one, name) for one in alone]) for name in ("colour", "variance"))
    assert_close(together.colour, colour.mean(0))
    assert_close(together.variance, colour.var(0).mean(-1) + variance.mean(0))
    with pytest.raises(ValueError, match="two members"):
        FieldEnsemble([BallEngine()])


def test_uncertain_views_come_after_every_certain_one_and_the_best_known_first():
    candidates = [view(0, 0.2), view(170, 0.1), view(20), view(90)]
    order = choose_views(AmongCertain(FarthestPoint(), 0.05), knowing(view(10)), candidates, 4)
    assert set(order[:2]) == {2, 3}
    assert order[2:] == [1, 0]


@dataclass(frozen=True)
class Given(Score):
    worth: tuple[float, ...]

    def __call__(self, knowledge, candidates):
        return np.array(self.worth)


def test_a_sum_of_scores_does_not_depend_on_their_units():
    @dataclass(frozen=True)
    class InOtherUnits(AngularNovelty):
        def __call__(self, knowledge, candidates):
            return 1000 * super().__call__(knowledge, candidates)

    candidates = [view(a) for a in (10, 50, 130, 170, 250)]
    knowledge = knowing(view(0), fields=MEMBERS)
    plain = MeanSum((AngularNovelty(), EnsembleVariance()))(knowledge, candidates)
    np.testing.assert_allclose(
        MeanSum((InOtherUnits(), EnsembleVariance()))(knowledge, candidates), plain, rtol=1e-5
    )


def test_a_score_counts_as_far_as_it_tells_candidates_apart():
    candidates = [view(a) for a in (10, 50, 130)]
    nearly_alike, apart, nothing = Given((1.02, 1.0, 0.98)), Given((1.0, 2.0, 6.0)), Given((0.0, 0.0, 0.0))
    together = MeanSum((nearly_alike, apart))(knowing(view(0)), candidates)
    assert list(np.argsort(together)) == [0, 1, 2]
    np.testing.assert_allclose(together, np.array(nearly_alike.worth) + np.array(apart.worth) / 3)
    np.testing.assert_array_equal(
        MeanSum((apart, nothing))(knowing(view(0)), candidates), np.array(apart.worth) / 3
    )


def test_the_default_is_novelty_and_disagreement():
    knowledge = knowing(view(0), fields=MEMBERS)
    assert default_score() == MeanSum((AngularNovelty(), EnsembleVariance()))
    assert default_score().fields_needed == 3
    assert len(default_score()(knowledge, [])) == 0


def test_views_chosen_together_spread_instead_of_repeating_each_other():
    candidates = [view(a) for a in (175, 180, 185, 90, 270)]
    chosen = choose_views(AngularNovelty(), knowing(view(0)), candidates, 3)
    assert len(set(chosen)) == 3
    assert {3, 4} <= set(chosen)


def test_lots_are_repeatable_differ_between_seeds_and_need_no_field():
    candidates = [view(a) for a in range(0, 200, 10)]
    knowledge = Knowledge((), SPACE, (view(0),))
    a, b = (choose_views(RandomOrder(seed), knowledge, candidates, 5) for seed in (1, 2))
    assert a == choose_views(RandomOrder(1), knowledge, candidates, 5)
    assert a != b
    assert RandomOrder(1).fields_needed == FarthestPoint().fields_needed == 0


@pytest.mark.parametrize("unbounded", [False, True])
def test_the_middle_of_a_cell_lies_in_it(unbounded):
    grid = CellGrid.of(SceneSpace((0.3, -0.2, 0.1), 0.8, unbounded))
    cell = torch.arange(0, grid.cells, 97)
    assert_close(grid.cell_of(grid.centre_m(cell)), cell)


def test_a_view_of_nothing_teaches_nothing():
    away = view(0, target=(9.0, 0.0, 0.0))
    for score in INFORMATION:
        assert score(knowing(view(180), fields=MEMBERS), [away]) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("sigma_m", [0.005, 0.02, 0.05])
def test_the_reduction_with_propagated_noise_is_that_with_sampled_poses(sigma_m):
    from mulan.geometry import se3
    from mulan.planning.rays import camera_rays
    from mulan.planning.score import CandidateView, posterior_variance, ray_variance, variance_reduction

    engine, columns = BallEngine(stripes=3.0), 12
    covariance = np.diag([1e-6] * 3 + [sigma_m**2] * 3)
    candidate = CandidateView(CAMERA, view(30).T_world_camera, covariance, columns)
    twists = np.random.default_rng(0).normal(size=(150, 6)) * np.sqrt(np.diag(covariance))
    poses = candidate.T_world_camera @ se3.exp(twists)
    colours = torch.stack([engine.render(*camera_rays(CAMERA, T, columns)).colour for T in poses])
    samples = engine.sample(*camera_rays(CAMERA, candidate.T_world_camera, columns))
    noise = ray_variance(samples, columns**2) + colours.var(0).mean(-1)
    after = posterior_variance(samples, noise[samples.ray_index])
    sampled = float((samples.variance - after).sum()) / columns**2
    assert variance_reduction(engine, candidate, PropagatedPosterior()) == pytest.approx(sampled, rel=0.1)


def test_all_around_a_robot_goes_where_nobody_has_been_and_stays_in_sight_of_the_scene():
    knowledge = knowing(view(0), view(20))
    on, between, out, away = view(40), view(10), view(20, distance_m=2.4), view(40, target=(9.0, 0.0, 0.0))
    worth = SurroundCoverage()(knowledge, [on, between, out, away])
    assert int(np.argmax(worth)) == 0
    assert worth[0] > 2 * worth[1]
    assert worth[3] == pytest.approx(0, abs=1e-3)


def test_views_from_all_around_stand_level_about_what_the_cameras_look_at():
    around = surrounding([view(angle).T_world_camera for angle in (0, 50, 80)], 12)
    radius_m = np.linalg.norm(around[:, :2, 3], axis=1)
    assert radius_m == pytest.approx(radius_m[0], rel=0.02)
    assert np.ptp(around[:, 2, 3]) < 1e-9
