import pytest
import torch

from mulan.evaluation.engine.naive_torch import NaiveTorchField, encode_plainly
from mulan.evaluation.engine.throughput import new_torch_engine
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.hash_encoding import encode_reference
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.field_file import FieldDescription

FIELD = FieldConfig(levels=4, log2_table_size=10, base_resolution=4, finest_resolution=32, width=16)
# light that a tuned engine stops following must not matter to the comparison
MARCH = MarchConfig(steps=48, occupancy_resolution=16, min_transmittance=0.0)
SPACE = SceneSpace((0.1, 0.0, -0.2), 1.0, unbounded=False)
DESCRIPTION = FieldDescription(FIELD, MARCH, SPACE, white_background=True)


@pytest.fixture
def batch():
    generator = torch.Generator().manual_seed(5)
    origins = torch.nn.functional.normalize(torch.randn(200, 3, generator=generator), dim=-1) * 3
    aim = torch.randn(200, 3, generator=generator) * 0.5
    directions = torch.nn.functional.normalize(aim - origins, dim=-1)
    colours, weights = torch.rand(200, 3, generator=generator), torch.rand(200, generator=generator) + 0.1
    return RayBatch(origins, directions, colours, weights, torch.zeros(200, dtype=torch.long))


def thick(field):
    """A field with visible structure: large table entries."""
    with torch.no_grad():
        field.table.mul_(1e4)


def test_the_plain_encoding_is_the_reference():
    generator = torch.Generator().manual_seed(1)
    points = torch.rand(100, 3, generator=generator)
    table = torch.randn(4, 1024, 2, generator=generator)
    assert torch.allclose(encode_plainly(points, table, FIELD), encode_reference(points, table, FIELD))


def test_it_renders_what_the_tuned_engine_renders(batch):
    tuned, naive = new_torch_engine(DESCRIPTION, 0), NaiveTorchField(DESCRIPTION, 0)
    thick(tuned.field)
    naive.load_state(tuned.state())
    a = tuned.render(batch.origins, batch.directions)
    b = naive.render(batch.origins, batch.directions)
    assert a.colour.std() > 0.05
    for name in ("colour", "depth_m", "opacity", "variance"):
        assert torch.allclose(getattr(a, name), getattr(b, name), atol=2e-5), name


def test_a_training_step_is_the_tuned_engines(batch):
    tuned, naive = new_torch_engine(DESCRIPTION, 0), NaiveTorchField(DESCRIPTION, 0)
    thick(tuned.field)
    naive.load_state(tuned.state())
    # the same place in their steps, whatever each draws
    tuned._generator.manual_seed(3)
    naive._generator.manual_seed(3)
    a, b = tuned.train_step(batch, 1.0), naive.train_step(batch, 1.0)
    assert a.samples == b.samples
    assert b.loss == pytest.approx(a.loss, rel=1e-4)
    assert b.mean_squared_error == pytest.approx(a.mean_squared_error, rel=1e-4)
    for name, parameter in tuned.field.named_parameters():
        theirs = dict(naive.field.named_parameters())[name].grad
        assert theirs is not None
        assert parameter.grad is not None
        scale = float(parameter.grad.abs().max())
        assert torch.allclose(theirs, parameter.grad, atol=2e-4 * scale), name


def test_training_lowers_the_error(batch):
    naive = NaiveTorchField(DESCRIPTION, 0)
    errors = [naive.train_step(batch, 1.0).mean_squared_error for _ in range(40)]
    assert errors[-1] < 0.5 * errors[0]


def test_an_unbounded_scene_is_refused():
    space = SceneSpace((0.0, 0.0, 0.0), 1.0, unbounded=True)
    with pytest.raises(ValueError, match="bounded"):
        NaiveTorchField(FieldDescription(FIELD, MARCH, space, white_background=False))
