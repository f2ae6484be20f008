from pathlib import Path

import numpy as np
import pytest

from mulan.cli.evaluate_uwb import Options, evaluate
from mulan.errors import InputError
from mulan.evaluation.uwb.rejection import consensus_m, rejection
from mulan.evaluation.uwb.score import score, summary
from mulan.wireless.range_fit import RangeFitConfig, fit_range_model
from mulan.wireless.recordings.uwb_samples import RangeSamples

LINKS = tuple((f"1.{i}", f"2.{j}") for i in range(6) for j in range(6))
CONFIG = RangeFitConfig(iterations=30)


def _arrays(instants: int, seed: int, stuck_m: float = 0.0) -> RangeSamples:
    """Two rings of six antennas 3-4 m apart; 10 % of ranges are late, one antenna pair by ``stuck_m``."""
    rng = np.random.default_rng(seed)
    ring = 0.25 * np.stack([np.cos(np.arange(6)), np.sin(np.arange(6)), np.zeros(6)], axis=1)
    centre = np.linspace([3.0, 0, 0], [4.0, 0.5, 0], instants)
    true = np.linalg.norm(ring[None, :, None] - ring[None, None] - centre[:, None, None], axis=-1)
    true = true.reshape(-1)
    link = np.tile(np.arange(36), instants)
    error = 0.1 + 0.05 * rng.normal(size=len(true))
    error += (rng.uniform(size=len(true)) < 0.1) * rng.exponential(0.3, len(true)) + stuck_m * (link == 7)
    return RangeSamples("rings", LINKS, link, np.repeat(np.arange(instants) * 1.0, 36), true + error, true)


def test_held_out_ranges_are_covered_and_likelier_than_under_both_gaussians():
    train, test = _arrays(60, 0), _arrays(40, 1)
    scored = score(fit_range_model(train, CONFIG), train, test)
    figures = summary(scored.nll, scored.level)
    assert figures["calibrated"]["coverage_68"] == pytest.approx(0.68, abs=0.05)
    assert figures["calibrated"]["coverage_95"] == pytest.approx(0.95, abs=0.03)
    assert figures["calibrated"]["nll"] < figures["gaussian"]["nll"] < figures["plain"]["nll"]


def test_a_stuck_antenna_pair_is_rejected_and_the_others_tell_its_distance():
    model = fit_range_model(_arrays(60, 0), CONFIG)
    stuck = _arrays(20, 2, stuck_m=4.0)
    assert np.abs(consensus_m(model, stuck) - stuck.true_range_m)[stuck.link == 7].max() < 0.15
    result = rejection(model, stuck)
    assert result["recall"] == 1
    assert result["precision"] > 0.8


def test_a_folder_without_recordings_is_named(tmp_path: Path):
    with pytest.raises(InputError, match="uwb_murp"):
        evaluate(Options(out=tmp_path / "out", data=tmp_path))
