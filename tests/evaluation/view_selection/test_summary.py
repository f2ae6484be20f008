import pytest
from scipy.stats import ttest_1samp

from mulan.evaluation.view_selection.summary import paired_difference, summarise


def figures(psnr_db, **more):
    return {"observations": {"5": {"psnr_db": psnr_db, **more}}, "plan_ms": 2.0}


def test_what_all_policies_of_a_seed_share_cancels_in_the_paired_difference():
    seeds = {s: {"ours": figures(20 + 3 * s + 1), "random": figures(20 + 3 * s)} for s in range(5)}
    gain = paired_difference(seeds, "ours", "random", "5")
    assert gain == {"mean": pytest.approx(1), "low": pytest.approx(1), "high": pytest.approx(1), "seeds": 5}
    assert summarise(seeds, ("random", "ours"), (5,))["policies"]["ours"]["views"]["5"]["psnr_db"]["std"] > 4


def test_the_interval_is_students():
    differences = [0.3, 0.9, -0.2, 0.6]
    seeds = {s: {"ours": figures(20 + d), "random": figures(20.0)} for s, d in enumerate(differences)}
    interval = ttest_1samp(differences, 0).confidence_interval(0.95)
    gain = paired_difference(seeds, "ours", "random", "5")
    assert gain is not None
    assert (gain["low"], gain["high"]) == pytest.approx((interval.low, interval.high))


def test_seeds_that_lack_a_policy_are_left_out_of_its_differences():
    seeds = {0: {"ours": figures(21.0), "random": figures(20.0)}, 1: {"ours": figures(25.0)}}
    assert paired_difference(seeds, "ours", "random", "5") == {
        "mean": 1.0,
        "low": None,
        "high": None,
        "seeds": 1,
    }
    assert paired_difference(seeds, "ours", "farthest-point", "5") is None
    row = summarise(seeds, ("ours",), (5,))["policies"]["ours"]
    assert row["seeds"] == 2
    assert set(row["views"]["5"]["minus"]) == {"random"}


def test_variance_figures_are_averaged_over_the_seeds_that_have_them():
    variance = {
        "ause": {"ensemble": 0.4, "learned": 0.8, "chance": 0.8},
        "spearman": {"ensemble": 0.4, "learned": 0.1},
        "ensemble_psnr_db": 22.0,
    }
    seeds = {0: {"ours": figures(21.0, **variance)}, 1: {"ours": figures(23.0)}}
    at = summarise(seeds, ("ours",), (5,))["policies"]["ours"]["views"]["5"]
    assert at["ause"] == variance["ause"]
    assert at["ensemble_psnr_db"]["mean"] == 22.0
