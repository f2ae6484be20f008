"""How good the fields of a choice are, and whether their variance knows where they are wrong."""

import statistics
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.stats import rankdata

from mulan.evaluation.image_metrics.variance_calibration import ause, object_pixels
from mulan.radiance.engine import RadianceEngine, Rendering
from mulan.radiance.ensemble import FieldEnsemble
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.dataset import ImageTensors


def judge(fields: Sequence[RadianceEngine], test: Sequence[CapturedImage]) -> dict[str, Any]:
    """Render every test view and compare.

    Args:
        fields: The field that is judged, then further members of its ensemble, if any.
        test: Photographs at the size to compare at.

    Returns:
        ``psnr_db``, mean over the views, of the first field; with further members also ``ensemble_psnr_db``
        and, on the object's pixels, mean over the views, ``ause`` and ``spearman`` (of variance and squared
        error) of the ensemble, of the first field's ``learned`` variance and of ``chance``.
    """
    figures: dict[str, list[float]] = {}

    def note(name: str, value: float) -> None:
        figures.setdefault(name, []).append(value)

    for image in test:
        rays = ImageTensors([image]).image_rays(0)
        true = rays.colours.numpy().astype(float)
        own = fields[0].render(rays.origins, rays.directions)
        note("psnr_db", _psnr_db(own, true))
        if len(fields) < 2:
            continue
        together = FieldEnsemble(fields).render(rays.origins, rays.directions)
        note("ensemble_psnr_db", _psnr_db(together, true))
        seen = object_pixels(image)
        if not seen.any():
            continue
        for name, rendering in (("ensemble", together), ("learned", own)):
            error = ((rendering.colour.numpy() - true)[seen] ** 2).mean(-1)
            variance = rendering.variance.numpy().astype(float)[seen]
            note(f"{name} ause", ause(error, variance))
            note(f"{name} spearman", rank_correlation(variance, error))
        lots = np.random.default_rng(0).random(int(seen.sum()))
        note("chance ause", ause(((own.colour.numpy() - true)[seen] ** 2).mean(-1), lots))
    means = {name: statistics.fmean(values) for name, values in figures.items()}
    result: dict[str, Any] = {"psnr_db": means["psnr_db"]}
    if "ensemble ause" in means:
        result["ensemble_psnr_db"] = means["ensemble_psnr_db"]
        result["ause"] = {name: means[f"{name} ause"] for name in ("ensemble", "learned", "chance")}
        result["spearman"] = {name: means[f"{name} spearman"] for name in ("ensemble", "learned")}
    return result


def rank_correlation(a: Float[NDArray, "n"], b: Float[NDArray, "n"]) -> float:
    """Spearman's, 0 where one of them is constant."""
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])


def _psnr_db(rendering: Rendering, true: Float[NDArray, "r 3"]) -> float:
    error = float(np.square(rendering.colour.numpy() - true).mean())
    return -10 * float(np.log10(max(error, 1e-10)))
