"""The antenna profile of a link as a small picture: where its power comes from."""

from typing import Any

import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray


def draw_profile(profile: dict[str, Any]) -> UInt8[NDArray, "h w 3"]:
    """Power by azimuth and elevation (``profile`` of localization.json) with the estimate and the truth."""
    figure = Figure(figsize=(4.2, 2.5), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots()
    azimuth, elevation = (np.degrees(profile[k]) for k in ("azimuth_rad", "elevation_rad"))
    power = np.array(profile["power"], dtype=float)
    decibels = 10 * np.log10(np.maximum(power / power.max(), 1e-3))
    axes.pcolormesh(azimuth, elevation, decibels, shading="nearest", cmap="viridis")
    estimate = np.degrees([profile["estimated_azimuth_rad"], profile["estimated_elevation_rad"]])
    axes.plot(*estimate, "o", mfc="none", mec="white", ms=9, label="estimate")
    if profile["true_azimuth_rad"] is not None:
        truth = np.degrees([profile["true_azimuth_rad"], profile["true_elevation_rad"]])
        axes.plot(*truth, "x", color="#ff6b6b", ms=8, label="truth")
    axes.legend(fontsize=7, loc="lower right", framealpha=0.6)
    axes.set_xlabel("azimuth [°]", fontsize=8)
    axes.set_ylabel("elevation [°]", fontsize=8)
    axes.tick_params(labelsize=7)
    sigma_deg = np.degrees(profile["sigma_rad"])
    axes.set_title(f"{profile['observer']} hears {profile['peer']}, ±{sigma_deg:.1f}°", fontsize=9)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
