"""The batch solution over all that an online session took in."""

from collections.abc import Mapping

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.graph import build_graph
from mulan.localization.online import OnlineLocalization
from mulan.localization.solve import Solution, solve_graph
from mulan.wireless.types import Bearing, Range


def solve_batch(online: OnlineLocalization) -> tuple[Solution, Mapping[str, Float[NDArray, "n 4 4"]]]:
    """Solve everything at once, started from the online poses.

    Returns:
        The solution, and the poses of every keyframe by robot, for robots the online solver has placed.
    """
    poses = online.trajectories()
    chains = {name: online.robots[name] for name in poses}

    def recorded(name: str, time_s: float) -> bool:
        return (
            name in chains and chains[name].time_s[0] <= time_s <= chains[name].time_s[len(poses[name]) - 1]
        )

    def kept(m: Bearing | Range) -> bool:
        return recorded(m.observer, m.time_s) and recorded(m.peer, online.peer_time_s(m))

    graph = build_graph(
        [chain.recorded(0, len(poses[name])) for name, chain in chains.items()],
        [b for b in online.bearings if kept(b)],
        [r for r in online.ranges if kept(r)],
        online.config.graph,
    )
    initial = gtsam.Values()
    for name, keyframes in graph.robots.items():
        # a measurement between two online keyframes makes one of its own here
        nearest = [int(np.abs(np.array(chains[name].time_s) - t).argmin()) for t in keyframes.time_s]
        for i, at in enumerate(nearest):
            step = np.linalg.solve(chains[name].T_odom_body[at], keyframes.T_odom_body[i])
            initial.insert(graph.key(name, i), gtsam.Pose3(poses[name][at] @ step))
    for key in graph.bias_keys:
        initial.insert(key, np.zeros(1))
    solution = solve_graph(graph, initial)
    solved = {
        name: np.array(
            [solution.values.atPose3(graph.key(name, keyframes.nearest(t))).matrix()
             for t in chains[name].time_s[: len(poses[name])]]
        )
        for name, keyframes in graph.robots.items()
    }  # fmt: skip
    return solution, solved
