"""Robots that localization placed better than it dared to say: registration finds nothing to correct.

What registration finds is off by a fraction of a pixel itself. Where its poses are no farther than that from
localization's, those stand, and count as known as well as registration could tell.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.refinement.gauss_newton import PoseState

_SAME_PX = 0.75  # of registration's pictures; the median of a robot's images
_TOLD_PX = 0.25  # registration's accuracy, along each axis
_DEPTH_SHARE = 0.5  # of the scene's radius: where the points compared lie about its centre


def let_estimates_stand(images: Sequence[CapturedImage], state: PoseState, space: SceneSpace) -> None:
    """Put the images of such robots back to where localization has them.

    Args:
        images: Photographs as registration saw them.
        state: Poses after registration, changed in place.
        space: Where the scene is.
    """
    shift_px = _shifts_px(images, state, space)
    for robot in np.unique(state.prior.robot):
        own = state.prior.robot == robot
        if np.median(shift_px[own]) < _SAME_PX:
            state.T[own] = state.prior.T_world_camera[own]


def known_as_registered(images: Sequence[CapturedImage], state: PoseState, space: SceneSpace) -> PoseState:
    """The state with a prior that says of images that stand what registration told.

    Joint priors are left as they are: what they say of a robot's path is finer than registration.

    Args:
        images: Photographs as registration saw them.
        state: Poses after :func:`let_estimates_stand`.
        space: Where the scene is.
    """
    stands = (state.prior.T_world_camera == state.T).all((1, 2))
    if state.prior.is_joint or not stands.any():
        return state
    covariance = state.prior.covariance.copy()
    for k in np.flatnonzero(stands):
        image = images[state.image[k]]
        away_m = float(np.linalg.norm(state.T[k, :3, 3] - np.array(space.centre_m)))
        sigma_rad = _TOLD_PX / image.camera.fx
        told = np.repeat([sigma_rad**-2, (sigma_rad * max(away_m, space.radius_m)) ** -2], 3)
        covariance[k] = np.linalg.inv(state.prior.precision[k] + np.diag(told))
    return replace(state, prior=replace(state.prior, covariance=covariance))


def _shifts_px(images: Sequence[CapturedImage], state: PoseState, space: SceneSpace) -> Float[NDArray, "n"]:
    """How far registration moved points of the scene in each picture; infinite if they left it."""
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    points = np.array(space.centre_m) + _DEPTH_SHARE * space.radius_m * corners
    shift_px = np.empty(len(state.T))
    for k, i in enumerate(state.image):
        before, after = (
            images[i].camera.project(points @ to_camera[:3, :3].T + to_camera[:3, 3])
            for to_camera in (se3.inverse(state.prior.T_world_camera[k]), se3.inverse(state.T[k]))
        )
        off_px = np.linalg.norm(after - before, axis=1)
        shift_px[k] = np.inf if np.isnan(off_px).all() else np.nanmean(off_px)
    return shift_px
