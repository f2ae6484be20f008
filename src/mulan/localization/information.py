"""Which robots the measurements do not place yet, which freedom is open, and what would close it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import so3
from mulan.localization.alignment_search import Alignment
from mulan.localization.relative_measurements import RelativeMeasurements

FREEDOMS: dict[int, tuple[str, ...]] = {4: ("heading", "position along x", "position along y", "height")}
"""Names of a start frame's unknowns, in the order of ``Alignment.information``."""
FREEDOMS[6] = ("roll", "pitch", *FREEDOMS[4])

_SAME_BASIN_SIGMAS2 = 36.0
_ALIKE_COST = 4.0
_LARGEST_POSITION_M = 1e3  # nobody is farther away; and no angle is larger than half a turn


@dataclass(frozen=True)
class Undetermined:
    """A robot that cannot be placed yet.

    Attributes:
        robot: Name.
        freedoms: What is open, the least known first: names of ``FREEDOMS``, "position" where two places fit
            alike, or "bearings and ranges" where there are none at all.
        reason: Why, in words.
        remedy: What to record.
    """

    robot: str
    freedoms: tuple[str, ...]
    reason: str
    remedy: str

    def sentence(self) -> str:
        """One sentence for a person."""
        return str(self.error())

    def error(self) -> InputError:
        """The same as an error, for callers that cannot go on without the robot."""
        return InputError(f"robot '{self.robot}'", self.freedoms[0], self.reason, self.remedy)


def no_measurements(robot: str) -> Undetermined:
    """Nothing ties the robot to the anchor."""
    return Undetermined(
        robot,
        ("bearings and ranges",),
        "there are none to the anchor or any robot tied to it",
        "record CSI or UWB between them, with one standing still while the other moves its antenna",
    )


def _information_at_antennas(
    found: Alignment, m: RelativeMeasurements, freedoms: int
) -> Float[NDArray, "d d"]:
    """The information on (turn about the robot's antennas, where they are) instead of about its start.

    A lone bearing and range place the antenna but leave the robot free to turn about it. Seen from a start
    frame far away that turn is mostly a shift, and the wrong freedom would be named.
    """
    points = np.concatenate([m.seen.target_m, m.sees.origin_m, m.antenna_odom_m])
    lever = found.R[0] @ points.mean(0)
    J = np.eye(freedoms)
    J[freedoms - 3 :, : freedoms - 3] = so3.hat(lever)[:, 6 - freedoms :]
    return J.T @ found.information @ J


def missing_freedoms(
    found: Alignment, m: RelativeMeasurements, known_within_rad: float, known_within_m: float, freedoms: int
) -> tuple[str, ...]:
    """Freedoms whose sigma is larger than asked for, the least known first.

    Args:
        found: Start frames that fit, the best first.
        m: What they were fitted to.
        known_within_rad: Sigma from which on a rotation counts as open.
        known_within_m: The same of a position.
        freedoms: 4 or 6.
    """
    unit = np.array([known_within_rad] * (freedoms - 3) + [known_within_m] * 3)
    information = unit[:, None] * _information_at_antennas(found, m, freedoms) * unit[None, :]
    value, vector = np.linalg.eigh(information)
    if value[0] >= 1.0:
        return ()
    widest = np.array([np.pi] * (freedoms - 3) + [_LARGEST_POSITION_M] * 3)
    variance = np.diag(np.linalg.inv(information + np.diag((unit / widest) ** 2)))
    open_ones = [int(i) for i in np.argsort(-variance, kind="stable") if variance[i] > 1.0]
    return tuple(FREEDOMS[freedoms][i] for i in open_ones or [int(np.abs(vector[:, 0]).argmax())])


def rival(
    found: Alignment, known_within_rad: float, known_within_m: float, freedoms: int
) -> tuple[float, float] | None:
    """(angle [rad], distance [m]) to a second solution that fits alike; None where the best stands alone."""
    turn = so3.log(found.R @ np.swapaxes(found.R[:1], 1, 2))
    turned, shift = np.linalg.norm(turn, axis=1), found.t_m - found.t_m[0]
    apart = np.concatenate([turn[:, 6 - freedoms :], shift], axis=1)
    # within one basin so many sigmas apart would cost as much more; alike at that distance is another basin
    sigmas2 = np.einsum("sd,de,se->s", apart, found.information, apart)
    far = (turned > known_within_rad) | (np.linalg.norm(shift, axis=1) > known_within_m / 2)
    alike = far & (sigmas2 > _SAME_BASIN_SIGMAS2) & (found.cost < found.cost[0] + _ALIKE_COST)
    if not alike.any():
        return None
    i = int(np.flatnonzero(alike)[0])
    return float(turned[i]), float(np.linalg.norm(shift[i]))


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _recorded(m: RelativeMeasurements) -> str:
    own, to_it = _counted(len(m.sees.origin_m), "bearing"), _counted(len(m.seen.origin_m), "bearing")
    return f"{own} of its own, {to_it} to it and {_counted(len(m.range_m), 'range')}"


def _remedy(freedom: str, m: RelativeMeasurements) -> str:
    if freedom == "height":
        return "set common_floor_sigma_m if all robots drive on one floor, or wave the antennas in 3-D loops"
    if freedom in ("heading", "roll", "pitch") and not len(m.sees.origin_m):
        return (
            "a bearing to a robot and a range place it but do not turn it: record a bearing by it, "
            "or let it move a few metres while others measure it"
        )
    return "move the antennas more (3-D loops show heights) or record bearings and ranges in both directions"


def undetermined(
    robot: str,
    found: Alignment,
    m: RelativeMeasurements,
    known_within_rad: float,
    known_within_m: float,
    freedoms: int,
) -> Undetermined | None:
    """What a robot's start frame lacks; None if it is determined."""
    missing = missing_freedoms(found, m, known_within_rad, known_within_m, freedoms)
    if len(missing) > 0:
        others = f" (nor {', '.join(missing[1:])})" if len(missing) > 1 else ""
        reason = f"is not determined{others} by {_recorded(m)}"
        return Undetermined(robot, missing, reason, _remedy(missing[0], m))
    second = rival(found, known_within_rad, known_within_m, freedoms)
    if second is None:
        return None
    angle, distance_m = second
    freedom = "heading" if angle > known_within_rad else "position"
    reason = (
        f"has two solutions that fit alike ({np.degrees(angle):.0f} degrees and {distance_m:.1f} m apart)"
    )
    return Undetermined(robot, (freedom,), reason, _remedy(freedom, m))
