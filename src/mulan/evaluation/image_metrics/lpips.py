"""LPIPS (Zhang et al. 2018, AlexNet): how different two pictures look to a network trained on photographs."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor

from mulan.errors import InputError
from mulan.radiance.engine import Rendering
from mulan.reconstruction.captured_image import CapturedImage

ALEXNET = "alexnet-owt-7be5be79.pth"
"""Name of torchvision's file of AlexNet's weights, which torchmetrics looks for in torch's cache."""
SMALLEST_SIDE = 32
"""Pixels; AlexNet's poolings leave nothing of a smaller picture."""


class LpipsJudge:
    """LPIPS of each view, where its network is at hand: torchvision installed and AlexNet's weights on disk.

    Nothing is ever downloaded, and no figure is made up: without the weights it is None.
    """

    def __init__(self, weights: Path | None = None) -> None:
        """Load the network from a file, or from torch's cache if none is given.

        Raises:
            InputError: The named file is missing or torchvision is not installed.
        """
        self._distance: Callable[[Tensor, Tensor], Tensor] | None = None
        self.why_not: str | None = None
        if weights is not None and not weights.is_file():
            raise InputError(weights, "file", "does not exist", f"name torchvision's {ALEXNET}")
        if find_spec("torchvision") is None:
            self.why_not = "torchvision is not installed"
            if weights is not None:
                raise InputError("--lpips-weights", "LPIPS", self.why_not, "install torchvision")
            return
        cached = Path(torch.hub.get_dir()) / "checkpoints" / ALEXNET
        if weights is None and not cached.is_file():
            self.why_not = f"{ALEXNET} is not in torch's cache"
            return
        with _cache_with(weights or cached):
            # seconds to import, and only this needs it
            from torchmetrics.image import LearnedPerceptualImagePatchSimilarity

            self._distance = LearnedPerceptualImagePatchSimilarity(net_type="alex", normalize=True).eval()

    def __call__(self, rendering: Rendering, image: CapturedImage) -> dict[str, float | None]:
        """``lpips``, lower is better; None where not available or the view is under 32 pixels."""
        h, w = image.colour.shape[:2]
        if self._distance is None or min(h, w) < SMALLEST_SIDE:
            return {"lpips": None}
        true = torch.from_numpy(image.colour_fraction)
        pictures = [
            picture.clamp(0, 1).permute(2, 0, 1)[None] for picture in (rendering.colour.view(h, w, 3), true)
        ]
        with torch.no_grad():
            return {"lpips": float(self._distance(*pictures))}


@contextmanager
def _cache_with(weights: Path) -> Iterator[None]:
    """Torch's cache, for a moment, holding only this file under the name torchvision asks for."""
    before = torch.hub.get_dir()
    with tempfile.TemporaryDirectory() as folder:
        checkpoints = Path(folder) / "checkpoints"
        checkpoints.mkdir()
        (checkpoints / ALEXNET).symlink_to(weights.resolve())
        torch.hub.set_dir(folder)
        try:
            yield
        finally:
            torch.hub.set_dir(before)
