"""What the radios measured, each with its own uncertainty."""

from dataclasses import dataclass

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.wireless.link_faults import LinkFault


@dataclass(frozen=True)
class AoaProfile:
    """Received power over directions, in the observer's odometry axes.

    Attributes:
        azimuth_rad: Grid of azimuths in [-pi, pi), counter-clockwise from +x.
        elevation_rad: Grid of elevations.
        power: Profile of unit sum, one row per elevation.
    """

    azimuth_rad: Float[NDArray, "a"]
    elevation_rad: Float[NDArray, "e"]
    power: Float[NDArray, "e a"]


@dataclass(frozen=True)
class Bearing:
    """Direction from an observer's antenna to a peer's, as a small mixture plus an outlier mass.

    Each direction is a unit vector u in the observer's odometry frame; its covariance lives in the tangent
    plane spanned by (d u/d azimuth / cos(elevation), d u/d elevation). An infinite variance marks an axis the
    aperture cannot observe.

    Attributes:
        observer, peer: Robot names.
        time_s: Reference instant on the observer's clock.
        peer_time_s: The same packets on the peer's clock (the peer stood still).
        T_odom_body: Observer's body pose in its odometry frame at the reference instant.
        direction_odom: K unit vectors, best first.
        tangent_covariance: K 2x2 matrices [rad²] over (azimuth, elevation) tangents.
        weight: K probabilities; with ``outlier_mass`` they sum to one.
        outlier_mass: Probability that no hypothesis is right.
        kappa_paper: The paper's AoA uncertainty (readings.md, row 4); unit-sum profiles, not an angle.
        packets: How many paired packets were used.
        profile: The full profile, kept only where asked for.
        origin_odom_m: Point in the observer's odometry frame the directions start from (the centroid of the
            antenna path); None = the antenna at the reference instant.
        faults: What was found to be wrong with the packets and forbids no bearing.
    """

    observer: str
    peer: str
    time_s: float
    peer_time_s: float
    T_odom_body: Float[NDArray, "4 4"]
    direction_odom: Float[NDArray, "k 3"]
    tangent_covariance: Float[NDArray, "k 2 2"]
    weight: Float[NDArray, "k"]
    outlier_mass: float
    kappa_paper: float
    packets: int
    profile: AoaProfile | None = None
    origin_odom_m: Float[NDArray, "3"] | None = None
    faults: tuple[LinkFault, ...] = ()


@dataclass(frozen=True)
class Range:
    """Distance between two robots' UWB antennas.

    Attributes:
        observer, peer: Robot names.
        time_s: On the observer's clock.
        range_m: Distance.
        sigma_m: Its standard deviation, errors shared with its neighbours already counted in where a
            calibration told them.
        outlier_mass: Probability that it took a long detour or tells nothing; None = not calibrated.
        correlation_s: Ranges of this pair closer than this share their error; 0 = unknown or none.
    """

    observer: str
    peer: str
    time_s: float
    range_m: float
    sigma_m: float
    outlier_mass: float | None = None
    correlation_s: float = 0.0
