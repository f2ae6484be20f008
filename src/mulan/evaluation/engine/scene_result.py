"""Our own engine on one scene: a training for every budget, through the trainer everyone uses."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mulan.evaluation.engine.curve import THRESHOLD_DB, ViewCurve, fastest_to_psnr
from mulan.evaluation.engine.listener import Listener
from mulan.evaluation.engine.peak_memory import peak_memory_gb, reset_peak_memory
from mulan.evaluation.engine.scenes import EngineScene
from mulan.evaluation.engine.scoring import CurveRecorder, rays_per_s
from mulan.mission.run_folder import RunFolder, write_json
from mulan.radiance.backend import Device
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingStatus, train
from mulan.reconstruction.weights import NoWeights


def measure_scene(
    scene: EngineScene, seed: int, device: Device, folder: RunFolder, listener: Listener
) -> dict[str, Any]:
    """Train once for every budget and score all held-out views as it goes, off the clock.

    Args:
        scene: Data, size, budgets.
        seed: Source of all randomness.
        device: Where to learn and render.
        folder: Each training gets a folder below.
        listener: Hears of progress and results.

    Returns:
        ``psnr_db_at_s`` (budget to mean PSNR of the finished training), ``psnr_curves`` (of each training),
        ``psnr_curve`` (of the longest), ``seconds_to_28_db`` (of the training that was first),
        ``samples_per_s``, ``steps``, ``render_rays_per_s`` and ``rays_a_pixel`` of its pictures (of the
        longest), ``peak_memory_gb`` (of the whole process, while learning and rendering).

    Raises:
        InputError: See :func:`mulan.reconstruction.trainer.train`.
    """
    images = scene.images()
    reset_peak_memory()
    views = ImageTensors(load_captured(images.test, scene.image_size))
    views.move_to(device.resolve())
    final_db: dict[str, float] = {}
    curves: dict[str, list[tuple[float, float]]] = {}
    view_curves: dict[str, ViewCurve] = {}
    longest: dict[str, Any] = {}
    for budget_s in sorted(scene.budgets_s):
        run = RunFolder(folder.root / f"{scene.name}_{budget_s:g}s")
        run.checkpoint.unlink(missing_ok=True)  # a benchmark never goes on where another stopped
        recorder = CurveRecorder(views, budget_s, scene.curve_points)
        follow = _follow(recorder, listener.begin(f"{scene.name}, {budget_s:g} s"))
        config = TrainConfig(image_size=scene.image_size, time_budget_s=budget_s, seed=seed, device=device)
        result = train(images, NoWeights(), config, run, follow)
        key = f"{budget_s:g}"
        final_db[key] = recorder.finish(result.engine, result.seconds, result.description.sub_pixels)
        curves[key], view_curves[key] = recorder.curve, recorder.view_curve
        longest = {
            "samples_per_s": result.samples / result.seconds,
            "steps": result.steps,
            "rays_a_pixel": result.description.sub_pixels**2,
            "render_rays_per_s": rays_per_s(result.engine, views),
        }
        listener.say(f"{scene.name}: {final_db[key]:.2f} dB after {key} s ({len(views)} views)")
    write_json(view_curves_file(folder, scene.name), view_curves)
    return {
        "psnr_db_at_s": final_db,
        "psnr_curve": curves[f"{max(scene.budgets_s):g}"],
        "psnr_curves": curves,
        "seconds_to_28_db": fastest_to_psnr(list(curves.values()), THRESHOLD_DB),
        **longest,
        "peak_memory_gb": peak_memory_gb(),
        "image_size": scene.image_size,
        "views": len(views),
        "device": device.resolve().type,
    }


def view_curves_file(folder: RunFolder, scene: str) -> Path:
    """Where the PSNR of every view lies, so that a peer scored on fewer views can be compared on those."""
    return folder.root / f"{scene}_views.json"


def _follow(
    recorder: CurveRecorder, progress: Callable[[float, float, str], None]
) -> Callable[[TrainingStatus], None]:
    def follow(status: TrainingStatus) -> None:
        if status.fraction_done < 1:
            recorder.visit(status.engine, status.seconds, status.sub_pixels)
        progress(status.fraction_done, 1, recorder.latest)

    return follow
