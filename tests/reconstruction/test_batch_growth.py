from itertools import pairwise

import pytest

from mulan.reconstruction.train_config import FIRST_OBJECT_BATCH, TrainConfig


def test_batches_of_an_object_grow_by_equal_factors_to_the_size_asked_for():
    config = TrainConfig(batch_samples=16384)
    sizes = [
        config.batch_samples_at(done, unbounded=False, on_gpu=False) for done in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    assert sizes[0] == FIRST_OBJECT_BATCH
    assert sizes[-1] == 16384
    for before, after in pairwise(sizes):
        assert after / before == pytest.approx((16384 / FIRST_OBJECT_BATCH) ** 0.25, rel=1e-3)


def test_batches_of_an_unbounded_scene_keep_their_size():
    config = TrainConfig(batch_samples=16384)
    assert {config.batch_samples_at(done, unbounded=True, on_gpu=False) for done in (0.0, 0.5, 1.0)} == {
        16384
    }


def test_no_batch_is_larger_than_asked_for_unless_the_first_is_given():
    assert TrainConfig(batch_samples=1000).batch_samples_at(0.0, unbounded=False, on_gpu=False) == 1000
    given = TrainConfig(batch_samples=1000, first_batch_samples=4000)
    assert given.batch_samples_at(0.0, unbounded=True, on_gpu=False) == 4000
