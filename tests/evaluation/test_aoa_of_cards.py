"""``mulan aoa`` on the files of two cards and a path."""

import numpy as np
import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.geometry import se3
from mulan.mission.tum import write_tum
from mulan.mission.types import PoseTrack
from tests.wireless.cards import record
from tests.wireless.signals import csi_direction
from tests.wireless.test_further_chips import atheros_record

SOURCE_M = np.array([3.0, 2.0, 0.0])


def motion(rng):
    """Poses of an antenna that moves on three quarters of a circle, packet times, and both directions."""
    time_s = 1_600_000_000.0 + np.arange(0, 5, 0.01)
    turn = 1.5 * np.pi * np.clip((time_s - time_s[0] - 1.0) / 3.0, 0, 1)
    path_m = 0.3 * np.stack([np.sin(turn), 1 - np.cos(turn), np.zeros_like(turn)], -1)
    packets_s = time_s[0] + np.sort(rng.uniform(0.2, 4.8, 1600)).round(6)
    antenna_m = np.stack([np.interp(packets_s, time_s, path_m[:, k]) for k in range(3)], -1)
    distance_m = np.linalg.norm(antenna_m - SOURCE_M, axis=1)
    carrier = rng.uniform(-np.pi, np.pi, len(packets_s))
    sides = [csi_direction(distance_m, sign * carrier, rng, 0.1)[:, 0] for sign in (1, -1)]
    T = se3.from_parts(np.tile(np.eye(3), (len(time_s), 1, 1)), path_m)
    truth_deg = np.degrees(np.arctan2(*(SOURCE_M - antenna_m.mean(0))[[1, 0]]))
    return (
        PoseTrack(time_s, T),
        packets_s,
        [np.round(90 * h / np.abs(h).max()) for h in sides],
        truth_deg,
    )


def intel_file(path, packets_s, h):
    data = b"".join(
        record(row[:, None, None], k, (int(t), round(t % 1 * 1e6)))
        for k, (t, row) in enumerate(zip(packets_s, h, strict=True))
    )
    path.write_bytes(data)


def atheros_file(path, packets_s, h):
    """The 56 tones of the same channel, interpolated."""
    index = np.array([*range(-28, 0, 2), -1, *range(1, 28, 2), 28])
    tones = np.r_[-28:0, 1:29]
    data = b""
    for t, row in zip(packets_s, h, strict=True):
        at = [np.interp(tones, index, part) for part in (np.unwrap(np.angle(row)), np.abs(row))]
        csi = np.round(5 * at[1] * np.exp(1j * at[0]))
        data += atheros_record(csi[:, None, None], round((t - 1_600_000_000.0) * 1e6))
    path.write_bytes(data)


@pytest.fixture
def files(tmp_path):
    track, packets_s, sides, truth_deg = motion(np.random.default_rng(0))
    write_tum(track, tmp_path / "path.tum")
    intel_file(tmp_path / "moving.dat", packets_s, sides[0])
    intel_file(tmp_path / "static.dat", packets_s + 17.0, sides[1])
    return tmp_path, truth_deg


def arguments(folder, *more):
    named = [str(folder / name) for name in ("moving.dat", "static.dat", "path.tum", "profile.png")]
    return ["aoa", named[0], "--reply", named[1], "--path", named[2], "--out", named[3], *more]


def azimuth_told(said):
    row = next(line for line in said.splitlines() if "direction 1" in line)
    return float(row.split()[2].rstrip("°"))


def test_two_files_and_a_path_give_a_bearing(files, capsys):
    folder, truth_deg = files
    assert run_command(arguments(folder)) == 0
    assert azimuth_told(capsys.readouterr().out) == pytest.approx(truth_deg, abs=1.5)
    assert (folder / "profile.png").stat().st_size > 20_000


def test_another_chips_files_give_the_same_bearing(files, capsys):
    pytest.importorskip("csiread", reason="the extra csi is not installed")
    folder, truth_deg = files
    track, packets_s, sides, _ = motion(np.random.default_rng(0))
    shifted = PoseTrack(track.time_s - 1_600_000_000.0, track.T_world_body)
    write_tum(shifted, folder / "path.tum")
    atheros_file(folder / "moving.dat", packets_s, sides[0])
    atheros_file(folder / "static.dat", packets_s + 5.0, sides[1])
    assert run_command(arguments(folder)) == 0
    assert azimuth_told(capsys.readouterr().out) == pytest.approx(truth_deg, abs=1.5)


def test_a_half_turn_of_the_card_is_told(files, capsys):
    folder, _ = files
    _, packets_s, sides, _ = motion(np.random.default_rng(0))
    sides[0][800:] *= -1
    intel_file(folder / "moving.dat", packets_s, sides[0])
    assert run_command(arguments(folder)) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "jumps by half a turn" in said
    assert "undo_phase_jumps" in said
    assert run_command(arguments(folder, "--bearings.undo-phase-jumps")) == 0
    assert "turned back" in " ".join(capsys.readouterr().out.split())


def test_one_file_alone_is_described_and_the_remedy_told(files):
    folder, _ = files
    with pytest.raises(
        InputError, match=r"one direction of one robot only \(1600 packets\).*--reply.*--path"
    ):
        run_command(["aoa", str(folder / "moving.dat")])


def test_a_path_on_another_clock_is_refused(files):
    folder, _ = files
    track, *_ = motion(np.random.default_rng(0))
    write_tum(PoseTrack(track.time_s - 1e9, track.T_world_body), folder / "path.tum")
    with pytest.raises(InputError, match="nothing in common with the packets"):
        run_command(arguments(folder))


def test_a_file_of_no_known_card_is_named(tmp_path):
    (tmp_path / "noise.csi").write_bytes(bytes(range(200)))
    with pytest.raises(InputError, match="which no known card writes"):
        run_command(["aoa", str(tmp_path / "noise.csi")])
