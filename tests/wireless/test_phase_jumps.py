from dataclasses import replace

import numpy as np
import pytest

from mulan.mission.types import CsiTrack
from mulan.wireless.antenna_faults import FaultKind, antenna_faults
from mulan.wireless.channel import freed_of_delay
from mulan.wireless.phase_jumps import chain_jumps, jumps_of, round_trip_jumps
from mulan.wireless.recordings.intel5300 import read_intel5300
from mulan.wireless.recordings.wsr import read_wsr_run

from .signals import SUBCARRIER_HZ, WAVELENGTH_M, csi_direction, helix
from .test_real_csi import DATA

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings in {DATA}; set MULAN_DATA")


def both_directions(rng, n=800, phase_noise_rad=0.1):
    """Packets and replies along a loop; carrier phases are random, one the negative of the other's."""
    distance_m = np.linalg.norm(helix(n, level=True) - np.array([3.0, 2.0, 0.0]), axis=1)
    carrier = rng.uniform(-np.pi, np.pi, n)
    return [csi_direction(distance_m, sign * carrier, rng, phase_noise_rad)[:, 0] for sign in (1, -1)]


@pytest.mark.parametrize("turns", [1, 2, 3])
@pytest.mark.parametrize("direction", [0, 1])
def test_a_turn_of_either_card_is_found_and_undone(turns, direction):
    hits = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        channels = both_directions(rng)
        clean = np.prod([freed_of_delay(c, SUBCARRIER_HZ) for c in channels], 0)
        row = int(rng.integers(60, 740))
        channels[direction][row:] *= 1j**turns
        jumps = round_trip_jumps(channels[0], channels[1], SUBCARRIER_HZ)
        assert len(jumps.row) <= 1
        if len(jumps.row) == 0:
            continue
        assert abs(jumps.row[0] - row) <= 2
        assert jumps.quarter_turns[0] == turns
        hits += 1
        jumped = np.prod([freed_of_delay(c, SUBCARRIER_HZ) for c in channels], 0)
        away = np.abs(np.arange(len(clean)) - row) > 2
        np.testing.assert_allclose(jumps.undone(jumped)[away], clean[away])
    assert hits >= (10 if turns == 2 else 8)


def test_several_turns_are_undone_one_after_the_other():
    rng = np.random.default_rng(0)
    channels = both_directions(rng)
    channels[0][200:] *= -1
    channels[1][400:] *= 1j
    channels[0][600:] *= -1
    jumps = round_trip_jumps(channels[0], channels[1], SUBCARRIER_HZ)
    assert jumps.quarter_turns.tolist() == [2, 1, 2]
    np.testing.assert_allclose(jumps.row, [200, 400, 600], atol=2)
    factor = jumps.undone(np.ones(800, complex))
    np.testing.assert_allclose(factor[[0, 300, 500, 700]], [1, -1, 1j, -1j])


def test_noise_and_motion_alone_never_look_like_a_turn():
    rng = np.random.default_rng(1)
    for noise_rad in (0.1, 0.3, 0.42):
        for _ in range(20):
            phase = 4 * np.pi / WAVELENGTH_M * np.linalg.norm(helix(1000) - [3.0, 2.0, 0.0], axis=1)
            jumps = jumps_of(np.exp(1j * (phase + noise_rad * rng.normal(size=1000))))
            assert len(jumps.row) == 0


def test_half_turns_are_found_through_the_noise_of_real_cards():
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(40):
        phase = 4 * np.pi / WAVELENGTH_M * np.linalg.norm(helix(1000) - [3.0, 2.0, 0.0], axis=1)
        row = int(rng.integers(60, 940))
        phase[row:] += np.pi
        jumps = jumps_of(np.exp(1j * (phase + 0.3 * rng.normal(size=1000))))
        found += bool((np.abs(jumps.row - row) <= 2).any())
    assert found >= 36


def test_a_turn_of_one_chain_shows_against_the_other():
    rng = np.random.default_rng(3)
    first, _ = both_directions(rng)
    second = first * np.exp(0.7j) * (1 + 0.1 * rng.normal(size=first.shape))
    second[333:] *= -1
    jumps = chain_jumps(np.stack([first, second], 1), antenna=1)
    assert (jumps.row.tolist(), jumps.quarter_turns.tolist()) == ([333], [2])
    assert len(chain_jumps(np.stack([first, first], 1), antenna=1).row) == 0


def test_short_tracks_have_no_jumps():
    assert len(jumps_of(np.ones(10, complex)).row) == 0


@pytest.mark.data
@needs_data
def test_turns_are_rare_on_real_recordings():
    links, fired = 0, 0
    for file in sorted(DATA.glob("*/npz/*.npz"))[::6]:
        for link in read_wsr_run(file).links:
            sides = [track.channel[:, 0] for track in (link.forward, link.reverse)]
            fired += len(round_trip_jumps(sides[0], sides[1], link.forward.subcarrier_hz).row) > 0
            links += 1
    assert links >= 30
    assert fired / links < 0.15


def track(channel):
    n = len(channel)
    return CsiTrack("beta", np.arange(float(n)), np.arange(n, dtype=np.uint32), channel, SUBCARRIER_HZ)


def test_dead_antennas_are_named():
    rng = np.random.default_rng(5)
    channel = rng.normal(size=(50, 6, 30)) + 1j * rng.normal(size=(50, 6, 30))
    channel[:, 1] = 0
    channel[5:, 2] = np.nan
    channel[:, 3] = 1 + 2j
    channel[:, 4] *= 0.05
    faults = antenna_faults(track(channel))
    assert [(f.antenna, f.kind) for f in faults] == [
        (1, FaultKind.ZERO),
        (2, FaultKind.NOT_FINITE),
        (3, FaultKind.CONSTANT),
        (4, FaultKind.WEAK),
    ]
    assert faults[3].below_strongest_db == pytest.approx(26, abs=3)
    assert antenna_faults(replace(track(channel), channel=channel[:, [0, 5]])) == ()


@pytest.mark.data
@needs_data
def test_unconnected_antennas_of_real_cards_are_named():
    for file in sorted(DATA.glob("*/raw/*/*.dat")):
        packets = read_intel5300(file)
        for mac in packets.senders:
            faults = antenna_faults(packets.track("peer", mac))
            assert [(fault.antenna, fault.kind) for fault in faults] == [
                (1, FaultKind.WEAK),
                (2, FaultKind.WEAK),
            ]
