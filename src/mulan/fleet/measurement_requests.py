"""Who should measure with whom next, from what the batch solution knows of the team."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.linalg import block_diag

from mulan.localization.online_estimate import OnlineEstimate
from mulan.localization.scheduling import SchedulingConfig, next_measurements
from mulan.localization.types import Localization


def measurement_requests(
    localization: Localization, config: SchedulingConfig
) -> Mapping[str, tuple[str, ...]]:
    """Peers of each placed robot's next antenna motion, empty where none is worth it.

    Judged at every robot's last photograph by :func:`next_measurements`; each takes part in one measurement,
    and the next localization decides anew. While some robot has no place, everyone measures with everyone.
    """
    placed = {name: t for name, t in localization.trajectories.items() if len(t.time_s)}
    lost = {robot.robot for robot in localization.undetermined}
    requests: dict[str, tuple[str, ...]] = dict.fromkeys(placed, ())
    if lost:
        everyone = {*placed, *lost}
        return {name: tuple(sorted(everyone - {name})) for name in placed}
    estimate = OnlineEstimate(
        tuple(placed),
        {name: float(t.time_s[-1]) for name, t in placed.items()},
        {name: t.T_world_body[-1] for name, t in placed.items()},
        {name: t.covariance[-1] for name, t in placed.items()},
        _last_poses_covariance(localization, tuple(placed)),
        (),
        {},
    )
    for appointment in next_measurements(estimate, config):
        requests[appointment.observer] = (appointment.peer,)
    return requests


def _last_poses_covariance(localization: Localization, names: tuple[str, ...]) -> Float[NDArray, "n n"]:
    """Of the placed robots' last poses together.

    Where the joint one was not kept, of each by itself: the pairs then look less sure than they are.
    """
    joint = localization.joint_covariance
    if joint is None:
        return np.asarray(block_diag(*(localization.trajectories[n].covariance[-1] for n in names)))
    counts = [len(t.time_s) for t in localization.trajectories.values()]
    ends = dict(zip(localization.trajectories, np.cumsum(counts), strict=True))
    rows = np.concatenate([6 * (ends[name] - 1) + np.arange(6) for name in names])
    return joint[np.ix_(rows, rows)]
