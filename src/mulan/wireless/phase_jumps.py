"""Sudden quarter and half turns of a card's phase: found and undone, or the recording is refused.

Some cards start or retune with their phase a multiple of π/2 off, common to all subcarriers. One direction
alone hides it under the carrier offset; it shows in the round-trip product, and between the RF chains of one
card. A jump of one direction is the jump of the product (π stays π).

The phase of the product is followed from packet to packet by the product of neighbours, each one-way channel
freed of its own delay: its shape cancels, so no estimate of an absolute delay can switch between two paths,
which would look like a jump. Around every packet the phase is then modelled as a line, with and without
a step of q π/2 in the middle, q = 1, 2, 3, and the fits are compared; a step of any other size must not fit
clearly better.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from mulan.wireless.packet_delay import channel_at_centre

_FFT = 128  # slopes tried; four times finer than the resolution of a window
_WINDOWS_AT_ONCE = 4096  # bounds the memory
_FREE_STEP_NATS = 4.0  # one free parameter fits noise better by less


@dataclass(frozen=True)
class PhaseJumpConfig:
    """When a change of phase counts as a jump of the card."""

    half_window: int = 16
    """Packets on each side that the phase is followed over; the path must be nearly straight within them."""
    least_evidence_half: float = 32.0
    """Smallest likelihood ratio [nats] of a half turn against no step."""
    least_evidence_quarter: float = 36.0
    """The same for one or three quarter turns, which noise and reflections imitate more often."""
    most_better_other: float = 0.2
    """A step of any other size may fit better by this share of the evidence (or 4 nats), not by more."""
    most_jumps: int = 8
    """A recording with more is refused (a long one, if it jumps more than once in a hundred packets)."""


@dataclass(frozen=True)
class PhaseJumps:
    """Jumps found in one sequence of packets.

    Attributes:
        row: First packet after each jump, increasing.
        quarter_turns: Size of each jump, 1 to 3 quarter turns.
        evidence: Likelihood ratio of each [nats].
        packets: Length of the sequence.
    """

    row: Int[NDArray, "k"]
    quarter_turns: Int[NDArray, "k"]
    evidence: Float[NDArray, "k"]
    packets: int

    def undone(self, channel: Complex[NDArray, "n *more"]) -> Complex[NDArray, "n *more"]:
        """A channel of the same packets with every jump turned back, relative to the first packet."""
        turns = np.zeros(self.packets, int)
        turns[self.row] = self.quarter_turns
        factor = np.array([1, -1j, -1, 1j])[np.cumsum(turns) % 4]
        return channel * factor.reshape(-1, *(1,) * (channel.ndim - 1))


def round_trip_jumps(
    forward: Complex[NDArray, "n s"],
    reverse: Complex[NDArray, "n s"],
    subcarrier_hz: Float[NDArray, "s"],
    config: PhaseJumpConfig | None = None,
) -> PhaseJumps:
    """Jumps of either card, from packets and their replies in order of time.

    Args:
        forward: Channel of each packet at one antenna.
        reverse: Channel of its reply.
        subcarrier_hz: Absolute frequencies.
        config: Thresholds.
    """
    steps = _step(forward, subcarrier_hz) * _step(reverse, subcarrier_hz)
    phase = np.concatenate([[0.0], np.cumsum(np.angle(steps))])
    return jumps_of(np.exp(1j * phase), config)


def chain_jumps(
    channel: Complex[NDArray, "n antennas s"],
    antenna: int,
    reference: int = 0,
    config: PhaseJumpConfig | None = None,
) -> PhaseJumps:
    """Jumps of one RF chain against another of the same card; carrier and timing cancel between them."""
    between = (channel[:, antenna] * channel[:, reference].conj()).sum(1)
    size = np.abs(between)
    return jumps_of(np.where(size > 0, between, 1.0) / np.where(size > 0, size, 1.0), config)


def jumps_of(phasor: Complex[NDArray, "n"], config: PhaseJumpConfig | None = None) -> PhaseJumps:
    """Jumps in a sequence of unit phasors: the strongest first, none closer than half a window to another."""
    config = config or PhaseJumpConfig()
    half, n = config.half_window, len(phasor)
    found: list[tuple[int, int, float]] = []
    if n >= 2 * half:
        least = np.array(
            [config.least_evidence_quarter, config.least_evidence_half, config.least_evidence_quarter]
        )
        evidence, other = _evidence(phasor.astype(np.complex64), half, float(least.min()))
        evidence[other - evidence > np.maximum(config.most_better_other * evidence, _FREE_STEP_NATS)] = 0.0
        evidence[evidence < least[:, None]] = 0.0
        while evidence.max() > 0:
            q, k = (int(v) for v in np.unravel_index(evidence.argmax(), evidence.shape))
            found.append((k + half, q + 1, float(evidence[q, k])))
            evidence[:, max(k - half, 0) : k + half + 1] = 0.0
    found.sort()
    row, turns, nats = (np.array([f[i] for f in found]) for i in range(3))
    return PhaseJumps(row.astype(np.int64), turns.astype(np.int64), nats.astype(float), n)


def _step(channel: Complex[NDArray, "n s"], subcarrier_hz: Float[NDArray, "s"]) -> Complex[NDArray, "n-1"]:
    return channel_at_centre(channel[1:] * channel[:-1].conj(), subcarrier_hz)


def _evidence(
    phasor: Complex[NDArray, "n"], half: int, least: float
) -> tuple[Float[NDArray, "3 m"], Float[NDArray, "m"]]:
    """Likelihood ratios of q quarter turns, and of a step of any size, in the middle of every window.

    Windows that cannot reach ``least`` are left at zero: a line through both halves, if not the best, and the
    best step of any size bound them.
    """
    count = len(phasor) - 2 * half + 1
    ratio = np.zeros((4, count))
    shift = np.exp(-2j * np.pi * half / _FFT * np.arange(_FFT)).astype(np.complex64)
    for start in range(0, count, _WINDOWS_AT_ONCE):
        part = phasor[start : start + _WINDOWS_AT_ONCE + 2 * half - 1]
        spectrum = np.fft.fft(np.lib.stride_tricks.sliding_window_view(part, half), _FFT, axis=1)
        size = np.abs(spectrum)
        free = size[:-half] + size[half:]  # the second half of a window is the first of a later one
        rows, slope = np.arange(len(free)), free.argmax(1)
        line = np.abs(spectrum[rows, slope] + spectrum[rows + half, slope] * shift[slope])
        loosest = 2 * half * np.log(_lost(line, half) / _lost(_peak(free), half))
        able = np.flatnonzero(loosest >= least)
        if len(able) == 0:
            continue
        before, after = spectrum[able], spectrum[able + half] * shift
        sums = [_peak(np.abs(before + (-1j) ** q * after)) for q in range(4)]
        lost = _lost(np.stack([*sums, _peak(free[able])]), half)
        ratio[:, start + able] = 2 * half * np.log(lost[0] / lost[1:])
    return ratio[:3], ratio[3]


def _lost(total: Float[NDArray, "*m"], half: int) -> Float[NDArray, "*m"]:
    """Share of a window's power that a coherent sum leaves unexplained."""
    return np.maximum(1 - (total / (2 * half)) ** 2, 1e-3)


def _peak(spectrum: Float[NDArray, "m f"]) -> Float[NDArray, "m"]:
    """Largest value of each row between the slopes tried, by a parabola through three of them."""
    rows, top = np.arange(len(spectrum)), spectrum.argmax(1)
    left, middle, right = (spectrum[rows, (top + shift) % _FFT] for shift in (-1, 0, 1))
    bend = np.maximum(2 * middle - left - right, 1e-6)
    return middle + (right - left) ** 2 / (8 * bend)
