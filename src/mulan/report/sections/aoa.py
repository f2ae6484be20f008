"""One angle-of-arrival profile: what the radio heard from every direction."""

import numpy as np

from mulan.report.charts import chart
from mulan.report.markup import Section, caption, escape
from mulan.report.run_contents import RunContents

_FLOOR_DB = -25.0
_MOST_COLUMNS = 400


def section(contents: RunContents) -> Section | None:
    """Heat map of power over azimuth and elevation, estimate and truth marked; None before localization."""
    title = "Angle of arrival"
    if contents.localization is None:
        return None
    profile = contents.localization.get("profile")
    if not profile:
        return Section("aoa", title, '<p class="plain">No profile was kept in this run.</p>')
    power = np.array(profile["power"], dtype=float)
    stride = max(1, power.shape[1] // _MOST_COLUMNS)
    power = power[:, ::stride]
    db = 10 * np.log10(np.maximum(power / power.max(), 10 ** (_FLOOR_DB / 10)))
    heat = {
        "type": "heatmap",
        "x": np.round(np.degrees(profile["azimuth_rad"])[::stride], 2).tolist(),
        "y": np.round(np.degrees(profile["elevation_rad"]), 2).tolist(),
        "z": np.round(db, 1).tolist(),
        "colorscale": "Viridis",
        "zmin": _FLOOR_DB,
        "zmax": 0,
        "colorbar": {"title": {"text": "dB", "side": "top"}, "thickness": 12, "outlinewidth": 0, "len": 0.9},
        "hovertemplate": "azimuth %{x:.0f}°, elevation %{y:.0f}°: %{z:.1f} dB<extra></extra>",
    }
    marks = [_mark("estimate", profile, "estimated", "circle-open", "#ffffff")]
    if profile.get("true_azimuth_rad") is not None:
        marks.append(_mark("truth", profile, "true", "x-thin", "#ff5c5c"))
    layout = {
        "xaxis": {"title": {"text": "azimuth [°]"}, "range": [-180, 180], "dtick": 45, "showgrid": False},
        "yaxis": {"title": {"text": "elevation [°]"}, "showgrid": False},
        # marks stand on the dark heat map, so their legend must as well
        "legend": {
            "x": 0.01,
            "y": 0.98,
            "yanchor": "top",
            "bgcolor": "#2b2f4f",
            "font": {"color": "#ffffff"},
        },
    }
    label = f"Received power over directions, heard by {profile['observer']} from {profile['peer']}"
    who = f"What {escape(profile['observer'])} heard from {escape(profile['peer'])}"
    text = "Directions are in the observer’s odometry axes."
    if profile.get("sigma_rad") is not None:
        text += f" The estimate states a sigma of {np.degrees(profile['sigma_rad']):.1f}°."
    error = _error_deg(profile)
    if error is not None:
        text += f" It lies {error:.1f}° from the truth."
    body = f'<p class="plain">{who}, power over direction relative to the peak.</p>'
    return Section("aoa", title, body + chart(label, [heat, *marks], layout, 400) + caption(text))


def _mark(name: str, profile: dict, prefix: str, symbol: str, colour: str) -> dict:
    elevation = profile.get(f"{prefix}_elevation_rad")
    return {
        "type": "scatter",
        "mode": "markers",
        "x": [float(np.degrees(profile[f"{prefix}_azimuth_rad"]))],
        "y": [float(np.degrees(elevation)) if elevation is not None else 0.0],
        "name": name,
        "marker": {"symbol": symbol, "size": 15, "color": colour, "line": {"width": 2.5, "color": colour}},
        "hovertemplate": f"{name}: azimuth %{{x:.1f}}°, elevation %{{y:.1f}}°<extra></extra>",
    }


def _error_deg(profile: dict) -> float | None:
    """Angle between estimated and true direction."""
    angles = [profile.get(f"{p}_{a}_rad") for p in ("estimated", "true") for a in ("azimuth", "elevation")]
    if any(angle is None for angle in angles):
        return None
    a1, e1, a2, e2 = (float(angle) for angle in angles if angle is not None)
    cosine = np.sin(e1) * np.sin(e2) + np.cos(e1) * np.cos(e2) * np.cos(a1 - a2)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
