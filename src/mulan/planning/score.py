"""What a view would teach: the expected fall of the field's colour variance along its rays."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.planning.rays import camera_rays, rays_of_poses, rows_for
from mulan.radiance.engine import RadianceEngine, RaySamples

_NEGLIGIBLE_SIGMA = 1e-9  # rad or m; not worth a rendering


@dataclass(frozen=True)
class CandidateView:
    """One view to be judged.

    Attributes:
        camera: Intrinsics.
        T_world_camera: Where the camera would be (OpenGL axes).
        covariance: How well it would know that (6x6, right perturbation; rotation rad, translation m).
        columns: Width of the ray grid.
    """

    camera: PinholeCamera
    T_world_camera: Float[NDArray, "4 4"]
    covariance: Float[NDArray, "6 6"]
    columns: int


class Posterior(ABC):
    """How much noise a new photograph's ray carries about one sample on it."""

    @abstractmethod
    def noise(self, engine: RadianceEngine, view: CandidateView, samples: RaySamples) -> Float[Tensor, "s"]:
        """Variance V of the ray's colour as a measurement of each sample, colour units squared."""


@dataclass(frozen=True)
class PropagatedPosterior(Posterior):
    """Pose covariance carried to colour by rendering displaced cameras (readings.md, row 16); the default."""

    def noise(self, engine: RadianceEngine, view: CandidateView, samples: RaySamples) -> Float[Tensor, "s"]:
        """``V = Σ α_i² β_i² + v_pose``, the same for all samples of a ray."""
        v_pose = pose_colour_variance(engine, view)
        return (ray_variance(samples, len(v_pose)) + v_pose.to(samples.blend.device))[samples.ray_index]


@dataclass(frozen=True)
class LiteralPosterior(Posterior):
    """The paper's printed form: ``V = α_k² σ² + Σ α_i² β_i²`` with σ² in m² (eq. variance); for ablation.

    σ² is the mean variance of the candidate's position over the three axes.
    """

    def noise(
        self,
        engine: RadianceEngine,  # noqa: ARG002 (this form renders nothing)
        view: CandidateView,
        samples: RaySamples,
    ) -> Float[Tensor, "s"]:
        """``V = α_k² σ² + Σ α_i² β_i²``."""
        rays = view.columns * rows_for(view.camera, view.columns)
        sigma_squared_m2 = float(np.trace(view.covariance[3:, 3:])) / 3
        return samples.blend**2 * sigma_squared_m2 + ray_variance(samples, rays)[samples.ray_index]


def ray_variance(samples: RaySamples, rays: int) -> Float[Tensor, "r"]:
    """Variance ``Σ α_i² β_i²`` of each ray's colour under the prior."""
    total = samples.variance.new_zeros(rays)
    return total.index_add(0, samples.ray_index, samples.blend**2 * samples.variance)


def pose_colour_variance(engine: RadianceEngine, view: CandidateView) -> Float[Tensor, "r"]:
    """Variance of each ray's colour (mean over channels) under the pose covariance.

    Third-degree cubature (Arasaratnam & Haykin 2009, eq. 15-17): renders at ±√n σ along each of the
    covariance's n principal axes, each with weight 1/2n. It equals ``g Σ gᵀ`` where the image is linear over
    the displacement and stays below 1/4, as it must, where it is not.
    """
    return pose_colour_variances(engine, [view])[0]


def pose_colour_variances(engine: RadianceEngine, views: Sequence[CandidateView]) -> list[Float[Tensor, "r"]]:
    """The same for several views, all displaced poses rendered at once: small calls cost more to begin."""
    poses = [_displaced(view) for view in views]
    rays = [rays_of_poses(v.camera, T, v.columns) for v, T in zip(views, poses, strict=True) if len(T)]
    colour = torch.zeros(0, 3)
    if rays:
        origins, directions = (torch.cat(own) for own in zip(*rays, strict=True))
        colour = engine.render(origins, directions).colour.cpu()
    found, first = [], 0
    for view, T in zip(views, poses, strict=True):
        count = view.columns * rows_for(view.camera, view.columns)
        if not len(T):
            found.append(torch.zeros(count))
            continue
        own = colour[first : first + len(T) * count]
        found.append(own.view(len(T), count, 3).var(0, unbiased=False).mean(-1))
        first += len(own)
    return found


def _displaced(view: CandidateView) -> Float[NDArray, "n 4 4"]:
    """The cubature's poses; none where the pose is exact."""
    eigenvalue, axis = np.linalg.eigh((view.covariance + view.covariance.T) / 2)
    twists = (axis * np.sqrt(np.clip(eigenvalue, 0, None))).T
    twists = twists[np.linalg.norm(twists, axis=1) > _NEGLIGIBLE_SIGMA]
    displacement = np.sqrt(len(twists)) * np.concatenate([twists, -twists])
    return view.T_world_camera @ se3.exp(displacement)


def posterior_variance(samples: RaySamples, noise: Float[Tensor, "s"]) -> Float[Tensor, "s"]:
    """Each sample's colour variance after the photo: ``(α_k² / V + 1 / β_k²)⁻¹`` (paper, eq. variance)."""
    information = samples.blend**2 / noise.clamp_min(torch.finfo(noise.dtype).tiny)
    return samples.variance / (1 + information * samples.variance)


def variance_reduction(engine: RadianceEngine, view: CandidateView, posterior: Posterior) -> float:
    """Expected fall of colour variance, summed along rays and averaged over the view's rays.

    Samples the ray does not see (blend 0) count nothing, so looking at matter is what pays.
    """
    origins, directions = camera_rays(view.camera, view.T_world_camera, view.columns)
    samples = engine.sample(origins, directions)
    if not len(samples.ray_index):
        return 0.0
    after = posterior_variance(samples, posterior.noise(engine, view, samples))
    return float((samples.variance - after).sum()) / len(origins)
