from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.wireless.channel import channel_at_centre, pair_packets

from .signals import INDEX, SUBCARRIER_HZ, two_robots


def test_timing_slope_is_removed_without_touching_the_centre_phase():
    rng = np.random.default_rng(0)
    centre = np.exp(1j * rng.uniform(-np.pi, np.pi, 300))
    delay = rng.uniform(-300e-9, 300e-9, 300)
    channel = centre[:, None] * np.exp(-2j * np.pi * 312_500.0 * INDEX * delay[:, None])
    noise = 0.05 * (rng.normal(size=channel.shape) + 1j * rng.normal(size=channel.shape))
    error = np.angle(channel_at_centre(channel + noise, SUBCARRIER_HZ) / centre)
    assert np.abs(error).max() < 0.06
    assert np.sqrt(np.mean(error**2)) < 1.15 * 0.05 / np.sqrt(30)


def test_the_product_of_both_directions_cancels_the_carrier_offset():
    (alpha, beta), _ = two_robots(np.random.default_rng(1))
    pairs = pair_packets(alpha, beta)
    still = (pairs.time_s > 2.52) & (pairs.time_s < 3.15)  # nobody moves: the round-trip phase is constant
    turned = pairs.channel[still].mean(1) / np.abs(pairs.channel[still].mean(1))
    assert len(turned) > 10
    assert np.abs(turned.mean()) > 0.85


def test_pairs_are_matched_by_counter_across_clocks():
    (alpha, beta), _ = two_robots(np.random.default_rng(2), clock_offset_s=12.0)
    pairs = pair_packets(alpha, beta)
    np.testing.assert_allclose(pairs.peer_time_s - pairs.time_s, 12.0)
    assert len(pairs.time_s) < min(len(alpha.csi["beta"].time_s), len(beta.csi["alpha"].time_s))
    swapped = pairs.swapped()
    assert swapped.observer == "beta"
    np.testing.assert_array_equal(swapped.channel, pairs.channel)


@pytest.mark.parametrize(
    ("values", "word"), [(0.0 + 0j, "zero"), (np.nan + 0j, "finite"), (2.0 + 1j, "constant")]
)
def test_dead_csi_is_refused_by_name(values, word):
    (alpha, beta), _ = two_robots(np.random.default_rng(3))
    track = beta.csi["alpha"]
    dead = replace(beta, csi={"alpha": replace(track, channel=np.full_like(track.channel, values))})
    with pytest.raises(InputError, match=word) as caught:
        pair_packets(alpha, dead)
    assert caught.value.source == "/beta/csi/alpha"


def test_one_sided_recording_and_foreign_counters_are_refused():
    (alpha, beta), _ = two_robots(np.random.default_rng(4))
    with pytest.raises(InputError, match="both robots"):
        pair_packets(alpha, replace(beta, csi={}))
    track = beta.csi["alpha"]
    foreign = replace(track, frame_counter=track.frame_counter + np.uint32(10**6))
    with pytest.raises(InputError, match="frame_counter"):
        pair_packets(alpha, replace(beta, csi={"alpha": foreign}))


def test_a_few_broken_packets_are_left_out():
    (alpha, beta), _ = two_robots(np.random.default_rng(5))
    track = beta.csi["alpha"]
    channel = track.channel.copy()
    channel[:7] = np.nan
    channel[7:11] = 0
    pairs = pair_packets(alpha, replace(beta, csi={"alpha": replace(track, channel=channel)}))
    assert np.isfinite(pairs.channel).all()
    assert (np.abs(pairs.channel) > 0).all()
