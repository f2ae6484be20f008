"""How well refined poses are known."""

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.linalg import block_diag

from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.refinement.compared_pixels import ComparedPixels
from mulan.reconstruction.refinement.gauss_newton import PoseState
from mulan.reconstruction.refinement.photometric import residual_sigma, residuals
from mulan.reconstruction.refinement.pose_prior import PosePrior
from mulan.reconstruction.refinement.refinement_config import RefinementConfig
from mulan.reconstruction.refinement.shared_points import joint_information, shared_points

_SCALE_RAYS = 512  # pixels of each image that tell the size of its residuals
_SIZE_PX = 100  # of the images the options speak of


def photographs_information(
    field: RadianceEngine,
    compared: ComparedPixels,
    state: PoseState,
    config: RefinementConfig,
    seed: int,
) -> Float[NDArray, "m m"]:
    """What the photographs say of all refined poses together, localization's knowledge not in it.

    Residuals of a field are no noise: where it is wrong it shifts whole parts of a picture, whatever the
    number of pixels. So an image counts as a few independent residuals of the size found, not as one a pixel.

    Args:
        field: Learnt at the refined poses.
        compared: The photographs there.
        state: The uncertain ones.
        config: How many pixels and points are compared.
        seed: Of which.
    """
    data, generator = compared.data, torch.Generator().manual_seed(seed)
    T = data.T_world_camera.double().cpu().numpy()
    longest_px = max(max(image.colour.shape[:2]) for image in data.images)
    # errors stay the same share of a pixel: a larger picture tells poses better, but not by its every pixel
    area_px = compared.area_px(config.independent_residuals * _SIZE_PX / longest_px)
    draw = compared.draw(np.arange(len(data)), _SCALE_RAYS, area_px, generator)
    sigma = residual_sigma(residuals(field, data, draw, T), draw.weight)
    points = shared_points(field, compared, config.posterior_points, area_px, generator)
    information = joint_information(points, sigma, state.image)
    if len(state.image) == len(data):
        information = less_sure_of(information, state.best_known, config.held_error)
    return information


def less_sure_of(information: Float[NDArray, "m m"], image: int, variances: float) -> Float[NDArray, "m m"]:
    """What the photographs say if one of them lies off its place in the map, besides.

    Where no image is exact the map hangs on the one localization knows best. That one is held while all
    others move to where they fit, and the field learns it where it is held: its residuals tell less of where
    it lies than those of the others do.

    Args:
        information: On the poses of all images together.
        image: The one that is held.
        variances: Of its own error, as a multiple of the covariance its residuals alone leave it.
    """
    own = slice(6 * image, 6 * image + 6)
    across = information[:, own]
    # an image that shows nothing has none to lose
    spread = variances / (1 + variances) * np.linalg.pinv(information[own, own], hermitian=True)
    lessened = information - across @ spread @ across.T
    return (lessened + lessened.T) / 2


def posterior_covariance(prior: PosePrior, information: Float[NDArray, "m m"]) -> Float[NDArray, "m m"]:
    """Covariance of all refined poses together (Laplace's approximation, the scene unknown too).

    Args:
        prior: What localization said.
        information: What the photographs say.
    """
    known = prior.precision if prior.is_joint else block_diag(*prior.precision)
    return np.linalg.inv(known + information)


def marginal_blocks(covariance: Float[NDArray, "m m"]) -> Float[NDArray, "n 6 6"]:
    """Covariance of each pose by itself."""
    n = len(covariance) // 6
    return np.einsum("iaib->iab", covariance.reshape(n, 6, n, 6)).copy()
