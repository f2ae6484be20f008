"""What localization says about the camera poses, as a Gaussian about its estimates."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from mulan.geometry import se3

_LEAST_VARIANCE = 1e-12  # a direction known exactly must stay invertible


@dataclass(frozen=True)
class PosePrior:
    """Gaussian over n images' poses: right perturbations (rotation rad, translation m) of the estimates.

    Attributes:
        T_world_camera: Estimates.
        robot: Number of the robot that took each image.
        covariance: Of all perturbations together, or a block an image where they are independent.
    """

    T_world_camera: Float[NDArray, "n 4 4"]
    robot: Int[NDArray, "n"]
    covariance: Float[NDArray, "m m"] | Float[NDArray, "n 6 6"]

    @property
    def is_joint(self) -> bool:
        """Whether the errors of different images are correlated."""
        return self.covariance.ndim == 2

    @property
    def blocks(self) -> Float[NDArray, "n 6 6"]:
        """Marginal covariance of each image's pose."""
        if not self.is_joint:
            return self.covariance
        n = len(self.T_world_camera)
        return np.einsum("iaib->iab", self.covariance.reshape(n, 6, n, 6)).copy()

    @cached_property
    def _eigen(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Variances, axes: inverting would blur the soft ones, an anchor's first pose being nearly exact."""
        variance, axes = np.linalg.eigh(self.covariance)
        return variance.clip(0), axes

    @cached_property
    def precision(self) -> Float[NDArray, "m m"] | Float[NDArray, "n 6 6"]:
        """Inverse of the covariance, in its shape."""
        variance, axes = self._eigen
        return (axes / (variance + _LEAST_VARIANCE)[..., None, :]) @ np.swapaxes(axes, -1, -2)

    @property
    def root(self) -> Float[NDArray, "m m"] | Float[NDArray, "n 6 6"]:
        """A matrix that times its transpose is the covariance."""
        variance, axes = self._eigen
        return axes * np.sqrt(variance)[..., None, :]

    def subset(self, kept: Bool[NDArray, "n"]) -> "PosePrior":
        """The marginal over some of the images."""
        rows = np.repeat(kept, 6)
        covariance = self.covariance[np.ix_(rows, rows)] if self.is_joint else self.covariance[kept]
        return PosePrior(self.T_world_camera[kept], self.robot[kept], covariance)

    def residual(self, T: Float[NDArray, "n 4 4"]) -> Float[NDArray, "n 6"]:
        """Perturbation that leads from the estimates to other poses.

        With joint errors it is taken about each robot's estimates moved rigidly to where the poses lie: a
        robot turned by 7° as a whole moves a camera 8 m away by 6 cm more than the tangent says, far beyond
        what is known of its images relative to each other.
        """
        if not self.is_joint:
            return se3.log(se3.inverse(self.T_world_camera) @ T)
        residual = np.zeros((len(T), 6))
        for robot in np.unique(self.robot):
            own = self.robot == robot
            G = rigid_fit(self.T_world_camera[own], T[own])
            rigid = se3.adjoint(se3.inverse(self.T_world_camera[own])) @ se3.log(G)
            residual[own] = rigid + se3.log(se3.inverse(G @ self.T_world_camera[own]) @ T[own])
        return residual

    def moved(self, perturbation: Float[NDArray, "*s n 6"]) -> Float[NDArray, "*s n 4 4"]:
        """Poses a perturbation away; inverse of :meth:`residual` for a robot's rigid motion."""
        if not self.is_joint:
            return self.T_world_camera @ se3.exp(perturbation)
        T = np.broadcast_to(self.T_world_camera, (*perturbation.shape[:-1], 4, 4)).copy()
        for robot in np.unique(self.robot):
            own = self.robot == robot
            A = se3.adjoint(se3.inverse(self.T_world_camera[own]))
            gamma = _common_twist(A, perturbation[..., own, :])
            rest = perturbation[..., own, :] - (A @ gamma[..., None, :, None])[..., 0]
            T[..., own, :, :] = se3.exp(gamma)[..., None, :, :] @ self.T_world_camera[own] @ se3.exp(rest)
        return T


def rigid_fit(T_from: Float[NDArray, "n 4 4"], T_to: Float[NDArray, "n 4 4"]) -> Float[NDArray, "4 4"]:
    """Rigid transform G with ``G @ T_from`` nearest ``T_to``: mean rotation, then mean translation."""
    U, _, Vt = np.linalg.svd((T_to[:, :3, :3] @ np.swapaxes(T_from[:, :3, :3], 1, 2)).mean(0))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return se3.from_parts(R, (T_to[:, :3, 3] - T_from[:, :3, 3] @ R.T).mean(0))


def _common_twist(A: Float[NDArray, "n 6 6"], x: Float[NDArray, "*s n 6"]) -> Float[NDArray, "*s 6"]:
    """The twist of the world that explains the perturbations of a robot's images best."""
    flat = A.reshape(-1, 6)
    return x.reshape(*x.shape[:-2], -1) @ np.linalg.pinv(flat).T
