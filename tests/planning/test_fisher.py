import numpy as np
import pytest
import torch
from torch.testing import assert_close

from mulan.geometry.camera import PinholeCamera
from mulan.planning.candidates import look_at
from mulan.planning.knowledge import Knowledge, LookConfig
from mulan.planning.rays import camera_rays
from mulan.planning.scores.fisher import FisherInformation
from mulan.planning.view import View
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine

from .analytic_engine import BallEngine

FIELD = FieldConfig(levels=3, log2_table_size=9, base_resolution=4, finest_resolution=12, width=16)
SPACE = SceneSpace((0.0, 0.0, 0.0), 0.7, unbounded=False)
ARGUMENTS = FIELD, MarchConfig(steps=24, occupancy_resolution=16), SPACE, True
CAMERA = PinholeCamera(8, 8, 10.0, 10.0, 4.0, 4.0)
CONFIG = LookConfig(columns=4, chosen_columns=4)


def field() -> TorchEngine:
    """Untrained, but with a table large enough for the colours to depend on it."""
    engine = TorchEngine(*ARGUMENTS, seed=1)
    state = engine.state()
    state["table"] *= 2e3
    engine.load_state(state)
    return engine


def view(azimuth_rad: float, sigma_m: float = 0.0) -> View:
    place = 2 * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.2])
    T = look_at(place, np.zeros(3), np.array([0.0, 1.0, 0.0]))
    return View(CAMERA, T, np.diag([0.0] * 3 + [sigma_m**2] * 3))


def test_parameter_gradient_of_both_cpu_engines_is_the_same():
    library, reason = find_native_library()
    if library is None:
        pytest.skip(f"no native engine: {reason}")
    torch_engine, native = field(), NativeEngine(*ARGUMENTS, seed=3)
    native.load_state(torch_engine.state())
    rays = camera_rays(CAMERA, view(0.3).T_world_camera, 8)
    towards = torch.randn(len(rays[0]), 3, generator=torch.Generator().manual_seed(0))
    expected = torch_engine.parameter_gradient(*rays, towards)
    assert float(expected.abs().max()) > 0
    assert_close(native.parameter_gradient(*rays, towards), expected, rtol=1e-3, atol=1e-5)
    before = native.state()
    native.parameter_gradient(*rays, towards)
    assert all(torch.equal(value, before[name]) for name, value in native.state().items())


def test_parameter_gradient_predicts_how_colours_change():
    engine = field()
    rays = camera_rays(CAMERA, view(0.3).T_world_camera, 8)
    towards = torch.randn(len(rays[0]), 3, generator=torch.Generator().manual_seed(0))
    gradient = engine.parameter_gradient(*rays, towards)
    state = engine.state()
    table = state["table"]
    step = 1e-2 * gradient[: table.numel()].view_as(table) / float(gradient[: table.numel()].norm())
    values = []
    for sign in (1, -1):
        engine.load_state({**state, "table": table + sign * step})
        values.append(float((engine.render(*rays).colour * towards).sum()))
    predicted = 2 * float((gradient[: table.numel()].view_as(table) * step).sum())
    assert values[0] - values[1] == pytest.approx(predicted, rel=0.02)


def test_random_signs_estimate_the_sum_of_squared_gradients_of_all_colours():
    engine = field()
    look = Knowledge((engine,), SPACE, (), CONFIG).look(view(0.3))
    exact = torch.zeros(engine.parameter_count)
    for ray in range(len(look.origins)):
        for channel in range(3):
            one = torch.zeros(1, 3)
            one[0, channel] = 1
            some = slice(ray, ray + 1)
            exact += engine.parameter_gradient(look.origins[some], look.directions[some], one).square()
    estimate = FisherInformation(probes=100).diagonal(engine, look)
    assert float(estimate.sum()) == pytest.approx(float(exact.sum()), rel=0.15)
    large = exact > exact.max() / 30
    assert_close(estimate[large].log().mean(), exact[large].log().mean(), rtol=0, atol=0.1)


def test_a_view_says_less_about_what_a_near_view_has_told_and_less_the_worse_its_pose():
    knowledge = Knowledge((field(),), SPACE, (view(0.0), view(0.1)), CONFIG)
    near, far = FisherInformation()(knowledge, [view(0.05), view(np.pi)])
    assert 0 < near < far
    exact, unsure = FisherInformation()(knowledge, [view(np.pi), view(np.pi, 0.2)])
    assert unsure < exact


def test_an_engine_without_gradients_is_refused():
    with pytest.raises(TypeError, match="CPU engine"):
        FisherInformation()(Knowledge((BallEngine(),), SPACE, ()), [view(0.0)])
