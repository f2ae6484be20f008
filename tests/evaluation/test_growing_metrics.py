import copy
import json

import pytest

from mulan.errors import InputError
from mulan.evaluation.localization.growing_metrics import GrowingMetrics
from mulan.mission.run_folder import RunFolder


def reopened(tmp_path):
    return GrowingMetrics(RunFolder(tmp_path), "mulan evaluate localization", 0)


def test_an_interrupted_run_goes_on_with_what_is_missing(tmp_path):
    first = reopened(tmp_path)
    assert first.begin("cases", {"trials": (1, 2)}) == frozenset()
    first.add("cases", "b", {"rms_m": 1.0})
    again = reopened(tmp_path)
    assert again.begin("cases", {"trials": (1, 2)}) == {"b"}
    again.add("cases", "a", {"rms_m": 2.0})
    again.end("cases", ["a", "b"])
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert list(written["cases"]) == ["a", "b"]
    assert "unfinished" not in written
    assert written["provenance"]["cases"]["seed"] == 0


def test_other_options_begin_anew_and_a_finished_part_is_measured_again(tmp_path):
    first = reopened(tmp_path)
    first.begin("cases", {"trials": 1})
    first.add("cases", "a", {"rms_m": 1.0})
    assert reopened(tmp_path).begin("cases", {"trials": 2}) == frozenset()
    first.end("cases")
    assert reopened(tmp_path).begin("cases", {"trials": 1}) == frozenset()


def test_figures_not_measured_again_are_kept(tmp_path):
    (tmp_path / "metrics.json").write_text('{"real": {"euroc_mh": {"rms_m": 1.0}}, "online": {"p95": 3.0}}')
    run = reopened(tmp_path)
    run.begin("real", {"recordings": ["uwb_planar"]}, keep=True)
    run.add("real", "uwb_planar", {"rms_m": 0.1})
    run.end("real")
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert written["real"] == {"euroc_mh": {"rms_m": 1.0}, "uwb_planar": {"rms_m": 0.1}}
    assert written["online"] == {"p95": 3.0}


def test_what_a_worker_says_is_wrong_arrives_whole():
    told = InputError("bag.mcap", "time", "goes backwards", "sort it")
    with pytest.raises(InputError, match=r"bag.mcap: time: goes backwards; sort it"):
        raise copy.copy(told)  # as a process pool does, by its reduction
