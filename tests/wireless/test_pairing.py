from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.mission.types import CsiTrack
from mulan.wireless.pairing import align_clocks, pair_indices, pairs_by_time
from mulan.wireless.recordings.wsr import read_wsr_run

from .signals import SUBCARRIER_HZ
from .test_real_csi import DATA


def two_tracks(rng, packets=600, offset_s=41.3, drift=70e-6, jitter_s=40e-6, lost=0.02, wrap=2**32):
    """Packets of a rate loop and replies on a clock of its own; returns tracks and true packet numbers."""
    sent_s = 1000.0 + np.cumsum(8.2e-3 + 0.15e-3 * rng.normal(size=packets))
    tracks, kept = [], []
    for peer, clock in (("beta", sent_s), ("alpha", sent_s + offset_s + drift * (sent_s - 1000.0))):
        rows = np.flatnonzero(rng.random(packets) > lost)
        counter = ((rows + 2**32 - 100) % wrap).astype(np.uint32)
        time_s = clock[rows] + jitter_s * rng.normal(size=len(rows))
        tracks.append(CsiTrack(peer, time_s, counter, np.ones((len(rows), 1, 30), complex), SUBCARRIER_HZ))
        kept.append(rows)
    return *tracks, *kept


def hidden(track):
    return replace(track, frame_counter=track.frame_counter + np.uint32(2**31))


def test_pairs_share_their_counter_even_where_it_wraps_around():
    forward, reverse, i_true, j_true = two_tracks(np.random.default_rng(0))
    i, j = pair_indices(forward, reverse)
    np.testing.assert_array_equal(i_true[i], j_true[j])
    assert len(i) == len(np.intersect1d(i_true, j_true))
    assert (np.diff(forward.time_s[i]) > 0).all()


@pytest.mark.parametrize("wrap", [256, 64])
def test_a_short_counter_that_repeats_is_resolved_by_the_clocks_common_offset(wrap):
    forward, reverse, i_true, j_true = two_tracks(np.random.default_rng(1), packets=3000, wrap=wrap, lost=0.1)
    i, j = pair_indices(forward, reverse)
    np.testing.assert_array_equal(i_true[i], j_true[j])
    assert len(i) == len(np.intersect1d(i_true, j_true))


def test_a_retransmission_is_used_once():
    forward, reverse, i_true, j_true = two_tracks(np.random.default_rng(2), lost=0.0)
    again = np.sort(np.concatenate([np.arange(len(forward.time_s)), [5, 50, 333]]))
    time_s = forward.time_s[again].copy()
    time_s[1:][np.diff(again) == 0] += 1.5e-3  # the repetition comes later than its original
    doubled = replace(
        forward,
        time_s=time_s,
        frame_counter=forward.frame_counter[again],
        channel=forward.channel[again],
    )
    i, j = pair_indices(doubled, reverse)
    assert len(i) == len(set(i.tolist())) == len(set(j.tolist())) == len(reverse.time_s)
    np.testing.assert_array_equal(i_true[again[i]], j_true[j])
    assert not np.isin(np.flatnonzero(np.diff(again) == 0) + 1, i).any()


def test_a_counter_shared_by_accident_is_left_out():
    forward, reverse, i_true, j_true = two_tracks(np.random.default_rng(3))
    counter = reverse.frame_counter.copy()
    counter[10] = forward.frame_counter[400]
    i, j = pair_indices(forward, replace(reverse, frame_counter=counter))
    np.testing.assert_array_equal(i_true[i], j_true[j])


@pytest.mark.parametrize(("offset_s", "late"), [(56.3, 0), (-0.4, 150), (3000.0, 300)])
def test_without_a_common_counter_time_pairs_the_same_packets(offset_s, late):
    forward, reverse, i_true, j_true = two_tracks(np.random.default_rng(4), packets=900, offset_s=offset_s)
    reverse = replace(
        hidden(reverse),
        time_s=reverse.time_s[late:],
        frame_counter=reverse.frame_counter[late:] + np.uint32(2**31),
        channel=reverse.channel[late:],
    )
    i, j = pair_indices(forward, reverse)
    np.testing.assert_array_equal(i_true[i], j_true[late:][j])
    assert len(i) > 0.97 * len(np.intersect1d(i_true, j_true[late:]))


def test_the_clocks_are_aligned_with_their_drift():
    forward, reverse, *_ = two_tracks(np.random.default_rng(5), drift=-80e-6)
    alignment = align_clocks(forward.time_s, reverse.time_s)
    assert alignment is not None
    np.testing.assert_allclose(alignment.drift, -80e-6, atol=3e-6)
    expected = forward.time_s + 41.3 - 80e-6 * (forward.time_s - 1000.0)
    np.testing.assert_allclose(alignment.to_reverse(forward.time_s), expected, atol=30e-6)


def test_packets_too_even_or_too_few_to_tell_are_refused():
    forward, reverse, *_ = two_tracks(np.random.default_rng(6))
    even = 8e-3 * np.arange(len(forward.time_s))
    with pytest.raises(InputError, match="do not tell which belong together") as caught:
        pair_indices(
            replace(forward, time_s=even),
            replace(hidden(reverse), time_s=8e-3 * np.arange(len(reverse.time_s))),
        )
    assert caught.value.field == "frame_counter"
    assert caught.value.source == "/alpha/csi/beta"
    assert align_clocks(forward.time_s[:20], reverse.time_s) is None
    other = np.random.default_rng(7)
    unrelated = 1000.0 + np.cumsum(8.2e-3 + 0.15e-3 * other.normal(size=600))
    assert align_clocks(forward.time_s, unrelated) is None


@pytest.mark.data
@pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings in {DATA}; set MULAN_DATA")
def test_time_alone_pairs_real_recordings_as_their_counters_do():
    wrong, found, links = 0, 0, 0
    for file in sorted(DATA.glob("*/npz/*.npz"))[::10]:
        for link in read_wsr_run(file).links:
            i, j = pairs_by_time(link.forward, link.reverse)
            wrong += int((i != j).sum())  # row k of both has one counter
            found += len(i) / len(link.forward.time_s)
            links += 1
    assert links >= 18
    assert wrong == 0
    assert found / links > 0.99
