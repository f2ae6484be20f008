"""Poses that follow the final field while it is learnt."""

import numpy as np
import torch
from jaxtyping import Bool
from numpy.typing import NDArray
from torch import Tensor

from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.refinement.compared_pixels import ComparedPixels
from mulan.reconstruction.refinement.gauss_newton import PoseState, gauss_newton_step
from mulan.reconstruction.refinement.refinement_config import RefinementConfig


class PoseTracker:
    """Called between the steps of a training; moves the uncertain images now and then."""

    def __init__(
        self,
        state: PoseState,
        config: RefinementConfig,
        seed: int,
        anchored: Bool[NDArray, "k"] | None = None,
    ) -> None:
        """Follow from where registration left the poses.

        Args:
            state: Poses, changed in place.
            config: When and how accurately.
            seed: Of the pixels compared.
            anchored: Images of the training the field may begin with, if it does not with all.
        """
        self._state, self._config = state, config
        self._rest: Bool[Tensor, "k"] | None = None
        if anchored is not None and anchored.any() and config.final_alone > 0:
            self._rest = torch.from_numpy(~anchored)
        self._compared: ComparedPixels | None = None
        self._random = torch.Generator().manual_seed(seed + 4)

    def begin(self, data: PosedPixels) -> None:
        """Let the photographs stand at the tracked poses."""
        self._compared = ComparedPixels(data)
        self._state.place(data)
        if self._rest is not None:
            data.rests = self._rest.to(data.T_world_camera.device)

    def after_step(self, engine: RadianceEngine, data: PosedPixels, steps: int, fraction_done: float) -> None:
        """Move the poses if it is time."""
        config = self._config
        if self._rest is not None and fraction_done >= config.final_alone:
            self._rest = data.rests = None
        if steps % config.final_every or not config.final_from <= fraction_done <= config.final_until:
            return
        assert self._compared is not None
        share = config.first_step_share * (1 - fraction_done / config.final_until)
        share = max(share, config.least_step_share)
        gauss_newton_step(
            engine,
            self._compared,
            self._state,
            config.final_rays,
            self._compared.area_px(config.final_residuals),
            self._random,
            share,
        )
        self._state.place(data)

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint must keep."""
        s = self._state
        return {
            "poses.T_world_camera": torch.from_numpy(s.T.copy()),
            "poses.damping": torch.from_numpy(s.damping.copy()),
            "poses.generator": self._random.get_state(),
            "poses.all_learnt": torch.tensor(self._rest is None),
        }

    def load_state(self, saved: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` gave and take it out.

        Raises:
            ValueError: Something is missing, or belongs to other images.
        """
        s = self._state
        try:
            T, damping = (saved.pop(f"poses.{name}").numpy() for name in ("T_world_camera", "damping"))
            generator, all_learnt = saved.pop("poses.generator"), bool(saved.pop("poses.all_learnt"))
        except KeyError as error:
            raise ValueError(f"the saved training lacks {error}") from error
        if T.shape != s.T.shape or not np.isfinite(T).all():
            raise ValueError("the saved poses are of other images")
        s.T, s.damping = T.copy(), damping.copy()
        self._random.set_state(generator)
        self._rest = None if all_learnt else self._rest
