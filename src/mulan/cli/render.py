"""``mulan render``: views of a trained run as pictures and one animation."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mulan.cli.progress import console, progress_bar
from mulan.errors import InputError
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.camera_paths import orbit
from mulan.reconstruction.field_file import load_field
from mulan.reconstruction.pictures import write_pictures


@dataclass(frozen=True)
class Options:
    """Render views of a trained run: an orbit around the scene, or the held-out and training views again."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder."""
    out: Path | None = None
    """Folder for the pictures; default <run>/orbit or <run>/views."""
    path: Literal["orbit", "views"] = "orbit"
    """Camera path: around the scene, or every photograph's own pose."""
    frames: int = 48
    """Pictures on the orbit."""
    image_size: int = 192
    """Longest side in pixels."""
    sub_pixels: int | None = None
    """Rays a side of a pixel that its colour is the mean of; as the field was learnt if not given."""


def main(arguments: Sequence[str]) -> int:
    """Render one run."""
    options = tyro.cli(Options, args=arguments, prog="mulan render")
    if options.sub_pixels is not None and options.sub_pixels < 1:
        raise InputError("--sub-pixels", "value", f"is {options.sub_pixels}", "give one or more")
    run = RunFolder(options.run)
    engine, description = load_field(run.field)
    images = read_transforms(run.transforms)
    if options.path == "orbit":
        views = orbit(images, options.frames)
    else:
        views = [(image.camera, image.T_world_camera) for image in (*images.test, *images.train)]
    folder = options.out or run.root / options.path
    with progress_bar("Rendering") as progress:
        sub_pixels = description.sub_pixels if options.sub_pixels is None else options.sub_pixels
        animation = write_pictures(engine, views, options.image_size, folder, progress, sub_pixels)
    console.print(f"Pictures: [bold]{folder}[/] ({len(views)}), animation: [bold]{animation}[/]")
    return 0
