from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from mulan.errors import InputError
from mulan.wireless.range_fit import RangeFitConfig, fit_range_model
from mulan.wireless.range_model import LinkError, RangeModel, load_range_model
from mulan.wireless.recordings.uwb_samples import RangeSamples

LAWS = (
    LinkError(0.10, 0.05, 0.20, 0.40, 0.01),
    LinkError(-0.05, 0.08, 0.05, 0.30, 0.01),
    LinkError(0.02, 0.07, 0.10, 0.35, 0.01),
)
MODEL = RangeModel((("a", "b"), ("a", "c")), LAWS, {"a": 0.01, "b": 0.05, "c": -0.04}, 0.01, 5.0, 10.0, 0.0)


def draws(model: RangeModel, count: int, seed: int = 0) -> RangeSamples:
    rng = np.random.default_rng(seed)
    link = np.arange(count) % len(model.links)
    true = rng.uniform(2, 9, count)
    law = [model.laws[i] for i in link]
    bias, sigma, late, detour, gross = np.array(
        [(x.bias_m, x.sigma_m, x.late_mass, x.detour_m, x.gross_mass) for x in law]
    ).T
    kind = rng.uniform(size=count)
    error = bias + sigma * rng.normal(size=count) + (kind < late) * rng.exponential(detour)
    error += model.slope_per_m * (true - model.reference_m)
    error = np.where(kind > 1 - gross, rng.uniform(-model.span_m, model.span_m, count), error)
    return RangeSamples("draws", model.links, link, np.arange(count) * 0.1, true + error, true)


def test_density_integrates_to_one_and_to_the_cdf():
    distance = np.full(40001, 4.0)
    at = np.linspace(-12, 22, 40001)
    for number in (0, 1, 2):
        link = np.full(len(at), number)
        density = np.exp(MODEL.log_density(link, at, distance))
        mass = cumulative_trapezoid(density, at, initial=0)
        assert mass[-1] == pytest.approx(1, abs=1e-3)
        assert np.abs(mass - MODEL.cdf(link, at, distance)).max() < 1e-4


def test_regions_hold_the_claimed_share_of_draws():
    samples = draws(MODEL, 20000)
    level = MODEL.hdr_level(samples.link, samples.range_m, samples.true_range_m)
    for claimed in (0.3, 0.68, 0.95, 0.99):
        assert np.mean(level <= claimed) == pytest.approx(claimed, abs=0.015)


def test_fit_recovers_the_laws():
    fitted = fit_range_model(draws(MODEL, 40000), RangeFitConfig(iterations=80))
    for found, true in zip(fitted.laws, LAWS[:2], strict=False):
        assert found.sigma_m == pytest.approx(true.sigma_m, rel=0.05)
        assert found.late_mass == pytest.approx(true.late_mass, rel=0.25)
        assert found.detour_m == pytest.approx(true.detour_m, rel=0.2)
        at = found.bias_m + fitted.slope_per_m * (5.0 - fitted.reference_m)
        assert at == pytest.approx(true.bias_m, abs=0.005)
    assert fitted.slope_per_m == pytest.approx(0.01, abs=0.002)


def test_few_ranges_draw_a_link_to_the_others():
    many, few = draws(MODEL, 4000), draws(MODEL, 4000, seed=1)
    samples = many.where((many.link == 0) | (np.arange(4000) < 6))
    law = fit_range_model(samples, RangeFitConfig(iterations=40)).law("a", "c")
    assert 0.03 < law.sigma_m < 0.12
    assert 0 < law.late_mass < 0.3
    with pytest.raises(InputError, match="fewer than ten"):
        fit_range_model(few.where(np.arange(4000) < 5))


def test_lasting_errors_count_as_few():
    rng = np.random.default_rng(2)
    samples = draws(replace(MODEL, links=(("a", "b"),)), 6000)
    slow = np.repeat(rng.normal(size=60), 100) * 0.2
    fitted = fit_range_model(
        replace(samples, range_m=samples.true_range_m + slow + 0.01 * rng.normal(size=6000)),
        RangeFitConfig(iterations=5),
    )
    assert 4 < fitted.correlation_s < 25
    assert fitted.effective_count(600, 60.0) < 15
    assert fit_range_model(samples, RangeFitConfig(iterations=5)).correlation_s == 0


def test_outliers_are_told_from_scatter():
    link, predicted = np.zeros(4, int), np.full(4, 5.0)
    outlier = MODEL.outlier_probability(link, predicted + np.array([0.1, 0.2, 1.5, -3.0]), predicted)
    assert np.all(outlier[:2] < 0.1)
    assert np.all(outlier[2:] > 0.95)
    assert MODEL.outlier_probability(link[:1], np.array([500.0]), predicted[:1]) == 1


def test_bias_is_removed_with_its_growth():
    true = np.array([2.0, 5.0, 9.0])
    measured = true + 0.10 + 0.01 * (true - 5.0)
    assert np.allclose(MODEL.distance_m(np.zeros(3, int), measured), true)


def test_a_pair_is_one_law_in_both_directions_and_an_unseen_pair_adds_its_devices():
    assert MODEL.law("b", "a") == LAWS[0]
    assert MODEL.law("b", "c").bias_m == pytest.approx(0.02 + 0.05 - 0.04)


def test_saved_model_is_the_same(tmp_path: Path):
    MODEL.save(tmp_path / "model.json")
    assert load_range_model(tmp_path / "model.json") == MODEL


@pytest.mark.parametrize("text", ["{", "[]", '{"format": "mulan-range-model-1"}', '{"format": "other"}'])
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, text: str):
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(InputError, match=r"model\.json"):
        load_range_model(tmp_path / "model.json")


def test_a_law_with_a_negative_sigma_is_refused(tmp_path: Path):
    replace(MODEL, laws=(replace(LAWS[0], sigma_m=-1.0), *LAWS[1:])).save(tmp_path / "model.json")
    with pytest.raises(InputError, match="no error law"):
        load_range_model(tmp_path / "model.json")
