"""Ours on exactly the views another trainer was scored on (some render too slowly for all of them)."""

from typing import Any

from mulan.evaluation.engine.curve import THRESHOLD_DB, curve_on_views, fastest_to_psnr
from mulan.evaluation.engine.scene_result import view_curves_file
from mulan.mission.run_folder import RunFolder, read_json


def every_nth_view(result: dict[str, Any]) -> int:
    """Which test views a result was scored on: 0, n, 2n, ...; 1 for all."""
    notes = result.get("notes")
    stated = notes.get("eval_every_nth_view", 1) if isinstance(notes, dict) else 1
    return stated if isinstance(stated, int) and stated > 0 else 1


def ours_on_same_views(folder: RunFolder, scene: str, result: dict[str, Any]) -> dict[str, Any] | None:
    """``psnr_curves`` and ``seconds_to_28_db`` of our trainings; None where there are none."""
    file = view_curves_file(folder, scene)
    if not file.exists():
        return None
    curves = {
        budget: curve_on_views([(seconds, psnr_db) for seconds, psnr_db in curve], every_nth_view(result))
        for budget, curve in read_json(file, "mulan evaluate engine").items()
    }
    return {"psnr_curves": curves, "seconds_to_28_db": fastest_to_psnr(list(curves.values()), THRESHOLD_DB)}
