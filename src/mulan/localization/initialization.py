"""Every robot's start frame in the world, before the graph: robust alignment along a tree from the anchor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3, so3
from mulan.localization.alignment_search import search_alignment
from mulan.localization.information import Undetermined, no_measurements, undetermined
from mulan.localization.relative_measurements import RelativeMeasurements, gather
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing, Range


@dataclass(frozen=True)
class InitializationConfig:
    """How start frames are found before the graph refines them."""

    headings: int = 24
    """Headings tried."""
    smallest_sigma_deg: float = 1.5
    """Floor of a bearing's sigma, for the odometry drift ignored here."""
    smallest_sigma_m: float = 0.1
    """Floor of a range's sigma, for the odometry drift ignored here."""
    most_ranges: int = 100
    """Ranges used to place one robot, evenly picked."""
    known_within_rad: float = 0.5
    """A rotation less certain than this (one sigma) counts as missing."""
    known_within_m: float = 2.0
    """A position less certain than this (one sigma) counts as missing."""


def _start_positions(m: RelativeMeasurements, R: Float[NDArray, "s 3 3"]) -> Float[NDArray, "s 3"]:
    """Given the rotation every bearing is a line the start position lies near: least squares with a pull."""
    origin = np.concatenate(
        [
            m.seen.origin_m - np.einsum("sij,mj->smi", R, m.seen.target_m),
            m.sees.target_m - np.einsum("sij,mj->smi", R, m.sees.origin_m),
        ],
        axis=1,
    )
    direction = np.concatenate(
        [np.broadcast_to(m.seen.direction, (len(R), *m.seen.direction.shape)),
         -np.einsum("sij,mj->smi", R, m.sees.direction)],
        axis=1,
    )  # fmt: skip
    reach = float(np.median(m.range_m)) if len(m.range_m) else 3.0
    P = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    # nearly parallel lines leave the distance open: a weak pull to the measured range along them settles it
    A = P.sum(1) + 0.05 * direction.shape[1] * np.eye(3)
    b = (P @ origin[..., None]).sum(1)[..., 0] + 0.05 * (origin + reach * direction).sum(1)
    return np.linalg.solve(A, b[..., None])[..., 0]


def _starts(
    m: RelativeMeasurements, config: InitializationConfig, freedoms: int
) -> tuple[Float[NDArray, "s 3 3"], Float[NDArray, "s 3"]]:
    R = so3.about_z(np.linspace(-np.pi, np.pi, config.headings, endpoint=False))
    if freedoms == 6:
        tilts = so3.exp(np.array([[a, b, 0.0] for a in (-1.0, 0.0, 1.0, 3.1) for b in (-1.0, 0.0, 1.0)]))
        R = (tilts[:, None] @ R[None]).reshape(-1, 3, 3)
    if len(m.seen.origin_m) + len(m.sees.origin_m):
        return R, _start_positions(m, R)
    around = np.array(
        [[a, b, c] for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1) if a or b or c], float
    )
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    centre = m.antenna_world_m.mean(0) + np.median(m.range_m) * around
    t = centre[None] - np.einsum("sij,j->si", R, m.antenna_odom_m.mean(0))[:, None]
    return np.repeat(R, len(around), axis=0), t.reshape(-1, 3)


@dataclass(frozen=True)
class TeamAlignment:
    """Start frames found, and the robots that have too little information for one.

    Attributes:
        T_world_odom: By name; the anchor's is the identity.
        undetermined: The others, with what they lack.
    """

    T_world_odom: Mapping[str, Float[NDArray, "4 4"]]
    undetermined: tuple[Undetermined, ...]


def initial_alignment(
    robots: Sequence[RobotLog],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    config: InitializationConfig,
    gravity_aligned: bool = True,
    common_floor_sigma_m: float | None = None,
) -> Mapping[str, Float[NDArray, "4 4"]]:
    """``T_world_odom`` of every robot, as ``align_team`` finds them.

    Raises:
        InputError: A robot has too little information; says which robot and which freedom.
    """
    aligned = align_team(robots, bearings, ranges, config, gravity_aligned, common_floor_sigma_m)
    if aligned.undetermined:
        raise aligned.undetermined[0].error()
    return aligned.T_world_odom


def align_team(
    robots: Sequence[RobotLog],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    config: InitializationConfig,
    gravity_aligned: bool = True,
    common_floor_sigma_m: float | None = None,
) -> TeamAlignment:
    """Start frames of all robots that can be placed; the first robot's is the identity.

    Robots join one after another, the best connected first, each aligned to all that were placed before: yaw
    and translation (or all six freedoms) from many starts, solved together and ranked by robust cost. Those
    left over when no other can join are undetermined.
    """
    freedoms = 4 if gravity_aligned else 6
    anchor = robots[0]
    placed: dict[str, tuple[RobotLog, Float[NDArray, "4 4"]]] = {anchor.name: (anchor, np.eye(4))}
    waiting = list(robots[1:])
    by_robot = {robot.name: _taking_part(robot.name, bearings, ranges) for robot in robots}
    refused: list[Undetermined] = []
    while waiting:
        refused = []
        waiting.sort(key=lambda robot: (-_tied(robot.name, placed, *by_robot[robot.name]), robot.name))
        for robot in waiting:
            m = gather(
                robot,
                placed,
                *by_robot[robot.name],
                np.deg2rad(config.smallest_sigma_deg),
                config.smallest_sigma_m,
                config.most_ranges,
            )
            T = _place(robot, anchor, m, config, freedoms, common_floor_sigma_m)
            if isinstance(T, Undetermined):
                refused.append(T)
                continue
            placed[robot.name] = (robot, T)
            waiting.remove(robot)
            break
        else:
            break
    return TeamAlignment({name: T for name, (_, T) in placed.items()}, tuple(refused) if waiting else ())


def _taking_part(
    name: str, bearings: Sequence[Bearing], ranges: Sequence[Range]
) -> tuple[list[Bearing], list[Range]]:
    """Measurements a robot made or was the target of."""
    return [b for b in bearings if name in (b.observer, b.peer)], [
        r for r in ranges if name in (r.observer, r.peer)
    ]


def _tied(name: str, placed: Mapping[str, object], bearings: list[Bearing], ranges: list[Range]) -> int:
    """How well a robot is connected to the placed ones: a bearing counts as ten ranges."""

    def among(pair: Bearing | Range) -> bool:
        return (pair.peer if pair.observer == name else pair.observer) in placed

    return 10 * sum(map(among, bearings)) + sum(map(among, ranges))


def _place(
    robot: RobotLog,
    anchor: RobotLog,
    m: RelativeMeasurements,
    config: InitializationConfig,
    freedoms: int,
    common_floor_sigma_m: float | None,
) -> Float[NDArray, "4 4"] | Undetermined:
    if m.count == 0:
        return no_measurements(robot.name)
    if common_floor_sigma_m is not None:
        m = replace(
            m,
            floor_odom_m=float(robot.odometry.T_odom_body[0, 2, 3]),
            floor_world_m=float(anchor.odometry.T_odom_body[0, 2, 3]),
            floor_sigma_m=max(common_floor_sigma_m, 1e-3),
        )
    found = search_alignment(m, *_starts(m, config, freedoms), freedoms)
    missing = undetermined(robot.name, found, m, config.known_within_rad, config.known_within_m, freedoms)
    return missing or se3.from_parts(found.R[0], found.t_m[0])


def align_robot(
    robot: RobotLog,
    anchor: RobotLog,
    placed: Mapping[str, tuple[RobotLog, Float[NDArray, "4 4"]]],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    config: InitializationConfig,
    gravity_aligned: bool = True,
    common_floor_sigma_m: float | None = None,
) -> Float[NDArray, "4 4"]:
    """``T_world_odom`` of one robot that joins a team already placed (name: log, T_world_odom).

    Raises:
        InputError: The robot has too little information; says which freedom.
    """
    sigma_rad = np.deg2rad(config.smallest_sigma_deg)
    m = gather(robot, placed, bearings, ranges, sigma_rad, config.smallest_sigma_m, config.most_ranges)
    T = _place(robot, anchor, m, config, 4 if gravity_aligned else 6, common_floor_sigma_m)
    if isinstance(T, Undetermined):
        raise T.error()
    return T
