import gzip
from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.evaluation.uwb.rejection import rejection
from mulan.wireless.range_fit import RangeFitConfig, fit_range_model
from mulan.wireless.recordings.uwb_chemnitz import read_chemnitz
from mulan.wireless.recordings.uwb_murp import murp_files, read_murp_pair
from mulan.wireless.recordings.uwb_planar import (
    LINKS,
    STATIC_POSES,
    read_planar_dynamic,
    read_planar_static,
)
from mulan.wireless.recordings.uwb_samples import concatenate

STATIC = next(iter(STATIC_POSES))
MURP = "01_base-1_targ-3_win-1_step-1.csv.gz"


def _gzip(path: Path, text: str) -> Path:
    path.write_bytes(gzip.compress(text.encode()))
    return path


@pytest.mark.data
def test_heading_of_the_planar_trolley_fits_its_ranges(data: Path):
    folder = data / "uwb_planar"
    run = read_planar_dynamic(
        folder / "UWB_dynamic_exp_mid.csv.gz", folder / "motion_capture_dynamic_exp_mid.csv.gz"
    )
    error = run.samples.error_m
    for link in range(len(LINKS)):
        own = error[run.samples.link == link]
        assert 1.4826 * np.median(np.abs(own - np.median(own))) < 0.09


@pytest.mark.data
def test_gross_outliers_of_the_real_trial_are_rejected(data: Path):
    files = murp_files(data / "uwb_murp")
    model = fit_range_model(
        concatenate("others", [read_murp_pair(f) for t in ("02", "05") for f in files[t]]),
        RangeFitConfig(iterations=20),
    )
    result = rejection(model, read_murp_pair(data / "uwb_murp" / MURP))
    assert result["gross"] > 50
    assert result["recall"] > 0.95
    assert result["precision"] > 0.9


@pytest.mark.data
def test_chemnitz_anchors_are_late_not_early(data: Path):
    folder = data / "uwb_indoor_chemnitz"
    run = read_chemnitz(folder / "Indoor_UWB_Input.txt", folder / "Indoor_UWB_GT.txt")
    assert len(run.samples.link) == 233
    assert 0 < np.median(run.samples.error_m) < 0.2


def test_planar_cells_left_empty_are_missing_ranges(tmp_path: Path):
    row = "2022-08-20 0:37:31.796," + ",".join(["", *["2.0"] * 23])
    run = read_planar_static(_gzip(tmp_path / STATIC, row + "\n" + row + "\n"))
    assert len(run.samples.link) == 46
    assert 0 not in run.samples.link


@pytest.mark.parametrize(
    "text",
    [
        "",
        "2022-08-20 0:37:31.796,1,2\n",
        "yesterday," + ",".join(["2"] * 24),
        "2022-08-20 0:37:31.796," + ",".join(["nan"] * 24),
        "2022-08-20 0:37:31.796," + ",".join(["-2"] * 24),
        "2022-08-20 0:37:31.796," + ",".join(["two"] * 24),
    ],
)
def test_bad_planar_files_are_refused(tmp_path: Path, text: str):
    with pytest.raises(InputError, match=STATIC):
        read_planar_static(_gzip(tmp_path / STATIC, text))


@pytest.mark.parametrize(
    "data_bytes",
    [b"", b"no gzip", gzip.compress(b"t,1_1\n0,1\n", mtime=0), gzip.compress(b"x" * 99, mtime=0)[:20]],
)
def test_bad_murp_files_are_refused(tmp_path: Path, data_bytes: bytes):
    (tmp_path / MURP).write_bytes(data_bytes)
    with pytest.raises(InputError, match="base-1"):
        read_murp_pair(tmp_path / MURP)
    with pytest.raises(InputError, match="name"):
        read_murp_pair(tmp_path / "ranges.csv.gz")


@pytest.mark.parametrize(
    "line", ["range2 0.1 2.0", "range3 1 1", "range2 0 inf 0.01 0 0 105 0", "range2 0 2 0 0 0 105 0"]
)
def test_bad_chemnitz_files_are_refused(tmp_path: Path, line: str):
    good = "odom2diff 0 0 0 0 0.1 1 1 1\n"
    (tmp_path / "in.txt").write_text(good + line + "\n")
    (tmp_path / "gt.txt").write_text("point2 0 1 1 0 0 0 0\n")
    with pytest.raises(InputError, match=r"in\.txt"):
        read_chemnitz(tmp_path / "in.txt", tmp_path / "gt.txt")
