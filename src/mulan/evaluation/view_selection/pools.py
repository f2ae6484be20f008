"""The photographs a policy may choose from, as good or bad as a robot's."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.mission.posed_images import PosedImageSet
from mulan.planning.view import View
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage, load_captured
from mulan.reconstruction.scene_space import choose_space

NOISY_SIGMA_M = 0.15
GRADED_SIGMA_M = (0.02, 0.08)


class PoolKind(Enum):
    """What is wrong with the photographs to choose from."""

    STANDARD = "standard"
    """Nothing: every photograph as it is, its pose exact."""
    NARROW = "narrow"
    """Half the field of view, pointed at random: a window of half the sides, anywhere in the photograph."""
    NOISY = "noisy"
    """Half of them, drawn by lot, have a position error of 0.15 m standard deviation an axis, and say so."""
    GRADED = "graded"
    """Each has a standard deviation of its own, 0.02 m to 0.08 m an axis, and says so."""

    @property
    def has_noise(self) -> bool:
        """Whether poses are uncertain."""
        return self in (PoolKind.NOISY, PoolKind.GRADED)


@dataclass(frozen=True)
class Pool:
    """What one seed chooses from.

    Attributes:
        photographs: Candidates at the poses believed, with their covariance.
        test: Views to be judged by, at their true poses.
        space: Where the scene is, the same for all.
        certain_sigma_m: Median standard deviation of the candidates' positions; the better half is certain.
    """

    photographs: tuple[CapturedImage, ...]
    test: tuple[CapturedImage, ...]
    space: SceneSpace
    certain_sigma_m: float

    @property
    def views(self) -> list[View]:
        """The candidates' places as a planner knows them, without the photographs."""
        return [
            View(p.camera, p.T_world_camera, _covariance(p.posed.pose_covariance)) for p in self.photographs
        ]

    def first_views(self, count: int, seed: int) -> list[int]:
        """Views every policy starts from, drawn by lot among the certain ones."""
        certain = [i for i, view in enumerate(self.views) if view.sigma_m <= self.certain_sigma_m]
        return sorted(np.random.default_rng([seed, 1]).choice(certain, count, replace=False).tolist())


class PoolSource:
    """Reads an image set once and makes the pool of each seed."""

    def __init__(self, images: PosedImageSet, kind: PoolKind, image_size: int) -> None:
        """Read the photographs.

        Args:
            images: The set at its true poses; their covariances are not looked at.
            kind: What to do to its training images.
            image_size: Longest side to learn and judge at, in pixels.

        Raises:
            InputError: There is no test view, or a photograph cannot be read.
        """
        if not images.test:
            raise InputError(images.source, "test images", "there are none to score", "name another set")
        self.kind, self._image_size = kind, image_size
        exact = [replace(image, pose_covariance=None) for image in images.train]
        self._train = load_captured(exact, image_size)
        self._test = load_captured(images.test, image_size)
        self._space = choose_space(self._train)
        self._large = load_captured(exact, 2 * image_size) if kind is PoolKind.NARROW else ()

    def __len__(self) -> int:
        """Number of candidates."""
        return len(self._train)

    def pool(self, seed: int) -> Pool:
        """The pool of one seed: its windows, or the errors of its poses."""
        rng = np.random.default_rng([seed, 0])
        photographs = self._train
        if self.kind is PoolKind.NARROW:
            photographs = tuple(half_window(image, rng) for image in self._large)
        elif self.kind.has_noise:
            sigma_m = noise_sigma_m(self.kind, len(self._train), rng)
            photographs = tuple(
                displaced(image, s, rng) for image, s in zip(self._train, sigma_m, strict=True)
            )
        sigma = [0.0 if p.posed.pose_covariance is None else _sigma_m(p) for p in photographs]
        return Pool(photographs, self._test, self._space, float(np.median(sigma)))


def noise_sigma_m(kind: PoolKind, count: int, rng: np.random.Generator) -> Float[NDArray, "n"]:
    """Standard deviation of each position on every axis [m]."""
    if kind is PoolKind.GRADED:
        return rng.uniform(*GRADED_SIGMA_M, count)
    sigma_m = np.zeros(count)
    sigma_m[rng.permutation(count)[: count // 2]] = NOISY_SIGMA_M
    return sigma_m


def displaced(image: CapturedImage, sigma_m: float, rng: np.random.Generator) -> CapturedImage:
    """The photograph at a pose that is wrong by a draw from the covariance it comes with."""
    error = np.concatenate([np.zeros(3), rng.normal(0, sigma_m, 3)])
    covariance = np.diag([0.0] * 3 + [sigma_m**2] * 3)
    T = image.T_world_camera @ se3.inverse(se3.exp(error))
    return replace(image, posed=replace(image.posed, T_world_camera=T, pose_covariance=covariance))


def half_window(image: CapturedImage, rng: np.random.Generator) -> CapturedImage:
    """A window of half the width and height, anywhere in the photograph: half the tangent of the view angle.

    The lens is then off centre (its principal point lies outside the middle); the camera is not turned.
    """
    height, width = image.colour.shape[:2]
    h, w = height // 2, width // 2
    top, left = int(rng.integers(height - h + 1)), int(rng.integers(width - w + 1))
    window = slice(top, top + h), slice(left, left + w)
    camera = replace(image.camera, width=w, height=h, cx=image.camera.cx - left, cy=image.camera.cy - top)
    alpha = None if image.alpha is None else np.ascontiguousarray(image.alpha[window])
    return CapturedImage(image.posed, camera, np.ascontiguousarray(image.colour[window]), alpha)


def _covariance(covariance: Float[NDArray, "6 6"] | None) -> Float[NDArray, "6 6"]:
    return np.zeros((6, 6)) if covariance is None else covariance


def _sigma_m(image: CapturedImage) -> float:
    covariance = _covariance(image.posed.pose_covariance)
    return float(np.sqrt(np.trace(covariance[3:, 3:]) / 3))
