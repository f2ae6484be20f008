from itertools import pairwise

import pytest

from mulan.reconstruction.train_config import FIRST_OBJECT_BATCH, TrainConfig


def test_batches_of_a_quickly_learnt_object_grow_by_equal_factors_to_the_size_asked_for():
    config = TrainConfig(image_size=100, batch_samples=16384, time_budget_s=5.0)
    sizes = [
        config.batch_samples_at(done, unbounded=False, on_gpu=False) for done in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    assert sizes[0] == FIRST_OBJECT_BATCH
    assert sizes[-1] == 16384
    for before, after in pairwise(sizes):
        assert after / before == pytest.approx((16384 / FIRST_OBJECT_BATCH) ** 0.25, rel=1e-3)


@pytest.mark.parametrize(("budget_s", "unbounded"), [(5.0, True), (60.0, False), (60.0, True)])
def test_batches_of_unbounded_scenes_and_long_trainings_keep_their_size(budget_s: float, unbounded: bool):
    config = TrainConfig(image_size=100, batch_samples=16384, time_budget_s=budget_s)
    assert {config.batch_samples_at(done, unbounded, on_gpu=False) for done in (0.0, 0.5, 1.0)} == {16384}


def test_a_given_number_of_steps_tells_whether_a_training_is_quick():
    assert TrainConfig(steps=100, time_budget_s=600.0).quick
    assert not TrainConfig(steps=100_000, time_budget_s=5.0).quick


def test_a_training_is_quick_by_the_time_there_is_for_a_pixel():
    assert not TrainConfig(image_size=100, time_budget_s=60.0).quick
    assert TrainConfig(image_size=200, time_budget_s=60.0).quick
    assert not TrainConfig(image_size=200, time_budget_s=180.0).quick
    assert not TrainConfig(image_size=400, time_budget_s=300.0).quick  # larger ones were not compared
    assert TrainConfig(image_size=24, time_budget_s=20.0).quick  # small pictures are not hurried


def test_large_pictures_begin_with_larger_batches_and_end_with_the_same():
    config = TrainConfig(image_size=150, batch_samples=16384, time_budget_s=5.0)
    assert config.batch_samples_at(0.0, unbounded=False, on_gpu=False) == FIRST_OBJECT_BATCH * 2.25
    assert config.batch_samples_at(1.0, unbounded=False, on_gpu=False) == 16384


def test_no_batch_is_larger_than_asked_for_unless_the_first_is_given():
    assert (
        TrainConfig(batch_samples=1000, steps=9).batch_samples_at(0.0, unbounded=False, on_gpu=False) == 1000
    )
    given = TrainConfig(batch_samples=1000, first_batch_samples=4000)
    assert given.batch_samples_at(0.0, unbounded=True, on_gpu=False) == 4000
