"""WiFi channel state of packet pairs, with the faults of real cards."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.mission.types import CsiTrack
from mulan.simulation.propagation import Propagation

SUBCARRIER_SPACING_HZ = 312_500.0
# 802.11n, 20 MHz, grouping 2: the 30 subcarriers an Intel 5300 reports
SUBCARRIER_INDEX = np.array([*range(-28, 0, 2), -1, *range(1, 28, 2), 28], dtype=float)

AntennaPath = Callable[[Float[NDArray, "n"]], Float[NDArray, "n 3"]]
"""True world position of an antenna [m] at given times [s]."""


@dataclass(frozen=True)
class RadioConfig:
    """The WiFi link and its imperfections."""

    center_frequency_hz: float = 5.54e9
    """Carrier; 5.54 GHz is 802.11 channel 108."""
    packets_per_second: float = 200.0
    """Packet pairs a second and link."""
    phase_noise_rad: float = 0.3
    """Random phase of each packet (one sigma), the same on all its subcarriers."""
    cfo_hz: float = 20e3
    """Carrier frequency offset between the two cards (one sigma over links)."""
    cfo_drift_hz_per_sqrt_s: float = 50.0
    """Random walk of that offset; what the product of a pair cannot cancel, because the reply comes later."""
    timing_jitter_s: float = 50e-9
    """Packet detection jitter (one sigma): a phase slope over the subcarriers."""
    reply_delay_s: float = 200e-6
    """From a packet to its reply."""
    agc_sigma_db: float = 1.0
    """Gain error of each packet (one sigma)."""
    snr_db: float = 25.0
    """Mean channel power over complex noise power, a subcarrier."""
    packet_loss: float = 0.02
    """Probability that a packet is lost, each way."""

    @property
    def subcarrier_hz(self) -> Float[NDArray, "30"]:
        """Absolute frequencies of the reported subcarriers."""
        return self.center_frequency_hz + SUBCARRIER_SPACING_HZ * SUBCARRIER_INDEX


def simulate_csi(
    names: tuple[str, str],
    antennas: tuple[AntennaPath, AntennaPath],
    intervals_s: Float[NDArray, "k 2"],
    propagation: Propagation,
    config: RadioConfig,
    rng: np.random.Generator,
) -> tuple[CsiTrack, CsiTrack]:
    """Paired channel measurements of one link during some intervals.

    The second robot sends, the first receives and replies; both packets carry the same counter. The first
    robot sees the carrier offset as phase +θ(t), the second as -θ(t + reply delay), so the plain product of a
    pair cancels it. Each packet has its own phase noise, timing slope, gain and complex noise. A packet that
    no path carries is lost.

    Args:
        names: The two robots.
        antennas: Where their WiFi antennas truly are.
        intervals_s: Begin and end of each recording.
        propagation: What lies between the antennas.
        config: The link.
        rng: Source of all randomness.

    Returns:
        What the first robot recorded of the second, and the second of the first.
    """
    period_s = 1.0 / config.packets_per_second
    times = [np.arange(begin, end - 1e-9, period_s) for begin, end in intervals_s]
    time_s = np.concatenate(times) if times else np.zeros(0)
    reply_time_s = time_s + config.reply_delay_s
    frequency = config.subcarrier_hz

    offset_hz = config.cfo_hz * rng.normal() + np.cumsum(
        rng.normal(size=len(time_s))
        * config.cfo_drift_hz_per_sqrt_s
        * np.sqrt(np.diff(time_s, prepend=time_s[:1] - period_s))
    )
    # whole turns between packets are unobservable, so only the phase advance matters
    theta = rng.uniform(0, 2 * np.pi) + np.cumsum(2 * np.pi * offset_hz * np.diff(time_s, prepend=time_s[:1]))
    theta_reply = theta + 2 * np.pi * offset_hz * config.reply_delay_s

    first, second = antennas
    forward = propagation.channel(second(time_s), first(time_s), frequency)
    reverse = propagation.channel(first(reply_time_s), second(reply_time_s), frequency)
    heard, answer_heard = forward.any(axis=1), reverse.any(axis=1)
    forward = _measured(forward, theta, config, rng)
    reverse = _measured(reverse, -theta_reply, config, rng)

    arrived = heard & (rng.random(len(time_s)) >= config.packet_loss)
    answered = arrived & answer_heard & (rng.random(len(time_s)) >= config.packet_loss)
    counter = np.arange(1, len(time_s) + 1, dtype=np.uint32)

    def track(peer: str, stamps: NDArray, channel: NDArray, kept: NDArray) -> CsiTrack:
        return CsiTrack(peer, stamps[kept], counter[kept], channel[kept][:, None, :], frequency)

    return track(names[1], time_s, forward, arrived), track(names[0], reply_time_s, reverse, answered)


def _measured(
    channel: Complex[NDArray, "n s"],
    carrier_phase_rad: Float[NDArray, "n"],
    config: RadioConfig,
    rng: np.random.Generator,
) -> Complex[NDArray, "n s"]:
    """What a card reports of a channel."""
    n = len(channel)
    if n == 0:
        return channel.astype(np.complex64)
    phase = carrier_phase_rad + config.phase_noise_rad * rng.normal(size=n)
    delay_s = config.timing_jitter_s * rng.normal(size=n)
    slope = -2 * np.pi * SUBCARRIER_SPACING_HZ * delay_s[:, None] * SUBCARRIER_INDEX
    gain = 10 ** (config.agc_sigma_db * rng.normal(size=n) / 20)
    noise_sigma = np.sqrt(np.mean(np.abs(channel) ** 2) * 10 ** (-config.snr_db / 10) / 2)
    noise = noise_sigma * (rng.normal(size=channel.shape) + 1j * rng.normal(size=channel.shape))
    return (gain[:, None] * (channel * np.exp(1j * (phase[:, None] + slope)) + noise)).astype(np.complex64)
