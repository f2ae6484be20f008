"""Tracks from real UWB ranges of three published sets: errors and coverage against truth."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mulan.evaluation.localization.track_picture import draw_tracks
from mulan.evaluation.localization.track_score import TrackErrors, track_figures
from mulan.evaluation.localization.uwb_indoor_track import indoor_tracks
from mulan.evaluation.localization.uwb_murp_track import murp_tracks
from mulan.evaluation.localization.uwb_planar_track import SiteTrackConfig, planar_tracks


def _both(
    calibrated: Mapping[str, Sequence[TrackErrors]], plain: Mapping[str, Sequence[TrackErrors]]
) -> dict[str, Any]:
    """Figures of each run, with and without calibration."""
    return {
        name: track_figures(tracks) | {"uncalibrated": track_figures(plain[name])}
        for name, tracks in calibrated.items()
    }


def run_uwb_planar(
    data: Path, config: SiteTrackConfig | None = None, picture: Path | None = None
) -> dict[str, Any]:
    """The trolley among eight anchors, by ranges alone.

    Args:
        data: Folder that holds ``uwb_planar``.
        config: Options.
        picture: Where to draw; nowhere if None.

    Raises:
        InputError: A file is missing or damaged.
    """
    calibrated, plain = planar_tracks(data, config or SiteTrackConfig())
    if picture is not None:
        draw_tracks([t for tracks in calibrated.values() for t in tracks], picture)
    moving = track_figures(calibrated["dynamic"])
    return moving | {"runs": _both(calibrated, plain)}


def run_uwb_murp(
    data: Path, config: SiteTrackConfig | None = None, picture: Path | None = None
) -> dict[str, Any]:
    """Agents 2 and 3 in agent 1's axes, by ranges alone; arguments as ``run_uwb_planar``."""
    calibrated, plain, misfit_m = murp_tracks(data, config or SiteTrackConfig())
    everything = [track for tracks in calibrated.values() for track in tracks]
    uncalibrated = [track for tracks in plain.values() for track in tracks]
    if picture is not None:
        draw_tracks(everything, picture)
    overall = track_figures(everything) | {"uncalibrated": track_figures(uncalibrated)}
    return overall | {"trials": _both(calibrated, plain), "antenna_place_misfit_m": misfit_m}


def run_uwb_indoor_chemnitz(
    data: Path, config: SiteTrackConfig | None = None, picture: Path | None = None
) -> dict[str, Any]:
    """The robot behind walls, by ranges and wheels; arguments as ``run_uwb_planar``."""
    calibrated, plain = indoor_tracks(data, config or SiteTrackConfig())
    if picture is not None:
        draw_tracks([calibrated, plain], picture)
    return track_figures([calibrated]) | {"uncalibrated": track_figures([plain])}
