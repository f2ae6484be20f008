import zipfile

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.wireless.pairing import pair_indices
from mulan.wireless.recordings.strict_npz import MAX_MEMBER_BYTES, read_strict_npz
from mulan.wireless.recordings.wsr import read_wsr_run
from mulan.wireless.recordings.wsr_raw import read_wsr_raw

from .cards import npy, npz, npz_of_bytes, run_arrays
from .test_real_csi import DATA

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings in {DATA}; set MULAN_DATA")


def test_a_decoded_run_comes_back(tmp_path):
    arrays = run_arrays(np.random.default_rng(0))
    run = read_wsr_run(npz(tmp_path / "L1_x.npz", arrays))
    assert run.name == "L1_x"
    assert [link.name for link in run.links] == ["tx2", "tx3"]
    link = run.link("tx3")
    assert (link.forward.peer, link.reverse.peer) == ("tx3", "rx")
    csi = arrays["tx3_csi_tx"].astype(float)
    np.testing.assert_array_equal(link.reverse.channel[:, 0], csi[..., 0] + 1j * csi[..., 1])
    np.testing.assert_array_equal(link.forward.time_s, arrays["tx3_t_rx"])
    np.testing.assert_array_equal(run.mocap.position_m, arrays["mocap"][:, 1:])
    np.testing.assert_allclose(run.t265.T_odom_body[:, 0, 3], arrays["t265"][:, 1])
    assert run.motion_s == tuple(arrays["move_t0_t1"])


BAD = {
    "tx2_csi_rx is missing": lambda a: a.pop("tx2_csi_rx"),
    "tx2_csi_rx is of type int16": lambda a: a.update(tx2_csi_rx=a["tx2_csi_rx"].astype(np.int16)),
    "tx2_csi_tx has shape": lambda a: a.update(tx2_csi_tx=a["tx2_csi_tx"][:, :29]),
    "tx2_csi_tx is zero in every packet": lambda a: a.update(tx2_csi_tx=a["tx2_csi_tx"] * np.int8(0)),
    "tx2_t_rx has 39 rows": lambda a: a.update(tx2_t_rx=a["tx2_t_rx"][1:]),
    "tx2_t_tx does not increase": lambda a: a.update(tx2_t_tx=a["tx2_t_tx"][::-1]),
    "tx2_frame has shape": lambda a: a.update(tx2_frame=np.empty(0, np.uint32)),
    "tx2_pos is not finite": lambda a: a.update(tx2_pos=np.full(3, np.nan)),
    "mocap is not finite": lambda a: a["mocap"].__setitem__((5, 2), np.inf),
    "t265 row 0 has a quaternion of length 0": lambda a: a["t265"].__setitem__((0, 7), 0.0),
    "odom only 1 of 40 stamps": lambda a: a["odom"].__setitem__((slice(None), 0), 3.0),
    "links names one twice": lambda a: a.update(links=np.array(["tx2", "tx2"])),
    "links does not list tx3": lambda a: a.update(links=np.array(["tx2"])),
    "links is int64": lambda a: a.update(links=np.arange(2)),
    "move_t0_t1 begins at": lambda a: a.update(move_t0_t1=a["move_t0_t1"][::-1]),
    "start has shape": lambda a: a.update(start=np.zeros(2)),
}


@pytest.mark.parametrize("told", BAD)
def test_a_malformed_member_is_refused_by_name(tmp_path, told):
    arrays = run_arrays(np.random.default_rng(1))
    BAD[told](arrays)
    with pytest.raises(InputError) as caught:
        read_wsr_run(npz(tmp_path / "run.npz", arrays))
    field, problem = told.split(" ", 1)
    assert caught.value.field == field
    assert problem in caught.value.problem
    assert "run.npz" in caught.value.source


def test_one_stamp_of_motion_capture_that_steps_back_is_left_out(tmp_path):
    arrays = run_arrays(np.random.default_rng(2))
    arrays["mocap"][7, 0] = arrays["mocap"][5, 0]
    run = read_wsr_run(npz(tmp_path / "run.npz", arrays))
    assert len(run.mocap.time_s) == 39
    assert (np.diff(run.mocap.time_s) > 0).all()


def test_pickles_are_never_opened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return pytest.fail, ("a pickle was opened",)

    arrays = run_arrays(np.random.default_rng(3))
    members = {name: npy(array) for name, array in arrays.items()}
    members["links"] = npy(np.array([Bomb()], object), allow_pickle=True)
    with pytest.raises(InputError, match="not numbers or text"):
        read_wsr_run(npz_of_bytes(tmp_path / "run.npz", members))


def test_a_zip_bomb_is_refused_before_it_unpacks(tmp_path):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mocap.npy", bytes(MAX_MEMBER_BYTES + 1))
    assert path.stat().st_size < 50_000
    with pytest.raises(InputError, match=r"mocap.npy: would unpack to"):
        read_strict_npz(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(9):
            archive.writestr(f"{k}.npy", bytes(MAX_MEMBER_BYTES))
    with pytest.raises(InputError, match="archive: would unpack to"):
        read_strict_npz(path)


def test_a_header_that_promises_more_than_it_holds_is_refused(tmp_path):
    data = npy(np.zeros((3, 4)))
    for said in (b"(3, 5), ", b"(9999999999999, 4), "):
        header = data.replace(b"(3, 4), ", said)[: len(data)]
        with pytest.raises(InputError, match=r"x\.npy"):
            read_strict_npz(npz_of_bytes(tmp_path / "x.npz", {"x": header}))
    for rubbish in (b"", b"\x93NUMPY\x01\x00", data[:40], b"\x93NUMPY\x09\x00" + data[8:]):
        with pytest.raises(InputError, match="npy header"):
            read_strict_npz(npz_of_bytes(tmp_path / "x.npz", {"x": rubbish}))


def test_what_is_no_archive_is_refused(tmp_path):
    path = tmp_path / "run.npz"
    path.write_bytes(b"not a zip")
    with pytest.raises(InputError, match=r"no readable \.npz"):
        read_wsr_run(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_wsr_run(tmp_path / "absent.npz")


@pytest.mark.data
@needs_data
def test_raw_and_decoded_recordings_agree():
    folders = sorted(DATA.glob("*/raw/*"))
    assert len(folders) == 3
    for folder in folders:
        raw = read_wsr_raw(folder)
        decoded = read_wsr_run(folder.parents[1] / "npz" / f"{folder.name}.npz")
        assert raw.name == decoded.name
        np.testing.assert_array_equal(raw.start_m, decoded.start_m)
        np.testing.assert_allclose(raw.motion_s, decoded.motion_s, rtol=0, atol=0.01)
        np.testing.assert_array_equal(raw.mocap.position_m, decoded.mocap.position_m)
        np.testing.assert_array_equal(raw.t265.T_odom_body, decoded.t265.T_odom_body)
        np.testing.assert_array_equal(raw.odometry.time_s, decoded.odometry.time_s)
        assert {link.name for link in raw.links} == {link.name for link in decoded.links}
        for link in raw.links:
            other = decoded.link(link.name)
            i, j = pair_indices(link.forward, link.reverse)
            window = np.isin(link.forward.frame_counter[i], other.forward.frame_counter)
            i, j = i[window], j[window]
            np.testing.assert_array_equal(link.forward.frame_counter[i], other.forward.frame_counter)
            np.testing.assert_array_equal(link.source_position_m, other.source_position_m)
            for rows, mine, theirs in ((i, link.forward, other.forward), (j, link.reverse, other.reverse)):
                np.testing.assert_array_equal(mine.time_s[rows], theirs.time_s)
                np.testing.assert_array_equal(mine.channel[rows, 0], theirs.channel[:, 0])


@pytest.mark.data
@needs_data
def test_every_published_run_is_read():
    files = sorted(DATA.glob("*/npz/*.npz"))
    assert len(files) == 80
    assert sum(len(read_wsr_run(file).links) for file in files) == 200
