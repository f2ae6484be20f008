import pytest

from mulan.evaluation.table1.summary import summarise

ORDER = ("A", "B", "C", "alone", "ours")


def seed(**psnr_db):
    return {name: {"psnr_db": value, "ssim": 0.9, "lpips": None} for name, value in psnr_db.items()}


def test_share_won_back_is_that_of_the_mean_psnrs():
    summary = summarise(
        {0: seed(A=32, B=20, C=26, alone=28, ours=31), 1: seed(A=30, B=18, C=26, alone=28, ours=31)}, ORDER
    )
    assert summary["setups"]["A"]["psnr_db"] == {"mean": 31, "std": pytest.approx(2**0.5)}
    assert summary["gap_recovered"] == {"C": pytest.approx(7 / 12), "ours": 1}
    assert summary["gap_recovered_vs_alone"] == {"C": pytest.approx(-2 / 3), "ours": 1}


def test_a_setup_missing_in_a_seed_is_compared_on_the_seeds_that_have_it():
    summary = summarise({0: seed(A=32, B=20, ours=32), 1: seed(A=30, B=10)}, ORDER)
    assert summary["gap_recovered"] == {"ours": 1}
    assert summary["gap_recovered_vs_alone"] == {"ours": None}
    assert summary["setups"]["ours"]["seeds"] == 1
    assert summary["setups"]["ours"]["psnr_db"]["std"] is None


def test_where_nothing_was_lost_there_is_no_share():
    assert summarise({0: seed(A=30, B=30, ours=31)}, ORDER)["gap_recovered"] == {"ours": None}


def test_a_figure_no_seed_has_is_none():
    summary = summarise({0: seed(A=30)}, ORDER)
    assert summary["setups"]["A"]["lpips"] is None
    assert summary["setups"]["A"]["ssim"] == 0.9
    assert summary["per_seed"]["0"]["A"]["psnr_db"] == 30
