"""How well a field predicts photographs it never saw."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray
from torch import Tensor

from mulan.mission.pixels import encode_png
from mulan.mission.run_folder import RunFolder, write_atomically
from mulan.radiance.engine import RadianceEngine, Rendering
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.robot_exposure import RobotExposure
from mulan.reconstruction.sub_pixels import Renders


@runtime_checkable
class ViewJudge(Protocol):
    """Further figures of merit of one held-out view."""

    def __call__(self, rendering: Rendering, image: CapturedImage) -> dict[str, float | None]:
        """Figures by name, None where one is not available; the rendering's rays are the image's pixels."""
        ...


def psnr_db(engine: Renders, images: PosedPixels, index: int, sub_pixels: int = 1) -> float:
    """Peak signal-to-noise ratio of one rendered view against its photograph (colours in [0, 1])."""
    return _psnr_db(images.render(engine, index, sub_pixels).colour, images.image_rays(index).colours)


def evaluate_held_out(
    engine: RadianceEngine,
    test: tuple[CapturedImage, ...],
    run: RunFolder,
    keep: int = 6,
    sub_pixels: int = 1,
    judges: Sequence[ViewJudge] = (),
    exposure: RobotExposure | None = None,
) -> dict[str, Any]:
    """Render every held-out view, compare, and keep some pictures in ``renders/``.

    Args:
        engine: The trained field.
        test: Held-out photographs at the size to compare at.
        run: Folder for ``renders/000_true.png``, ``000_rendered.png``, ``000_depth.png`` (near is bright).
        keep: How many views to keep, spread over the set.
        sub_pixels: Rays a side of a pixel; the field's description says what it was learnt for.
        judges: Further figures of merit, added to each view and to the means.
        exposure: How the robots' cameras differ; each view is shown as its own robot's would, one of no robot
            among them as the first one's.

    Returns:
        ``views`` (name, psnr_db, ssim each), ``psnr_db`` and ``ssim``, the means over the views, or None
        where there are none. SSIM: Gaussian window of 11 pixels, sigma 1.5, data range 1 (Wang et al. 2004);
        None for a view smaller than the window.
    """
    if not test:
        return {"psnr_db": None, "ssim": None, "views": []}
    kept = {int(i) for i in np.linspace(0, len(test) - 1, min(keep, len(test))).round()} if keep else set()
    views = []
    for i, image in enumerate(test):
        # one at a time: all of them together may not fit into memory
        view = ImageTensors([image])
        rays, rendering = view.image_rays(0), view.render(engine, 0, sub_pixels)
        rendering = rendering if exposure is None else exposure.shown(rendering, image)
        h, w = image.colour.shape[:2]
        view = {
            "name": image.posed.path.name,
            "psnr_db": _psnr_db(rendering.colour, rays.colours),
            "ssim": _ssim(rendering.colour.view(h, w, 3), rays.colours.view(h, w, 3)),
        }
        for judge in judges:
            view |= judge(rendering, image)
        views.append(view)
        if i in kept:
            _write_pictures(run.renders, sorted(kept).index(i), image, rendering)
    figures = [name for name in views[0] if name != "name"]
    means = {name: _mean([view[name] for view in views if view[name] is not None]) for name in figures}
    return {**means, "views": views}


def _psnr_db(colour: Float[Tensor, "r 3"], true: Float[Tensor, "r 3"]) -> float:
    return -10 * math.log10(max(float((colour - true).square().mean()), 1e-10))


def _ssim(colour: Float[Tensor, "h w 3"], true: Float[Tensor, "h w 3"]) -> float | None:
    # torchmetrics takes seconds to import and only evaluation needs it
    from torchmetrics.functional.image import structural_similarity_index_measure

    if min(colour.shape[:2]) < 11:
        return None
    rendered, photograph = (picture.permute(2, 0, 1)[None] for picture in (colour, true))
    similarity = structural_similarity_index_measure(
        rendered, photograph, gaussian_kernel=True, sigma=1.5, kernel_size=11, data_range=1.0
    )
    assert isinstance(similarity, Tensor)  # a pair only when asked for the full image
    return float(similarity)


def _write_pictures(folder: Path, number: int, image: CapturedImage, rendering: Rendering) -> None:
    h, w = image.colour.shape[:2]
    colour = (rendering.colour.view(h, w, 3).numpy() * 255).round().astype(np.uint8)
    pictures = {"true": image.colour, "rendered": colour, "depth": _depth_picture(rendering, h, w)}
    for name, pixels in pictures.items():
        data = encode_png(pixels)
        write_atomically(
            folder / f"{number:03d}_{name}.png", lambda path, data=data: path.write_bytes(data) and None
        )


def _depth_picture(rendering: Rendering, h: int, w: int) -> UInt8[NDArray, "h w 3"]:
    """Near is bright, far is dark, nothing is black; the range is that of the middle 96 % of hit pixels."""
    depth = rendering.depth_m.numpy().astype(float)
    hit = rendering.opacity.numpy() > 0.5
    near, far = np.quantile(depth[hit], [0.02, 0.98]) if hit.any() else (0.0, 1.0)
    bright = 1 - 0.85 * ((depth - near) / max(far - near, 1e-9)).clip(0, 1)
    grey = (np.where(hit, bright, 0.0) * 255).astype(np.uint8).reshape(h, w)
    return np.repeat(grey[..., None], 3, axis=2)


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
