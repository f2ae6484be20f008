"""What an aperture at one sample of a simulated robot would report, drawn from the truth."""

import numpy as np

from mulan.geometry import se3
from mulan.mission.types import RobotLog
from mulan.wireless.directions import tangent_basis
from mulan.wireless.types import Bearing


def drawn_bearing(
    rng: np.random.Generator,
    observer: RobotLog,
    peer: RobotLog,
    i: int,
    sigma_rad: float,
    outlier_share: float = 0.0,
    outlier_mass: float = 0.05,
    level: bool = False,
) -> tuple[Bearing, bool]:
    """One direction with Gaussian error, or any direction; and whether it is right.

    Args:
        rng: Source of the error.
        observer: Who measures; ground truth, odometry and lever arm are read.
        peer: Who is measured; sampled at the same instants.
        i: Sample of both.
        sigma_rad: Along each tangent.
        outlier_share: Probability that the direction is any.
        outlier_mass: The same as the bearing claims it.
        level: The aperture was level: elevation is unobserved.
    """
    assert observer.ground_truth is not None
    assert peer.ground_truth is not None
    T_observer, T_peer = observer.ground_truth.T_world_body[i], peer.ground_truth.T_world_body[i]
    v = se3.transform(T_peer, peer.wifi_antenna_body_m)
    v = v - se3.transform(T_observer, observer.wifi_antenna_body_m)
    T_odom = observer.odometry.T_odom_body[i]
    u = T_odom[:3, :3] @ T_observer[:3, :3].T @ (v / np.linalg.norm(v))
    u = u + tangent_basis(u) @ (sigma_rad * rng.normal(size=2))
    is_wrong = outlier_share >= 1 or (outlier_share > 0 and bool(rng.random() < outlier_share))
    if is_wrong:
        u = rng.normal(size=3)
    time_s = float(observer.odometry.time_s[i])
    bearing = Bearing(
        observer=observer.name,
        peer=peer.name,
        time_s=time_s,
        peer_time_s=float(peer.odometry.time_s[i]),
        T_odom_body=T_odom,
        direction_odom=(u / np.linalg.norm(u))[None],
        tangent_covariance=np.diag([sigma_rad**2, np.inf if level else sigma_rad**2])[None],
        weight=np.array([1 - outlier_mass]),
        outlier_mass=outlier_mass,
        kappa_paper=1e5,
        packets=300,
    )
    return bearing, not is_wrong
