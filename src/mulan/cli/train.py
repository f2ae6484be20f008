"""``mulan train``: learn the radiance field from a run or from any posed image set."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mulan.cli.progress import console, progress_bar
from mulan.errors import InputError
from mulan.mission.image_sets import read_posed_images
from mulan.mission.nerfstudio import read_transforms, write_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.paper_weights import PaperCorrectedWeights, PaperWeights
from mulan.reconstruction.process_group import ProcessGroup, processes_of_torchrun
from mulan.reconstruction.reconstruct import reconstruct
from mulan.reconstruction.refinement.refine import REFINED
from mulan.reconstruction.refinement.refinement_config import RefinementConfig
from mulan.reconstruction.torchrun import is_leader
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingStatus
from mulan.reconstruction.weights import NoWeights, UncertaintyWeights, Weighting
from mulan.viewer.viewer_config import ViewerConfig


@dataclass(frozen=True)
class Options:
    """Learn the radiance field. Stopped at any moment, the same command goes on where it was.

    Several processes learn together under torchrun: torchrun --nproc-per-node 2 -m mulan.cli.main train RUN
    """

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder; 'mulan localize' put the posed images there unless --data names others."""
    data: Path | None = None
    """Posed image set of your own: a folder or transforms.json (Blender, nerfstudio, instant-ngp)."""
    hold_out_every: int = 8
    """With --data: every n-th image becomes a test view where the set names none; 0 holds out none."""
    weighting: Literal["none", "paper", "paper-corrected", "uncertainty"] = "uncertainty"
    """Trust in each pixel: equal, the paper's formula as printed or with its sign and ellipse put right, or
    what its pose covariance deserves."""
    refine_poses: bool = False
    """Correct the poses that carry a covariance while the field is learnt (transforms_refined.json)."""
    view: bool = False
    """Show the field in the browser while it learns; the page can pause the training."""
    viewer: ViewerConfig = field(default_factory=ViewerConfig)
    """The page."""
    config: tyro.conf.AvoidSubcommands[tyro.conf.OmitArgPrefixes[TrainConfig]] = field(
        default_factory=TrainConfig
    )
    """Training options."""


def weighting_named(name: Literal["none", "paper", "paper-corrected", "uncertainty"]) -> Weighting:
    """The weighting a command line word stands for."""
    match name:
        case "none":
            return NoWeights()
        case "paper":
            return PaperWeights()
        case "paper-corrected":
            return PaperCorrectedWeights()
        case "uncertainty":
            return UncertaintyWeights()


def images_of(options: Options) -> PosedImageSet:
    """The posed images to learn from.

    Raises:
        InputError: The run has none and no other set was named.
    """
    if options.data is not None:
        return read_posed_images(options.data, options.hold_out_every)
    run = RunFolder(options.run)
    if not run.transforms.exists():
        raise InputError(
            run.transforms,
            "file",
            "does not exist",
            "make it with 'mulan localize', or name images with --data",
        )
    return read_transforms(run.transforms)


def train_run(
    run: RunFolder,
    images: PosedImageSet,
    weighting: Weighting,
    config: TrainConfig,
    group: ProcessGroup | None = None,
    refinement: RefinementConfig | None = None,
    watch: Callable[[TrainingStatus], None] | None = None,
) -> None:
    """Train with a progress bar and say how good it became."""
    if group:
        console.print(f"{group.place.processes} processes learn together, a part of every batch each")
    console.print(f"{len(images.train)} images to learn from, {len(images.test)} held out")
    if run.checkpoint.exists():
        console.print("Going on with the training that was stopped")
    before = run.field.stat().st_mtime_ns if run.field.exists() else None
    with progress_bar("Training") as progress:
        metrics = reconstruct(images, weighting, config, run, progress, group, refinement, watch)
    if before is not None:
        kept = run.field.stat().st_mtime_ns == before
        console.print(
            "Kept: this run was trained earlier with the same images and options"
            if kept
            else "The field this run held before was replaced"
        )
    score = f"{metrics['train_seconds']:.0f} s and {metrics['steps']} steps of training"
    if metrics["psnr_db"] is not None:
        score = f"Held-out views: [bold]{metrics['psnr_db']:.2f} dB[/] PSNR after {score}"
    console.print(score)
    if "median_correction_m" in metrics:
        moved_cm = 100 * metrics["median_correction_m"]
        console.print(f"Poses corrected by {moved_cm:.1f} cm (median): [bold]{run.root / REFINED}[/]")
    if doubted := metrics.get("doubted"):
        shown = ", ".join(doubted[:5]) + (", …" if len(doubted) > 5 else "")
        console.print(
            f"[yellow]Could not converge:[/] {len(doubted)} images fit nowhere near where localization has "
            f"them and were left out ({shown}); localize more precisely, or look whether they show the scene"
        )


def _page(
    run: RunFolder, options: Options
) -> AbstractContextManager[Callable[[TrainingStatus], None] | None]:
    if not options.view or not is_leader():
        return nullcontext()
    # the page's library takes a second to load, which other trainings need not wait for
    from mulan.viewer.serve import page_of_training

    return page_of_training(run, options.viewer, console.print)


def main(arguments: Sequence[str]) -> int:
    """Train one run."""
    options = tyro.cli(Options, args=arguments, prog="mulan train")
    run = RunFolder(options.run)
    with processes_of_torchrun() as group:
        with group.all_or_none() if group else nullcontext():
            images = images_of(options)
            if options.data is not None and is_leader():
                run.check_writable()
                write_transforms(
                    images, run.transforms
                )  # the run then holds what plan, render and report need
        refinement = RefinementConfig() if options.refine_poses else None
        with _page(run, options) as watch:
            weighting = weighting_named(options.weighting)
            train_run(run, images, weighting, options.config, group, refinement, watch)
    if not is_leader():
        return 0
    run.record_config("train", asdict(options))
    console.print(f"Field: [bold]{run.field}[/]")
    console.print(f"Next: [cyan]mulan plan {options.run}[/]")
    return 0
