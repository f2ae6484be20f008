import gzip

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.mission.tum import read_tum, write_tum
from mulan.mission.types import PoseTrack

from .conftest import make_poses

GOOD = "1.0 0 0 0 0 0 0 1"


def test_a_trajectory_comes_back_as_written(tmp_path):
    time_s = 1_700_000_000.0 + np.arange(20) * 0.05
    track = PoseTrack(time_s, make_poses(20, np.random.default_rng(0)))
    path = tmp_path / "poses" / "r0.tum"
    write_tum(track, path)
    found = read_tum(path)
    np.testing.assert_array_equal(found.time_s, time_s)
    np.testing.assert_allclose(found.T_world_body, track.T_world_body, atol=1e-10)


def test_numbers_stand_in_the_order_of_the_format(tmp_path):
    path = tmp_path / "quarter_turn.tum"
    path.write_text("# t x y z qx qy qz qw\n\n2.5 1 2 3 0 0 0.70710678 0.70710678 # about z\n")
    track = read_tum(path)
    assert track.time_s.tolist() == [2.5]
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(track.T_world_body[0], expected, atol=1e-8)


def test_compressed_trajectories_are_read(tmp_path):
    path = tmp_path / "r0.txt.gz"
    path.write_bytes(gzip.compress(GOOD.encode()))
    assert len(read_tum(path).time_s) == 1


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("2.0 0 0 0 0 0 0", "line 2: has not eight finite numbers"),
        ("2.0 0 0 0 0 0 0 1 9", "line 2: has not eight finite numbers"),
        ("2.0 0 nan 0 0 0 0 1", "line 2: has not eight finite numbers"),
        ("2.0 0 zero 0 0 0 0 1", "line 2: holds something that is no number"),
        ("2.0 0 0 0 0 0 0 0.9", "line 2: the quaternion is not of unit length"),
        ("2.0 0 0 0 0 0 0 0", "line 2: the quaternion is not of unit length"),
        ("0.9 0 0 0 0 0 0 1", "line 2: the time goes backwards"),
    ],
)
def test_a_bad_line_is_named(tmp_path, line, problem):
    path = tmp_path / "r0.tum"
    path.write_text(f"{GOOD}\n{line}\n")
    with pytest.raises(InputError, match=problem):
        read_tum(path)


def test_of_lines_with_one_time_the_first_counts(tmp_path):
    path = tmp_path / "r0.tum"
    path.write_text(f"{GOOD}\n1.0 9 9 9 0 0 0 1\n2.0 5 0 0 0 0 0 1\n")
    assert read_tum(path).T_world_body[:, 0, 3].tolist() == [0.0, 5.0]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("r0.tum", b""),
        ("r0.tum", b"# only a comment\n"),
        ("r0.tum", b"\xff\xfe\x00"),
        ("r0.txt.gz", b"not gzip"),
    ],
)
def test_files_without_poses_are_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_tum(tmp_path / name)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_tum(tmp_path / "gone.tum")


@pytest.mark.data
def test_every_recorded_trajectory_reads(data):
    files = sorted(data.glob("euroc_vio/MH_0*/*.txt.gz")) + sorted(data.glob("tum_fr2_desk/*.txt.gz"))
    assert len(files) > 10
    for path in files:
        assert len(read_tum(path).time_s) > 50
