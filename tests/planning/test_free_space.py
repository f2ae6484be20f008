from dataclasses import dataclass

import numpy as np
import pytest
import torch

from mulan.planning.free_space import FreeSpaceConfig, reachable_places

from .analytic_engine import BallEngine


@dataclass
class WallWithGap(BallEngine):
    """A wall in the plane x = 0.6 with a gap at y > 0.5, and a closed room about (-1.2, 0)."""

    closed: bool = False

    def density(self, points):
        x, y = points[:, 0], points[:, 1]
        wall = (x - 0.6).abs() < 0.12
        if not self.closed:
            wall &= y < 0.5
        return torch.where(wall, 50.0, 0.0)


START = np.array([0.0, 0.0, 0.4])


def test_the_way_leads_round_a_wall_and_is_as_long_as_it_is():
    config = FreeSpaceConfig(places=10_000)
    reached = reachable_places(WallWithGap(), START, config)
    behind = reached.position_m[:, 0] > 0.9
    assert behind.any()
    straight = np.linalg.norm(reached.position_m - START, axis=1)
    assert (reached.travel_m >= straight - 1e-9).all()
    corner = np.array([0.6, 0.5 + config.clearance_m, 0.4])
    round_it = np.linalg.norm(corner - START) + np.linalg.norm(reached.position_m[behind] - corner, axis=1)
    low = reached.position_m[behind][:, 1] < 0.4
    assert low.any()
    assert (reached.travel_m[behind][low] >= round_it[low] - 0.02).all()
    assert (reached.travel_m[behind] <= 1.25 * np.maximum(round_it, straight[behind])).all()


def test_nothing_is_reached_through_a_closed_wall_nor_too_near_to_it():
    config = FreeSpaceConfig(places=10_000)
    reached = reachable_places(WallWithGap(closed=True), START, config)
    assert reached.position_m[:, 0].max() <= 0.6 - 0.12 - config.clearance_m + config.spacing_m
    ball = reachable_places(BallEngine(), np.array([1.2, 0.0, 0.0]), config)
    assert np.linalg.norm(ball.position_m, axis=1).min() > 0.5


@pytest.mark.parametrize("in_the_air", [False, True])
def test_robots_on_the_ground_keep_their_height_and_kept_places_are_spread(in_the_air):
    config = FreeSpaceConfig(reach_m=1.0, in_the_air=in_the_air, places=20)
    reached = reachable_places(BallEngine(radius_m=0.0), START, config)
    assert len(reached.travel_m) == 20
    assert (np.ptp(reached.position_m[:, 2]) > 1.0) == in_the_air
    apart = np.linalg.norm(reached.position_m[:, None] - reached.position_m, axis=-1)
    assert apart[np.triu_indices(20, 1)].min() > 0.3


def test_a_robot_that_stands_too_near_can_leave_and_one_walled_in_has_nowhere_to_go():
    near = reachable_places(BallEngine(), np.array([0.6, 0.0, 0.0]), FreeSpaceConfig(spacing_m=0.1))
    assert len(near.travel_m) > 10
    inside = reachable_places(BallEngine(radius_m=5.0), START, FreeSpaceConfig())
    assert inside.position_m.shape == (0, 3)
