import numpy as np
import torch
from torch.testing import assert_close

from mulan.geometry.camera import PinholeCamera
from mulan.planning import knowledge as knowledge_module
from mulan.planning.candidates import look_at
from mulan.planning.knowledge import Knowledge, LookConfig
from mulan.planning.view import View
from mulan.radiance.space import SceneSpace

from .analytic_engine import BallEngine

SPACE = SceneSpace((0.0, 0.0, 0.0), 0.9, unbounded=False)
MEMBERS = [BallEngine(stripes=stripes) for stripes in (2.0, 3.0)]


def views():
    """Exact and uncertain poses, of two lenses."""
    found = []
    for i in range(6):
        place = np.array([2 * np.cos(i), 2 * np.sin(i), 0.4])
        camera = PinholeCamera(24, 18 + 6 * (i % 2), 24.0, 24.0, 12.0, 9.0)
        covariance = np.diag([1e-4] * 3 + [4e-4] * 3) * (i % 3)
        found.append(View(camera, look_at(place, np.zeros(3), np.array([0.0, 1.0, 0.0])), covariance))
    return found


def test_views_looked_at_together_show_what_each_shows_by_itself(monkeypatch):
    monkeypatch.setattr(knowledge_module, "_RAYS_AT_ONCE", 300)  # two batches
    candidates, config = views(), LookConfig(columns=12, certainty_columns=6)
    together = Knowledge(MEMBERS, SPACE, (), config)
    alone = Knowledge(MEMBERS, SPACE, (), config)
    disagreements = together.disagreements(candidates, 2)
    for view, seen, variance in zip(candidates, together.look_at_all(candidates), disagreements, strict=True):
        expected = alone.look(view)
        for name in ("origins", "directions", "certainty", "ray", "cell"):
            assert_close(getattr(seen, name), getattr(expected, name), rtol=0, atol=1e-7)
        assert_close(variance, alone.disagreement(view, 2), rtol=0, atol=1e-7)
        assert len(expected.cell) > 20
    assert torch.cat([seen.certainty for seen in together.look_at_all(candidates)]).min() < 0.999


def test_looks_are_kept_once_another_view_is_decided_on():
    first = Knowledge(MEMBERS, SPACE, ())
    one, other = views()[:2]
    seen = first.look(one)
    assert first.with_chosen(other).look(one) is seen
