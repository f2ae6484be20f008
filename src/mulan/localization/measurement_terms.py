"""All bearings and ranges of a graph as plain arrays, linearised together.

A factor written in Python costs some 50 µs each time it is linearised; a pass of numpy over all of them makes
the graph of fifty robots practical. The residuals are those of ``factors.py``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.geometry import so3
from mulan.localization.graph import BearingNode, LocalizationGraph, RangeNode, observed_in_body

_TINY = 1e-12

RowWeight = Callable[[Float[NDArray, "m"]], tuple[Float[NDArray, "m"], Float[NDArray, "m"]]]
"""From squared whitened residuals to what each costs and the weight of its square in the normal equations."""


def quadratic(squared: Float[NDArray, "m"]) -> tuple[Float[NDArray, "m"], Float[NDArray, "m"]]:
    """Plain least squares."""
    return squared / 2, np.ones_like(squared)


def huber(squared: Float[NDArray, "m"], sigmas: float = 1.345) -> tuple[NDArray, NDArray]:
    """Huber's kernel: beyond so many sigmas the cost grows linearly."""
    length = np.sqrt(squared)
    far = length > sigmas
    return (
        np.where(far, sigmas * (length - sigmas / 2), squared / 2),
        np.where(far, sigmas / np.maximum(length, _TINY), 1.0),
    )


@dataclass(frozen=True)
class Poses:
    """A graph's values as arrays in the order of the keys: rotations, positions [m], range biases [m]."""

    R: Float[NDArray, "k 3 3"]
    t_m: Float[NDArray, "k 3"]
    bias_m: Float[NDArray, "c"]


@dataclass(frozen=True)
class MeasurementTerms:
    """Bearings first, then ranges: m = b + r of them.

    Attributes:
        pose_keys, bias_keys: Keys of the graph, in the order of the arrays.
        observer, peer: Index of the pose each measurement hangs on.
        observer_body_m, peer_body_m: Points it joins, in the axes of those bodies.
        direction, basis, covariance: Of every hypothesis of each bearing, in the observer's body axes; a
            basis column of zeros and a variance of one stand for an axis that was not observed.
        log_weight: Of every hypothesis; minus infinity pads.
        axes: Number of axes each bearing observed.
        outlier_mass: Of each measurement.
        range_m, sigma_m, bias: Distance, its sigma and the index of the bias of each range.
    """

    pose_keys: tuple[int, ...]
    bias_keys: tuple[int, ...]
    observer: Int[NDArray, "m"]
    peer: Int[NDArray, "m"]
    observer_body_m: Float[NDArray, "m 3"]
    peer_body_m: Float[NDArray, "m 3"]
    direction: Float[NDArray, "b h 3"]
    basis: Float[NDArray, "b h 3 2"]
    covariance: Float[NDArray, "b h 2 2"]
    log_weight: Float[NDArray, "b h"]
    axes: Int[NDArray, "b"]
    outlier_mass: Float[NDArray, "m"]
    range_m: Float[NDArray, "r"]
    sigma_m: Float[NDArray, "r"]
    bias: Int[NDArray, "r"]

    def poses(self, values: gtsam.Values) -> Poses:
        """The graph's values as arrays."""
        T = np.array([values.atPose3(key).matrix() for key in self.pose_keys]).reshape(-1, 4, 4)
        bias_m = np.array([values.atVector(key)[0] for key in self.bias_keys], dtype=float)
        return Poses(T[:, :3, :3], T[:, :3, 3], bias_m)

    def sight(self, poses: Poses) -> tuple[Float[NDArray, "m 3"], Float[NDArray, "m 3"], NDArray]:
        """Lines of sight, as ``factors.line_of_sight``.

        The vector, the peer's point seen from the observer's body origin (both in the observer's body axes)
        and the rotation of the peer as the observer sees it.
        """
        R_o, R_p = poses.R[self.observer], poses.R[self.peer]
        in_world = (
            (R_p @ self.peer_body_m[..., None])[..., 0] + poses.t_m[self.peer] - poses.t_m[self.observer]
        )
        R_t = np.swapaxes(R_o, 1, 2)
        from_body = (R_t @ in_world[..., None])[..., 0]
        return from_body - self.observer_body_m, from_body, R_t @ R_p

    def bearing_misses(self, v: Float[NDArray, "b 3"]) -> Float[NDArray, "b h 2"]:
        """Chordal residual of every hypothesis, as ``factors.bearing_residual``."""
        u = (v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9))[:, None]
        half_cos2 = np.maximum((1 + (u * self.direction).sum(-1)) / 2, _TINY)
        across = np.einsum("bhij,bhi->bhj", self.basis, np.broadcast_to(u, self.direction.shape))
        return across / np.sqrt(half_cos2)[..., None]

    def range_misses(self, v: Float[NDArray, "r 3"], poses: Poses) -> Float[NDArray, "r"]:
        """Predicted minus measured distance [m]."""
        predicted = np.linalg.norm(v, axis=1)
        if self.bias_keys:
            predicted = predicted + poses.bias_m[self.bias]
        return predicted - self.range_m

    def linearise(
        self, poses: Poses, chosen: Int[NDArray, "b"]
    ) -> tuple[Float[NDArray, "m 2"], Float[NDArray, "m 2 6"], Float[NDArray, "m 2 6"]]:
        """Whitened residuals and their derivatives by observer and peer; a range fills only the first row."""
        v, from_body, R_o_p = self.sight(poses)
        b = len(self.direction)
        residual, by_v = np.zeros((len(v), 2)), np.zeros((len(v), 2, 3))
        length = np.maximum(np.linalg.norm(v, axis=1), 1e-9)
        u = v / length[:, None]
        pick = np.arange(b)
        m, basis, covariance = (
            self.direction[pick, chosen],
            self.basis[pick, chosen],
            self.covariance[pick, chosen],
        )
        half_cos2 = np.maximum((1 + (u[:b] * m).sum(-1)) / 2, _TINY)
        gain = half_cos2**-0.5
        basis_t = np.swapaxes(basis, 1, 2)
        across = (basis_t @ u[:b, :, None])[..., 0]
        by_u = gain[:, None, None] * basis_t - 0.25 * (half_cos2**-1.5)[:, None, None] * (
            across[:, :, None] * m[:, None]
        )
        flat = np.eye(3) - u[:b, :, None] * u[:b, None]
        whitener = np.linalg.inv(np.linalg.cholesky(covariance))
        residual[:b] = (whitener @ (gain[:, None] * across)[..., None])[..., 0]
        by_v[:b] = whitener @ by_u @ flat / length[:b, None, None]
        residual[b:, 0] = self.range_misses(v[b:], poses) / self.sigma_m
        by_v[b:, 0] = u[b:] / self.sigma_m[:, None]
        J_observer = np.concatenate([by_v @ so3.hat(from_body), -by_v], 2)
        by_peer = by_v @ R_o_p
        J_peer = np.concatenate([-by_peer @ so3.hat(self.peer_body_m), by_peer], 2)
        return residual, J_observer, J_peer


@dataclass(frozen=True)
class Hypotheses:
    """What one bearing may mean, in its observer's body axes; rows as in ``MeasurementTerms``."""

    direction: Float[NDArray, "h 3"]
    basis: Float[NDArray, "h 3 2"]
    covariance: Float[NDArray, "h 2 2"]
    log_weight: Float[NDArray, "h"]
    axes: int

    @classmethod
    def of(cls, node: BearingNode) -> "Hypotheses":
        """Of a bearing in the graph."""
        h = len(node.bearing.weight)
        direction, basis, covariance = np.zeros((h, 3)), np.zeros((h, 3, 2)), np.tile(np.eye(2), (h, 1, 1))
        axes = 2
        for k in range(h):
            u, columns, spread = observed_in_body(node, k)
            axes = columns.shape[1]
            direction[k], basis[k, :, :axes], covariance[k, :axes, :axes] = u, columns, spread
        return cls(direction, basis, covariance, np.log(np.maximum(node.bearing.weight, 1e-300)), axes)


def measurement_terms(graph: LocalizationGraph) -> MeasurementTerms:
    """Arrays of a graph's bearings and ranges."""
    keys = tuple(
        graph.key(name, i) for name, frames in graph.robots.items() for i in range(len(frames.time_s))
    )
    told = [Hypotheses.of(node) for node in graph.bearings]
    return gathered_terms(
        keys, graph.bias_keys, graph.bearings, told, graph.ranges, graph.config.range_outlier_mass
    )


def gathered_terms(
    pose_keys: tuple[int, ...],
    bias_keys: tuple[int, ...],
    bearings: Sequence[BearingNode],
    told: Sequence[Hypotheses],
    ranges: Sequence[RangeNode],
    range_outlier_mass: float,
) -> MeasurementTerms:
    """Arrays of bearings and ranges between poses.

    Args:
        pose_keys: Order of the poses in the arrays.
        bias_keys: Order of the range biases.
        bearings: Bearings.
        told: What each of them may mean.
        ranges: Ranges.
        range_outlier_mass: Of ranges that do not give their own.
    """
    at = {key: i for i, key in enumerate(pose_keys)}
    bias_at = {key: i for i, key in enumerate(bias_keys)}
    sights = [node.sight for node in (*bearings, *ranges)]
    b, h = len(bearings), max((len(t.log_weight) for t in told), default=1)
    direction, basis = np.tile([1.0, 0.0, 0.0], (b, h, 1)), np.zeros((b, h, 3, 2))
    covariance, log_weight = np.tile(np.eye(2), (b, h, 1, 1)), np.full((b, h), -np.inf)
    for i, t in enumerate(told):
        n = len(t.log_weight)
        direction[i, :n], basis[i, :n], covariance[i, :n] = t.direction, t.basis, t.covariance
        log_weight[i, :n] = t.log_weight
    mass = [node.bearing.outlier_mass for node in bearings]
    for node in ranges:
        own = node.measurement.outlier_mass
        mass.append(range_outlier_mass if own is None else own)
    return MeasurementTerms(
        pose_keys=pose_keys,
        bias_keys=bias_keys,
        observer=np.array([at[s.observer_key] for s in sights], dtype=int),
        peer=np.array([at[s.peer_key] for s in sights], dtype=int),
        observer_body_m=np.array([s.observer_body_m for s in sights], dtype=float).reshape(-1, 3),
        peer_body_m=np.array([s.peer_body_m for s in sights], dtype=float).reshape(-1, 3),
        direction=direction,
        basis=basis,
        covariance=covariance,
        log_weight=log_weight,
        axes=np.array([t.axes for t in told], dtype=int),
        outlier_mass=np.array(mass, dtype=float),
        range_m=np.array([r.measurement.range_m for r in ranges], dtype=float),
        sigma_m=np.array([r.measurement.sigma_m for r in ranges], dtype=float),
        bias=np.array([bias_at[r.bias_key] for r in ranges], dtype=int),
    )
