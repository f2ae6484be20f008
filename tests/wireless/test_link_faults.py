import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.wireless.azimuth_density import azimuth_mixture
from mulan.wireless.bearing import BearingConfig, estimate_bearings
from mulan.wireless.channel import pair_packets
from mulan.wireless.link_bearing import DisplacementSource, link_bearing
from mulan.wireless.phase_jumps import jumps_of
from mulan.wireless.recordings.wsr import read_wsr_run

from .signals import two_robots
from .test_real_csi import DATA


def changed(robot, channel):
    (name, track), *_ = robot.csi.items()
    return replace(robot, csi={name: replace(track, channel=channel)})


def channel_of(robot):
    return next(iter(robot.csi.values())).channel.copy()


def with_half_turn(robot, time_s):
    channel = channel_of(robot)
    channel[next(iter(robot.csi.values())).time_s > time_s] *= -1
    return changed(robot, channel)


def near(fault, time_s):
    return fault.time_s is not None and abs(fault.time_s - time_s) < 0.02


def test_a_clean_link_has_no_faults():
    (alpha, beta), _ = two_robots(np.random.default_rng(0))
    assert pair_packets(alpha, beta).faults == ()


def test_a_half_turn_is_told_with_its_time_and_only_on_the_bearings_it_concerns():
    (alpha, beta), _ = two_robots(np.random.default_rng(1), phase_noise_rad=0.1, rate_hz=400.0, level=True)
    jumped = with_half_turn(alpha, 1.5)
    # the robots of the test start with a jerk, which may look like a turn as well
    (fault,) = (f for f in pair_packets(jumped, beta).faults if near(f, 1.5))
    assert "jumps by half a turn 1.1" in str(fault)
    bearings = estimate_bearings((jumped, beta), BearingConfig())
    assert [(b.observer, sum(near(f, 1.5) for f in b.faults)) for b in bearings] == [
        ("alpha", 1),
        ("beta", 0),
    ]
    assert any(near(f, 9.0) for f in pair_packets(jumped, beta).swapped().faults)


def test_undoing_a_half_turn_gives_the_bearing_back():
    (alpha, beta), _ = two_robots(np.random.default_rng(2), phase_noise_rad=0.1, rate_hz=400.0, level=True)
    clean = estimate_bearings((alpha, beta), BearingConfig())[0]
    jumped = with_half_turn(alpha, 1.5)
    told = estimate_bearings((jumped, beta), BearingConfig())[0]
    undone = estimate_bearings((jumped, beta), BearingConfig(undo_phase_jumps=True))[0]
    assert clean.direction_odom[0] @ undone.direction_odom[0] > np.cos(np.radians(0.5))
    assert clean.direction_odom[0] @ told.direction_odom[0] < np.cos(np.radians(1.0))
    assert "turned back" in str(undone.faults[0])


def test_a_phase_that_keeps_jumping_is_refused():
    (alpha, beta), _ = two_robots(np.random.default_rng(3), phase_noise_rad=0.1, rate_hz=400.0, level=True)
    channel = channel_of(alpha)
    for row in range(50, len(channel), 60):
        channel[row:] *= -1
    with pytest.raises(InputError, match=r"jumps 2[0-9] times by quarter turns within") as caught:
        pair_packets(changed(alpha, channel), beta)
    assert caught.value.field == "phase"


def test_a_dead_further_antenna_is_told_and_a_dead_first_one_refused():
    (alpha, beta), _ = two_robots(np.random.default_rng(4))
    channel = channel_of(alpha)
    rng = np.random.default_rng(5)
    crosstalk = 0.03 * channel * np.exp(1j * rng.normal(size=channel.shape))
    three = np.concatenate([channel, crosstalk, np.zeros_like(channel)], 1)
    found = pair_packets(changed(alpha, three), beta).faults
    assert ["antenna 2 is so weak" in str(f) or "antenna 3 is zero" in str(f) for f in found] == [True, True]
    assert "dB below" in str(found[0])
    with pytest.raises(InputError, match="first antenna is so weak") as caught:
        pair_packets(changed(alpha, three[:, [1, 0]]), beta)
    assert caught.value.source == "/alpha/csi/beta"
    with pytest.raises(InputError, match="zero"):
        pair_packets(changed(alpha, three[:, [2, 0]]), beta)


def test_long_recordings_are_searched_in_little_memory():
    rng = np.random.default_rng(6)
    phasor = np.exp(0.3j * rng.normal(size=60_000)).astype(np.complex64)
    phasor[30_000:] *= -1
    tracemalloc.start()
    jumps = jumps_of(phasor)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert jumps.row.tolist() == [30_000]
    assert peak < 60e6


@pytest.mark.data
@pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings in {DATA}; set MULAN_DATA")
def test_half_turns_injected_into_real_recordings_are_told():
    told = 0
    files = sorted((DATA / "LOS_Set_A" / "npz").glob("*.npz"))[::10]
    links = [(run, link) for run in map(read_wsr_run, files) for link in run.links]
    for run, link in links:
        track = link.forward
        middle = float(np.mean(run.motion_s))
        channel = np.where((track.time_s > middle)[:, None, None], -track.channel, track.channel)
        broken = replace(link, forward=replace(track, channel=channel))
        bearing = link_bearing(run, broken, DisplacementSource.MOCAP, BearingConfig())
        assert bearing is not None
        assert np.isfinite(azimuth_mixture(bearing).sigma_azimuth_rad)
        told += any(f.time_s is not None and abs(f.time_s - middle) < 0.2 for f in bearing.faults)
    # the cards' noise and the curved motion hide the others
    assert told >= len(links) / 3
