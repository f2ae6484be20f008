"""What is wrong with a link's channel: a warning where a bearing is still possible, else an error."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import CsiTrack
from mulan.wireless.antenna_faults import FaultKind, antenna_faults
from mulan.wireless.phase_jumps import PhaseJumpConfig, PhaseJumps

_ANTENNA_REMEDY = "check the antenna cable and the CSI driver, or leave this pair out"
_JUMP_REMEDY = "see whether undo_phase_jumps makes the profile sharper, or record again"
_DENSE_JUMPS_PACKETS = 100  # a recording is refused only if it also jumps more often than once in so many
_QUARTER_TURNS = {1: "a quarter turn", 2: "half a turn", 3: "three quarters of a turn"}


@dataclass(frozen=True)
class LinkFault:
    """One finding that does not forbid a bearing.

    Attributes:
        source: Which track.
        field: What in it.
        problem: What was found; completes "SOURCE: FIELD ...".
        remedy: What the user can do.
        time_s: When, on the observer's clock; None = throughout.
    """

    source: str
    field: str
    problem: str
    remedy: str
    time_s: float | None = None

    def __str__(self) -> str:
        """One sentence."""
        return f"{self.source}: {self.field}: {self.problem}; {self.remedy}."


def track_faults(track: CsiTrack, receiver: str) -> tuple[LinkFault, ...]:
    """Further antennas without a channel, as warnings.

    Args:
        track: What one robot received; only its first antenna is used, whose lever arm is known.
        receiver: Name of that robot.

    Raises:
        InputError: The first antenna has none: zero or not finite in most packets, the same in all, or so
            weak beside another that it cannot be connected.
    """
    source = f"/{receiver}/csi/{track.peer}"
    found = []
    for fault in antenna_faults(track):
        problem = fault.kind.value
        if fault.kind is FaultKind.WEAK:
            problem += f" ({fault.below_strongest_db:.0f} dB below the strongest)"
        if fault.antenna == 0:
            raise InputError(source, "channel", f"the first antenna is {problem}", _ANTENNA_REMEDY)
        found.append(
            LinkFault(source, "channel", f"antenna {fault.antenna + 1} is {problem}", "it is not used")
        )
    return tuple(found)


def jump_faults(
    jumps: PhaseJumps, source: str, time_s: Float[NDArray, "n"], undone: bool
) -> tuple[LinkFault, ...]:
    """Jumps of the round-trip phase, as warnings.

    Args:
        jumps: Found among the packets.
        source: Both tracks.
        time_s: Of each packet, on the observer's clock.
        undone: Whether they were turned back.

    Raises:
        InputError: The phase jumps too often to be followed.
    """
    most = max(PhaseJumpConfig().most_jumps, jumps.packets // _DENSE_JUMPS_PACKETS)
    if len(jumps.row) > most:
        raise InputError(
            source,
            "phase",
            f"jumps {len(jumps.row)} times by quarter turns within {jumps.packets} packets",
            "record again, or leave this pair out",
        )
    remedy = "it was turned back" if undone else _JUMP_REMEDY
    return tuple(
        LinkFault(
            source,
            "phase",
            f"jumps by {_QUARTER_TURNS[int(turns)]} {time_s[row] - time_s[0]:.2f} s after the first packet",
            remedy,
            float(time_s[row]),
        )
        for row, turns in zip(jumps.row, jumps.quarter_turns, strict=True)
    )


def faults_during(faults: tuple[LinkFault, ...], time_s: Float[NDArray, "n"]) -> tuple[LinkFault, ...]:
    """Those that concern a stretch of packets."""
    begin, end = float(np.min(time_s)), float(np.max(time_s))
    return tuple(f for f in faults if f.time_s is None or begin < f.time_s <= end)
