"""FLIP (Andersson et al. 2020): the difference a person sees when two pictures take turns on a screen."""

from importlib import import_module
from importlib.util import find_spec

import numpy as np

from mulan.radiance.engine import Rendering
from mulan.reconstruction.captured_image import CapturedImage


class FlipJudge:
    """Mean LDR-FLIP of each view, at its own 67 pixels a degree, where flip-evaluator is installed."""

    def __init__(self) -> None:
        """Look for the package."""
        self.why_not = None if find_spec("flip_evaluator") else "flip-evaluator is not installed"

    def __call__(self, rendering: Rendering, image: CapturedImage) -> dict[str, float | None]:
        """``flip``, 0 (equal) to 1; None without the package."""
        if self.why_not is not None:
            return {"flip": None}
        h, w = image.colour.shape[:2]
        colour = rendering.colour.view(h, w, 3).clamp(0, 1).numpy().astype(np.float32)
        evaluate = import_module("flip_evaluator").evaluate
        _, mean, _ = evaluate(image.colour_fraction, colour, "LDR", applyMagma=False)
        return {"flip": float(mean)}
