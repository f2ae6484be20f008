"""Planar tracks against truth: errors, coverage of the claimed ellipses, NEES."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.localization.site_tracking import Tracked
from mulan.geometry import so3

COVERED = {"coverage_68": 2.2789, "coverage_95": 5.9915}
"""Squared Mahalanobis length of the ellipse that holds 68 and 95 % of a plane's Gaussian."""


@dataclass(frozen=True)
class TrackErrors:
    """One track beside its truth, in the site's axes.

    Attributes:
        name: Of the track.
        time_s: Instants.
        estimate_m, true_m: Places in the plane.
        yaw_error_rad: Estimated minus true heading; NaN where the truth has none.
        covariance: Claimed, over (x, y, yaw).
    """

    name: str
    time_s: Float[NDArray, "n"]
    estimate_m: Float[NDArray, "n 2"]
    true_m: Float[NDArray, "n 2"]
    yaw_error_rad: Float[NDArray, "n"]
    covariance: Float[NDArray, "n 3 3"]

    @property
    def off_m(self) -> Float[NDArray, "n"]:
        """Distance from the truth."""
        return np.linalg.norm(self.estimate_m - self.true_m, axis=1)


def track_errors(
    name: str, tracked: Tracked, true_m: Float[NDArray, "n 2"], true_yaw_rad: Float[NDArray, "n"] | None
) -> TrackErrors:
    """Compare a track with the truth at its instants."""
    T = tracked.T_site_body
    yaw = np.arctan2(T[:, 1, 0], T[:, 0, 0])
    error = np.full(len(yaw), np.nan)
    if true_yaw_rad is not None:
        error = so3.log(so3.about_z(yaw - true_yaw_rad))[:, 2]
    return TrackErrors(name, tracked.time_s, T[:, :2, 3], true_m, error, tracked.covariance)


def track_figures(tracks: Sequence[TrackErrors]) -> dict[str, Any]:
    """Over all instants of all tracks, for JSON."""
    off = np.concatenate([t.off_m for t in tracks])
    yaw = np.concatenate([t.yaw_error_rad for t in tracks])
    squared = []
    full = []
    for t in tracks:
        xi = np.concatenate([t.estimate_m - t.true_m, t.yaw_error_rad[:, None]], 1)
        for columns, out in ((2, squared), (3, full)):
            x = xi[:, :columns]
            P = t.covariance[:, :columns, :columns]
            out.append(np.einsum("ni,ni->n", x, np.linalg.solve(P, x[..., None])[..., 0]))
    plane = np.concatenate(squared)
    result: dict[str, Any] = {
        "rms_m": float(np.sqrt((off**2).mean())),
        "median_m": float(np.median(off)),
        "worst_m": float(off.max()),
        "instants": len(off),
        "nees_per_dof": float(plane.mean() / 2),
    }
    result |= {name: float((plane <= bound).mean()) for name, bound in COVERED.items()}
    if np.isfinite(yaw).all():
        result["yaw_rms_deg"] = float(np.degrees(np.sqrt((yaw**2).mean())))
        result["nees_per_dof_with_yaw"] = float(np.concatenate(full).mean() / 3)
    return result
