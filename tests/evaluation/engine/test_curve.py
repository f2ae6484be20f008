import pytest
from hypothesis import given
from hypothesis import strategies as st

from mulan.evaluation.engine.curve import (
    curve_on_views,
    evaluation_times_s,
    fastest_to_psnr,
    least_lead_db,
    seconds_to_psnr,
)

RISING = [(1.0, 20.0), (2.0, 26.0), (4.0, 30.0), (8.0, 29.0)]


def test_the_threshold_is_met_between_the_two_scores_around_it():
    assert seconds_to_psnr(RISING, 28.0) == pytest.approx(3.0)
    assert seconds_to_psnr(RISING, 26.0) == 2.0


def test_a_first_score_above_the_threshold_is_the_time_and_one_never_met_has_none():
    assert seconds_to_psnr(RISING, 10.0) == 1.0
    assert seconds_to_psnr(RISING, 30.1) is None
    assert seconds_to_psnr([], 1.0) is None


def test_a_later_dip_does_not_undo_having_been_there():
    assert seconds_to_psnr(RISING, 29.5) == pytest.approx(3.75)


def test_the_fastest_training_counts():
    assert fastest_to_psnr([RISING, [(0.5, 28.5)], [(1.0, 3.0)]], 28.0) == 0.5
    assert fastest_to_psnr([[(1.0, 3.0)]], 28.0) is None


def test_the_lead_is_the_least_over_their_moments_against_our_best_until_then():
    theirs = [(0.5, 40.0), (3.0, 25.0), (9.0, 29.5)]
    # at 0.5 s we had nothing to compare, at 3 s 26 dB, at 9 s the 30 dB of 4 s
    assert least_lead_db([RISING], theirs) == pytest.approx(0.5)
    assert least_lead_db([RISING, [(2.5, 24.0)]], theirs) == pytest.approx(0.5)
    assert least_lead_db([RISING], theirs[:1]) is None


def test_the_mean_over_every_nth_view():
    curve = [(1.0, [10.0, 20.0, 30.0]), (2.0, [12.0, 20.0, 40.0])]
    assert curve_on_views(curve, 1) == [(1.0, 20.0), (2.0, 24.0)]
    assert curve_on_views(curve, 2) == [(1.0, 20.0), (2.0, 26.0)]


@given(st.floats(0.01, 1e3), st.integers(1, 50), st.floats(0.001, 10))
def test_scores_are_planned_in_order_and_the_last_is_the_budget(budget_s, points, first_s):
    times = evaluation_times_s(budget_s, points, first_s)
    assert list(times) == sorted(times)
    assert times[-1] == budget_s
    assert len(times) <= max(points, 1)
    assert all(time > 0 for time in times)
