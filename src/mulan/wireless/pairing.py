"""Which packet answers which: by frame counter, or by time where no counter occurs in both directions.

The fallback follows the WSR toolbox (Jadhav et al., IJRR 2022), which takes packets within 600 µs of each other
once the clocks are aligned. Clocks differ by tens of seconds and drift by tens of parts per million, so the offset
is estimated from the pattern of interarrival times; packets that come too evenly to tell are refused.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import CsiTrack

_PAIR_WITHIN_S = 600e-6  # WSR toolbox
_STRAY_S = 1.0  # a pair this far from the clocks' common offset shares its counter by accident
_STRAY_DRIFT = 1e-3
_BLOCK = 128  # packets compared at once; short enough that clock drift does not matter
_BLOCK_AT = (0.3, 0.5, 0.7)  # where in the forward track blocks are taken
_ANCHORS = (0, 1, 2)  # the block's first packets; one of them will have been answered
_FEWEST = 32
_SHORTLIST = 20
_BATCH = 256  # candidate offsets tried at once, which bounds memory
_CLEARLY_BETTER = 0.7  # largest ratio of the best misfit to the next offset's that counts as certain


@dataclass(frozen=True)
class ClockAlignment:
    """Clock of the reverse direction as a line over the forward one's.

    Attributes:
        offset_s: Reverse minus forward at ``reference_s``.
        drift: Seconds gained a second.
        reference_s: On the forward clock.
        misfit_s: Median absolute deviation of packets from the line.
    """

    offset_s: float
    drift: float
    reference_s: float
    misfit_s: float

    def to_reverse(self, time_s: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        """Forward times on the reverse clock."""
        return time_s + self.offset_s + self.drift * (time_s - self.reference_s)


def pair_indices(forward: CsiTrack, reverse: CsiTrack) -> tuple[Int[NDArray, "k"], Int[NDArray, "k"]]:
    """Rows of both tracks that belong together, in the order of ``forward.time_s``, each at most once.

    Counters come first. One that occurs several times (a retransmission, or a counter that wrapped) is resolved
    by the clocks' common offset. Only if no counter occurs on both sides are packets paired by time.

    Args:
        forward: What the observer received from the peer.
        reverse: What the peer received from the observer, on its own clock.

    Raises:
        InputError: No counter matches, and the times do not show the clocks' offset.
    """
    i, j = _same_counter(forward.frame_counter, reverse.frame_counter)
    if len(i) == 0:
        i, j = pairs_by_time(forward, reverse)
    else:
        i, j = _consistent(forward.time_s, reverse.time_s, i, j)
    order = np.argsort(forward.time_s[i], kind="stable")
    return i[order], j[order]


def _same_counter(forward: NDArray, reverse: NDArray) -> tuple[Int[NDArray, "k"], Int[NDArray, "k"]]:
    """All combinations of rows with equal counters."""
    order = np.argsort(reverse, kind="stable")
    ordered = reverse[order]
    first, last = (np.searchsorted(ordered, forward, side) for side in ("left", "right"))
    count = last - first
    if count.sum() > 64 * (len(forward) + len(reverse)):  # a constant counter says nothing
        return np.empty(0, np.int64), np.empty(0, np.int64)
    i = np.repeat(np.arange(len(forward)), count)
    within = np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)
    return i, order[np.repeat(first, count) + within]


def _consistent(
    forward_s: Float[NDArray, "n"], reverse_s: Float[NDArray, "m"], i: NDArray, j: NDArray
) -> tuple[Int[NDArray, "k"], Int[NDArray, "k"]]:
    """Pairs that agree on the clocks' offset, the closest first where rows compete."""
    difference = reverse_s[j] - forward_s[i]
    tolerance = _STRAY_S + _STRAY_DRIFT * float(np.ptp(forward_s[i]))
    ordered = np.sort(difference)
    inside = np.searchsorted(ordered, ordered + tolerance, "right") - np.arange(len(ordered))
    begin = int(inside.argmax())
    common = float(np.median(ordered[begin : begin + inside[begin]]))
    keep = np.flatnonzero(np.abs(difference - common) <= tolerance)
    unique = keep[_once(i[keep]) & _once(j[keep])]
    expected = np.full(len(keep), common)
    if len(unique) > 1:  # drift moves the offset by more than the gap between a packet and its repetition
        by_time = unique[np.argsort(forward_s[i[unique]], kind="stable")]
        expected = np.interp(forward_s[i[keep]], forward_s[i[by_time]], difference[by_time])
    keep = keep[np.argsort(np.abs(difference[keep] - expected), kind="stable")]
    if len(unique) == len(keep):
        return i[keep], j[keep]
    taken_i, taken_j, chosen = set(), set(), []
    for k in keep:
        if i[k] not in taken_i and j[k] not in taken_j:
            taken_i.add(i[k])
            taken_j.add(j[k])
            chosen.append(k)
    return i[chosen], j[chosen]


def _once(values: NDArray) -> NDArray:
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    return counts[inverse] == 1


def pairs_by_time(forward: CsiTrack, reverse: CsiTrack) -> tuple[Int[NDArray, "k"], Int[NDArray, "k"]]:
    """Mutually nearest packets within 600 µs of each other after clock alignment.

    Raises:
        InputError: Fewer than 32 packets, or the clocks' offset cannot be told from the times.
    """
    forward_order = np.argsort(forward.time_s, kind="stable")
    reverse_order = np.argsort(reverse.time_s, kind="stable")
    forward_s, reverse_s = forward.time_s[forward_order], reverse.time_s[reverse_order]
    alignment = align_clocks(forward_s, reverse_s)
    if alignment is None:
        raise InputError(
            f"/{reverse.peer}/csi/{forward.peer}",
            "frame_counter",
            f"no value occurs in /{forward.peer}/csi/{reverse.peer} as well, "
            "and the times of the packets do not tell which belong together",
            "give a packet and its reply the same counter",
        )
    moved_s = alignment.to_reverse(forward_s)
    j = _nearest(reverse_s, moved_s)
    back = _nearest(moved_s, reverse_s)
    i = np.flatnonzero((back[j] == np.arange(len(j))) & (np.abs(reverse_s[j] - moved_s) <= _PAIR_WITHIN_S))
    return forward_order[i], reverse_order[j[i]]


def align_clocks(forward_s: Float[NDArray, "n"], reverse_s: Float[NDArray, "m"]) -> ClockAlignment | None:
    """The clocks' offset and drift from the pattern of interarrival times, or None if it is not clear.

    Args:
        forward_s: Times of packets, increasing.
        reverse_s: Times of their replies on the other clock, increasing.
    """
    if min(len(forward_s), len(reverse_s)) < _FEWEST:
        return None
    fits: list[ClockAlignment] = []
    for part in _BLOCK_AT:
        size = min(_BLOCK, len(forward_s))
        begin = int(part * (len(forward_s) - size))
        block = forward_s[begin : begin + size]
        offsets = np.concatenate([reverse_s - block[anchor] for anchor in _ANCHORS])
        misfits = np.concatenate(
            [_misfit(block, reverse_s, offsets[k : k + _BATCH]) for k in range(0, len(offsets), _BATCH)]
        )
        for k in np.argsort(misfits)[:_SHORTLIST]:
            fit = _refined(forward_s, reverse_s, block, float(offsets[k]))
            if fit is not None:
                fits.append(fit)
    if not fits:
        return None
    best = min(fits, key=lambda fit: fit.misfit_s)
    others = [
        fit.misfit_s
        for fit in fits
        if abs(float((fit.to_reverse(forward_s[:1]) - best.to_reverse(forward_s[:1]))[0]))
        > 2 * _PAIR_WITHIN_S
    ]
    if best.misfit_s > _PAIR_WITHIN_S / 2 or (others and best.misfit_s > _CLEARLY_BETTER * min(others)):
        return None
    return best


def _nearest(sorted_s: Float[NDArray, "n"], wanted_s: Float[NDArray, "*k"]) -> Int[NDArray, "*k"]:
    """Index of the closest entry."""
    right = np.clip(np.searchsorted(sorted_s, wanted_s), 1, len(sorted_s) - 1)
    return right - (wanted_s - sorted_s[right - 1] < sorted_s[right] - wanted_s)


def _misfit(
    block_s: Float[NDArray, "b"], reverse_s: Float[NDArray, "m"], offsets_s: Float[NDArray, "c"]
) -> Float[NDArray, "c"]:
    """Median absolute deviation of a block's packets from their nearest replies, for each offset."""
    moved = block_s + offsets_s[:, None]
    residual = reverse_s[_nearest(reverse_s, moved)] - moved
    return np.median(np.abs(residual - np.median(residual, 1, keepdims=True)), 1)


def _refined(
    forward_s: Float[NDArray, "n"],
    reverse_s: Float[NDArray, "m"],
    block_s: Float[NDArray, "b"],
    offset_s: float,
) -> ClockAlignment | None:
    """Follow the line from a block outwards: fit, then widen the stretch until it is the whole track."""
    reference = float(block_s.mean())
    drift, offset = 0.0, offset_s
    reach = float(np.ptp(block_s)) / 2 + 1e-6
    whole = max(reference - forward_s[0], forward_s[-1] - reference)
    while True:
        x = forward_s[np.abs(forward_s - reference) <= reach] - reference
        moved = x + reference + offset + drift * x
        residual = reverse_s[_nearest(reverse_s, moved)] - moved
        overlap = (moved >= reverse_s[0]) & (moved <= reverse_s[-1])
        close = overlap & (np.abs(residual - np.median(residual)) < 2 * _PAIR_WITHIN_S)
        if close.sum() < max(_FEWEST // 2, 0.5 * overlap.sum()):
            return None
        slope, intercept = np.polyfit(x[close], residual[close], 1)
        drift, offset = drift + float(slope), offset + float(intercept)
        if reach >= whole:
            misfit = float(np.median(np.abs(residual[close] - slope * x[close] - intercept)))
            return ClockAlignment(offset, drift, reference, misfit)
        reach = min(2 * reach, whole)
