import math

import pytest
import torch

from mulan.radiance.engine import Rendering
from mulan.radiance.kernels.native_library import NativeLibrary
from mulan.radiance.space import SceneSpace
from tests.native.spheres import batch_around, colours_seen, rays_around
from tests.native.test_native_engine import BOX, WORLD, make_engine

RAYS = rays_around(4000, torch.Generator().manual_seed(99))


def psnr_db(rendering: Rendering) -> float:
    return -10 * math.log10(float((rendering.colour - colours_seen(*RAYS)).square().mean()))


@pytest.mark.parametrize("space", [BOX, WORLD], ids=["bounded", "unbounded"])
def test_a_preview_shows_nearly_what_a_rendering_shows(library: NativeLibrary, space: SceneSpace) -> None:
    engine, g = make_engine(library, space), torch.Generator().manual_seed(0)
    untrained = engine.preview(*RAYS).colour
    assert torch.equal(untrained, engine.render(*RAYS).colour), "nothing is known to be clear yet"
    for step in range(300):
        engine.train_step(batch_around(600, g), 0.5 * (1 + math.cos(math.pi * step / 300)))
    before = engine.render(*RAYS)
    preview = engine.preview(*RAYS)
    assert not torch.equal(preview.colour, before.colour), "something was left out"
    assert psnr_db(preview) > psnr_db(before) - 1
    assert torch.equal(engine.render(*RAYS).colour, before.colour), "renderings stay whole"


def test_a_preview_is_of_the_present_field(library: NativeLibrary) -> None:
    engine, g = make_engine(library, warm_up=2), torch.Generator().manual_seed(0)
    for _ in range(60):
        engine.train_step(batch_around(600, g), 1.0)
    engine.preview(*RAYS)
    for _ in range(60):
        engine.train_step(batch_around(600, g), 1.0)
    later = make_engine(library, warm_up=2)
    later.load_state(engine.state())
    assert torch.equal(engine.preview(*RAYS).colour, later.preview(*RAYS).colour)
