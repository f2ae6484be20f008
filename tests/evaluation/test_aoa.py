import csv
import json

import numpy as np
import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.evaluation.aoa.folder import link_sets
from mulan.evaluation.aoa.metrics import aoa_metrics
from mulan.evaluation.aoa.protocol import AoaProtocolConfig, measure_links
from mulan.wireless.link_bearing import DisplacementSource

from .wsr_folder import write_folder

YAW_RAD = 0.1
ASKED_FOR = {
    "links",
    "mean_abs_error_deg",
    "median_abs_error_deg",
    "over_20deg",
    "top3_within_10deg",
    "spearman",
    "coverage_68",
    "coverage_95",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("wsr"), yaw_rad=YAW_RAD)


@pytest.fixture(scope="module")
def measured(folder):
    links, failed = measure_links(link_sets(folder), AoaProtocolConfig(workers=1))
    assert not failed
    return links


def test_metrics_have_the_keys_asked_for(measured):
    metrics = json.loads(json.dumps(aoa_metrics([m.scored for m in measured], [])))
    for part in (metrics, metrics["authors"]):
        assert set(part["sets"]) == {"Set_X"}
        for by_source in (part["sets"]["Set_X"], part["all"]):
            assert {"mocap", "t265"} <= set(by_source)
            assert all(set(figures) >= ASKED_FOR for figures in by_source.values())
    assert metrics["all"]["pooled"]["links"] == 12
    assert metrics["authors"]["all"]["pooled"]["mean_abs_error_deg"] == pytest.approx(5.0, abs=0.05)


def test_bearings_of_a_clean_radio_are_right_and_a_turned_odometry_shows(measured):
    for m in measured:
        assert abs(m.scored.error_own_axes_deg) < 1.5
        expected = np.degrees(YAW_RAD) if m.scored.source == "t265" else 0.0
        assert m.scored.error_deg - m.scored.error_own_axes_deg == pytest.approx(expected, abs=0.05)
        # the truth seen from the start differs from that seen from the middle of the path
        assert m.scored.error_deg != pytest.approx(m.scored.error_start_deg, abs=0.1)


def test_start_truth_is_that_of_the_reference(folder, measured):
    (link_set,) = link_sets(folder)
    for m in measured:
        row = link_set.reference[m.scored.run, m.scored.link]
        assert np.degrees(m.truth.start_rad) == pytest.approx(row.true_azimuth_deg, abs=0.01)


def test_two_processes_find_what_one_finds(folder, measured):
    config = AoaProtocolConfig(sources=(DisplacementSource.MOCAP,), workers=2)
    links, _ = measure_links(link_sets(folder), config)
    alone = [m.scored for m in measured if m.scored.source == "mocap"]
    assert [(m.scored.run, m.scored.link) for m in links] == [(a.run, a.link) for a in alone]
    assert np.allclose([m.scored.error_deg for m in links], [a.error_deg for a in alone], atol=1e-6)


def test_an_unreadable_run_is_named_and_the_others_go_on(tmp_path, capsys):
    root = write_folder(tmp_path / "data", places=2)
    broken = sorted((root / "Set_X" / "npz").glob("*.npz"))[0]
    broken.write_bytes(broken.read_bytes()[:2000])
    arguments = ["evaluate", "aoa", "--data", str(root), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert run_command([*arguments, "--sources", "mocap"]) == 1
    said = capsys.readouterr().out
    assert broken.name in said
    assert "Next: mulan aoa" in said
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["sets"]["Set_X"]["mocap"]["links"] == 2
    assert metrics["sets"]["Set_X"]["mocap"]["failed"] == 1
    assert metrics["failed"][0]["run"] == broken.stem
    assert metrics["provenance"]["date"]
    with (tmp_path / "out" / "links.csv").open() as lines:
        assert len(list(csv.DictReader(lines))) == 2
    for picture in ("errors.png", "reliability.png", "error_against_sigma.png"):
        assert (tmp_path / "out" / picture).stat().st_size > 10_000


def test_a_folder_without_sets_is_refused(tmp_path):
    with pytest.raises(InputError, match="no sub-folder holds npz/"):
        link_sets(tmp_path)


def test_profile_of_a_run_is_drawn(folder, tmp_path, capsys):
    file = sorted((folder / "Set_X" / "npz").glob("*.npz"))[0]
    picture = tmp_path / "profile.png"
    assert run_command(["aoa", str(file), "--link", "tx3", "--out", str(picture)]) == 0
    assert picture.stat().st_size > 20_000
    said = capsys.readouterr().out
    assert "unobservable" in said
    assert "truth" in said
    with pytest.raises(InputError, match="link 'tx9'"):
        run_command(["aoa", str(file), "--link", "tx9", "--out", str(picture)])


def test_calibration_is_fitted_saved_and_used(tmp_path, capsys):
    root = write_folder(tmp_path / "data", places=6)
    file = tmp_path / "calibration.json"
    arguments = ["--data", str(root), "--workers", "1"]
    assert (
        run_command(["calibrate", *arguments, "--out", str(file), "--source", "mocap", "--folds", "6"]) == 0
    )
    assert file.with_suffix(".png").stat().st_size > 10_000
    record = json.loads(file.read_text())
    assert record["held_out"]["links"] == 12
    assert record["held_out"]["after"]["mean_nll"] <= record["held_out"]["before"]["mean_nll"] + 0.3
    one = tmp_path / "one"
    (one / "Set_X" / "npz").mkdir(parents=True)
    (one / "Set_X" / "reference.csv").write_text((root / "Set_X" / "reference.csv").read_text())
    first = sorted((root / "Set_X" / "npz").glob("*.npz"))[0]
    (one / "Set_X" / "npz" / first.name).write_bytes(first.read_bytes())
    out = ["--data", str(one), "--workers", "1", "--sources", "mocap", "--calibration", str(file)]
    assert run_command(["evaluate", "aoa", *out, "--out", str(tmp_path / "out")]) == 0
    used = json.loads((tmp_path / "out" / "metrics.json").read_text())["provenance"]["options"]
    assert f"sigma_scale={record['sigma_scale']}" in used
    assert "after" in capsys.readouterr().out


@pytest.mark.data
def test_reference_gives_the_published_errors(data):
    published = {  # mean and median with mocap, then with T265
        "LOS_Set_A": (3.99, 3.96, 7.37, 6.24),
        "NLOS_Set_A": (19.6, 7.9, 20.6, 12.8),
        "NLOS_Set_C": (6.3, 3.8, 8.5, 7.1),
    }
    for link_set in link_sets(data / "wsr_aoa"):
        figures = []
        for source in (DisplacementSource.MOCAP, DisplacementSource.T265):
            off = [r.reported[source].azimuth_deg - r.true_azimuth_deg for r in link_set.reference.values()]
            error = np.abs((np.array(off) + 180) % 360 - 180)
            figures += [error.mean(), np.median(error)]
        assert figures == pytest.approx(published[link_set.name], abs=0.05)
