from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.simulation.image_sources import RoomConfig, image_sources
from mulan.simulation.propagation import SPEED_OF_LIGHT_M_PER_S, Mirrors, multipath_channel
from mulan.simulation.radio import SUBCARRIER_INDEX, RadioConfig, simulate_csi

QUIET = RadioConfig(
    phase_noise_rad=0.0,
    cfo_hz=0.0,
    cfo_drift_hz_per_sqrt_s=0.0,
    timing_jitter_s=0.0,
    agc_sigma_db=0.0,
    snr_db=200.0,
    packet_loss=0.0,
)
INTERVALS = np.array([[1.0, 2.0], [5.0, 6.0]])


def _still(x: float, y: float, z: float):
    return lambda time_s: np.tile([x, y, z], (len(time_s), 1))


def _moving(time_s):
    return np.stack([0.3 * np.cos(6 * time_s), 0.3 * np.sin(6 * time_s), 1 + 0.05 * np.sin(12 * time_s)], -1)


def _pair(config: RadioConfig, room: RoomConfig | None = None, seed: int = 0):
    paths = (_moving, _still(3.0, 2.0, 1.2))
    return simulate_csi(
        ("alpha", "beta"), paths, INTERVALS, Mirrors(room), config, np.random.default_rng(seed)
    )


def test_subcarriers_are_the_thirty_of_an_intel_5300():
    assert len(SUBCARRIER_INDEX) == 30
    assert list(SUBCARRIER_INDEX[[0, 13, 14, 15, 16, 28, 29]]) == [-28, -2, -1, 1, 3, 27, 28]
    assert RadioConfig().subcarrier_hz[0] == 5.54e9 - 28 * 312_500


def test_phase_slope_over_frequency_is_the_distance():
    config = RadioConfig()
    for distance_m in (0.5, 2.0, 7.3):
        h = multipath_channel(
            np.zeros((1, 3)), np.array([[distance_m, 0.0, 0.0]]), config.subcarrier_hz, None
        )[0]
        slope = np.polyfit(config.subcarrier_hz, np.unwrap(np.angle(h)), 1)[0]
        assert -slope * SPEED_OF_LIGHT_M_PER_S / (2 * np.pi) == pytest.approx(distance_m, abs=1e-6)
        assert np.abs(h) == pytest.approx(1 / distance_m)


def test_phase_falls_as_the_distance_grows():
    frequency = np.array([5.54e9])
    receiver = np.array([[2.0, 0.0, 0.0], [2.001, 0.0, 0.0]])
    h = multipath_channel(np.zeros((2, 3)), receiver, frequency, None)[:, 0]
    turn = np.angle(h[1] * np.conj(h[0]))
    assert turn == pytest.approx(-2 * np.pi * 0.001 * 5.54e9 / SPEED_OF_LIGHT_M_PER_S, rel=1e-6)


def _mirrored_by_hand(source, low, high):
    """Six first-order images, one wall at a time."""
    images = [source]
    for axis in range(3):
        for wall in (low[axis], high[axis]):
            image = source.copy()
            image[axis] = 2 * wall - source[axis]
            images.append(image)
    return images


def test_first_order_images_are_reflections_in_the_six_walls():
    room = RoomConfig((-3.0, -2.0, 0.0), (4.0, 3.0, 2.5), wall_reflection=0.4)
    source, receiver = np.array([0.7, -1.1, 0.9]), np.array([2.2, 1.7, 1.4])
    frequency = RadioConfig().subcarrier_hz
    expected = 0
    for k, image in enumerate(_mirrored_by_hand(source, room.min_corner_m, room.max_corner_m)):
        d = np.linalg.norm(image - receiver)
        expected = expected + (1.0 if k == 0 else 0.4) / d * np.exp(
            -2j * np.pi * frequency * d / SPEED_OF_LIGHT_M_PER_S
        )
    channel = multipath_channel(source[None], receiver[None], frequency, room)[0]
    assert np.allclose(channel, expected, atol=1e-9)


def test_second_order_images_are_reflections_of_reflections():
    room = RoomConfig((-3.0, -2.0, 0.0), (4.0, 3.0, 2.5), wall_reflection=0.5, max_order=2)
    source = np.array([0.7, -1.1, 0.9])
    first = _mirrored_by_hand(source, room.min_corner_m, room.max_corner_m)[1:]
    twice = {
        tuple(np.round(i, 9))
        for f in first
        for i in _mirrored_by_hand(f, room.min_corner_m, room.max_corner_m)[1:]
    }
    twice.discard(tuple(source))
    images, amplitude = image_sources(source[None], room)
    assert {tuple(np.round(i, 9)) for i in images[0][amplitude == 0.25]} == twice
    assert len(amplitude) == 1 + 6 + 18


def test_the_channel_is_reciprocal_in_a_room():
    room, frequency = RoomConfig(max_order=2), RadioConfig().subcarrier_hz
    a, b = np.array([[0.3, -1.0, 0.8]]), np.array([[2.0, 1.5, 1.9]])
    assert np.allclose(multipath_channel(a, b, frequency, room), multipath_channel(b, a, frequency, room))


def test_the_product_of_a_pair_cancels_the_carrier_offset_and_keeps_twice_the_path_phase():
    offset = replace(QUIET, cfo_hz=20e3)
    forward, reverse = _pair(offset)
    product = (forward.channel * reverse.channel)[:, 0]
    truth = multipath_channel(
        _moving(forward.time_s), _still(3.0, 2.0, 1.2)(forward.time_s), forward.subcarrier_hz, None
    )
    residual = np.angle(product * np.conj(truth**2))
    residual = np.angle(np.exp(1j * (residual - residual[0, 0])))
    # what is left is the motion during the reply delay
    assert np.abs(residual).max() < 0.1
    raw = np.angle(forward.channel[:, 0] * np.conj(truth))
    assert np.std(np.angle(np.exp(1j * (raw - raw[0])))) > 1.0


def test_timing_jitter_tilts_the_phase_over_subcarriers_and_spares_the_centre():
    clean, _ = _pair(QUIET)
    late, _ = _pair(replace(QUIET, timing_jitter_s=50e-9))
    change = np.unwrap(np.angle(late.channel[:, 0] * np.conj(clean.channel[:, 0])), axis=1)
    slope, centre = np.polyfit(SUBCARRIER_INDEX, change.T, 1)
    assert np.std(slope) == pytest.approx(2 * np.pi * 312_500 * 50e-9, rel=0.15)
    common = np.angle(np.exp(1j * (centre - centre[0])))
    assert np.abs(common).max() < 1e-3


def test_phase_noise_and_snr_are_what_was_asked_for():
    clean, _ = _pair(QUIET)
    noisy, _ = _pair(replace(QUIET, phase_noise_rad=0.3))
    turn = np.angle(noisy.channel[:, 0] * np.conj(clean.channel[:, 0]))
    assert np.std(np.angle(np.exp(1j * (turn[:, 0] - turn[:, 0].mean())))) == pytest.approx(0.3, rel=0.15)
    grainy, _ = _pair(replace(QUIET, snr_db=10.0))
    # the generator's draws differ from the clean run only by the noise amplitude
    power = np.mean(np.abs(grainy.channel - clean.channel) ** 2) / np.mean(np.abs(clean.channel) ** 2)
    assert 10 * np.log10(1 / power) == pytest.approx(10.0, abs=0.3)


def test_packets_and_replies_share_counters_and_a_lost_packet_has_no_reply():
    forward, reverse = _pair(replace(QUIET, packet_loss=0.2))
    assert forward.peer == "beta"
    assert reverse.peer == "alpha"
    assert set(reverse.frame_counter) < set(forward.frame_counter)
    assert len(forward.time_s) == pytest.approx(320, abs=30)
    assert len(reverse.time_s) == pytest.approx(256, abs=35)
    _, i, j = np.intersect1d(forward.frame_counter, reverse.frame_counter, return_indices=True)
    assert np.allclose(reverse.time_s[j] - forward.time_s[i], 200e-6)
    for track in (forward, reverse):
        assert np.all(np.diff(track.time_s) > 0)
        assert track.frame_counter.dtype == np.uint32
        assert track.channel.shape[1:] == (1, 30)


def test_the_same_seed_gives_the_same_packets():
    first, again, other = _pair(RadioConfig()), _pair(RadioConfig()), _pair(RadioConfig(), seed=1)
    assert np.array_equal(first[1].channel, again[1].channel)
    assert not np.array_equal(first[0].channel[:100], other[0].channel[:100])


def test_an_empty_room_is_refused_in_one_sentence():
    with pytest.raises(InputError, match="min_corner_m"):
        RoomConfig((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
