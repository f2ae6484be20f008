"""Proposed views in the scene: one camera each, coloured by what it is expected to teach."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from numpy.typing import NDArray
from viser import SceneApi

from mulan.viewer.frame import pinhole
from mulan.viewer.photograph_layers import add_frustum

_ROOT = "/candidates"
_LENS = pinhole(64, 48, np.radians(45))  # plan.json keeps poses, not lenses
_BEST_SCALE = 1.8


def gain_colours(score: Float[NDArray, "n"]) -> NDArray[np.uint8]:
    """From dark (teaches least) to yellow (teaches most), over one robot's candidates."""
    span = np.ptp(score) if len(score) else 0.0
    share = (score - score.min()) / span if span > 0 else np.ones(len(score))
    return (colormaps["plasma"](0.05 + 0.9 * share)[:, :3] * 255).astype(np.uint8)


class CandidateLayers:
    """The candidates of plan.json."""

    def __init__(self, scene: SceneApi, plan: dict[str, Any], scale_m: float) -> None:
        self._scene, self._plan, self._scale_m = scene, plan, scale_m

    def show(self, visible: bool) -> None:
        """Draw or remove them."""
        self._scene.remove_by_name(_ROOT)
        for robot, entry in self._plan["robots"].items() if visible else ():
            candidates = entry["candidates"]
            colours = gain_colours(np.array([c["score"] for c in candidates], dtype=float))
            for index, (candidate, colour) in enumerate(zip(candidates, colours, strict=True)):
                best = index == entry["best"]
                add_frustum(
                    self._scene,
                    f"{_ROOT}/{robot}/{index}",
                    _LENS,
                    np.array(candidate["T_world_camera"], dtype=float),
                    (int(colour[0]), int(colour[1]), int(colour[2])),
                    self._scale_m * (_BEST_SCALE if best else 1.0),
                )
