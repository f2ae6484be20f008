"""Cameras that disagree: how much brighter each robot's shows each colour than the first robot's does.

A photograph's colour is taken as the scene's times its robot's gain. The field is learnt from the photographs
divided by it, so its pictures are in the first robot's colours. What a camera has clipped stays clipped.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.mission.posed_images import PosedImage
from mulan.radiance.engine import RadianceEngine, Rendering
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.shared_colours import shared_colours

_EQUAL = 0.01  # places that say cameras are equal, where no others do


@dataclass(frozen=True)
class ExposureConfig:
    """When gains are fitted, and from how much."""

    every: int = 25
    """Steps of the field between two fits."""
    points: int = 4096
    """Places looked up in a photograph of another robot in each fit."""
    first_from: float = 0.03
    """Share of the training before which gains rest: the field has no surfaces yet."""
    kept: float = 0.8
    """Share of what earlier fits saw that still counts: the field's surfaces grow better."""
    log_ratio_scale: float = 0.1
    """Pairs of pixels farther from the median than this, in log-brightness, count less (Cauchy's weights):
    one shows something else, or a highlight."""


class RobotExposure:
    """Gains of the robots' cameras, fitted between the steps of a training.

    Gains are not fitted to the field's colours, which would follow them, but to what two robots' photographs
    show of the same places.

    Attributes:
        robots: The robots' names; the first one's gain is one.
        config: When gains are fitted, and from how much.
        log_gain: Natural logarithms of their gains for red, green and blue.
    """

    def __init__(self, images: Sequence[PosedImage], seed: int, config: ExposureConfig | None = None) -> None:
        """Begin with equal cameras.

        Args:
            images: Photographs to learn from; the first one's robot is the first.
            seed: Of the places looked up.
            config: When and from how much.
        """
        self.robots = tuple(dict.fromkeys(image.robot_id or "" for image in images))
        n = len(self.robots)
        self.log_gain: Float[NDArray, "robots 3"] = np.zeros((n, 3))
        self.config, self._random = config or ExposureConfig(), torch.Generator().manual_seed(seed + 6)
        # of each pair of robots: trust in what their shared places said, and the log-ratios times it
        self._trust, self._told = np.zeros((n, n, 3)), np.zeros((n, n, 3))

    @property
    def gains(self) -> Mapping[str, list[float]]:
        """Gains for red, green and blue by robot."""
        return dict(zip(self.robots, np.exp(self.log_gain).tolist(), strict=True))

    def gain_of(self, robot: str | None) -> Float[NDArray, "3"]:
        """A robot's gains; one for a robot not among these, which counts as the first."""
        name = robot or ""
        return np.exp(self.log_gain[self.robots.index(name)]) if name in self.robots else np.ones(3)

    def begin(self, data: PosedPixels) -> None:
        """Let the photographs be divided by their robots' gains."""
        gain = np.stack([self.gain_of(image.posed.robot_id) for image in data.images])
        data.image_gain = torch.from_numpy(gain).float().to(data.T_world_camera.device)

    def after_step(self, engine: RadianceEngine, data: PosedPixels, steps: int, fraction_done: float) -> None:
        """Fit the gains if it is time."""
        if steps % self.config.every == 0 and fraction_done >= self.config.first_from:
            self.fit(engine, data)

    def fit(self, engine: RadianceEngine, data: PosedPixels) -> None:
        """Gains that best explain what the robots' photographs show of the places they share."""
        robot = np.array([self.robots.index(image.posed.robot_id or "") for image in data.images])
        seen = shared_colours(engine, data, robot, self.config.points, self._random)
        self._trust *= self.config.kept
        self._told *= self.config.kept
        for i in range(len(self.robots)):
            for j in range(i + 1, len(self.robots)):
                self._listen(seen.log_ratios(robot, i, j), i, j)
        self.log_gain = log_gains(self._told, self._trust)
        self.begin(data)

    def _listen(self, log_ratio: Float[NDArray, "p 3"], i: int, j: int) -> None:
        for c, column in enumerate(log_ratio.T):
            told = column[np.isfinite(column)]
            if len(told):
                off = (told - np.median(told)) / self.config.log_ratio_scale
                trust = 1 / (1 + off**2)
                self._trust[i, j, c] += trust.sum()
                self._told[i, j, c] += (trust * told).sum()

    def shown(self, rendering: Rendering, image: CapturedImage) -> Rendering:
        """A rendering as the camera of the image's robot would show it."""
        gain = torch.from_numpy(self.gain_of(image.posed.robot_id)).to(rendering.colour)
        background = (1 - rendering.opacity)[:, None] if image.alpha is not None else 0.0
        colour = (rendering.colour - background) * gain + background
        return replace(rendering, colour=colour.clamp(0, 1))

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint must keep."""
        numbers = {"log_gain": self.log_gain, "trust": self._trust, "told": self._told}
        kept = {f"exposure.{name}": torch.from_numpy(value.copy()) for name, value in numbers.items()}
        return {**kept, "exposure.generator": self._random.get_state()}

    def load_state(self, saved: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` gave and take it out.

        Raises:
            ValueError: Something is missing, or belongs to other robots.
        """
        try:
            numbers = [saved.pop(f"exposure.{name}").numpy().copy() for name in ("log_gain", "trust", "told")]
            generator = saved.pop("exposure.generator")
        except KeyError as error:
            raise ValueError(f"the saved training lacks {error}") from error
        mine = (self.log_gain, self._trust, self._told)
        if any(a.shape != b.shape or not np.isfinite(a).all() for a, b in zip(numbers, mine, strict=True)):
            raise ValueError("the saved gains are of other robots")
        self.log_gain, self._trust, self._told = numbers
        self._random.set_state(generator)


def log_gains(
    told: Float[NDArray, "robots robots 3"], trust: Float[NDArray, "robots robots 3"]
) -> Float[NDArray, "robots 3"]:
    """Logarithms of the gains by least squares over all pairs of robots, the first robot's being zero.

    Args:
        told: Log-brightness of robot j's photographs over robot i's, times the trust in each place, summed.
        trust: Sums of the trust. A robot that shares no place with any other counts as the first one's equal.
    """
    solved = np.zeros((len(trust), 3))
    for c in range(3 if len(trust) > 1 else 0):
        both = trust[:, :, c] + trust[:, :, c].T
        laplacian = np.diag(both.sum(1) + _EQUAL) - both
        forces = told[:, :, c].sum(0) - told[:, :, c].sum(1)
        solved[1:, c] = np.linalg.solve(laplacian[1:, 1:], forces[1:])
    return solved
