"""``mulan export``: a run's poses, images and field in the formats of other programs."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mulan.cli.progress import console, progress_bar
from mulan.export.crop import CropConfig
from mulan.export.exported_run import ExportedRun, Poses
from mulan.export.image_sets import export_colmap, export_nerfstudio
from mulan.export.mesh_files import MeshConfig, export_mesh
from mulan.export.ply import write_points
from mulan.export.surface_points import PointCloudConfig, surface_points
from mulan.export.trajectories import export_trajectories
from mulan.export.video import VideoConfig, export_video
from mulan.mission.coloured_points import ColouredPoints
from mulan.mission.run_folder import RunFolder

Format = Literal["nerfstudio", "colmap", "tum", "points", "mesh", "video"]


@dataclass(frozen=True)
class Options:
    """Write what a run knows in the formats of other programs; scale stays metric, the world the run's."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder."""
    to: tuple[Format, ...]
    """One or several: nerfstudio (transforms.json and images), colmap (sparse model and images), tum
    (trajectories), points (PLY), mesh (PLY and GLB), video (MP4)."""
    out: Path | None = None
    """Folder to write; default <run>/export."""
    link: bool = False
    """Hard links to the photographs instead of copies, where the file system allows."""
    poses: Poses = "best"
    """Refined while learning, or as localized; best: refined if the field was learnt at them."""
    colmap_text: bool = False
    """COLMAP's text files instead of the binary ones."""
    crop: CropConfig = field(default_factory=CropConfig)
    """The part of the world for points and mesh."""
    points: PointCloudConfig = field(default_factory=PointCloudConfig)
    """Point cloud."""
    mesh: MeshConfig = field(default_factory=MeshConfig)
    """Mesh."""
    video: VideoConfig = field(default_factory=VideoConfig)
    """Video."""


def export(options: Options) -> None:
    """Write everything asked for; what needs the field is tried first, so that nothing is done in vain."""
    exported = ExportedRun.of(RunFolder(options.run), options.poses)
    folder = options.out or options.run / "export"
    with_field = {"points", "mesh", "video"} & set(options.to)
    engine, description = exported.field() if with_field else (None, None)
    console.print(f"Poses: {'refined while learning' if exported.refined else 'as localized or given'}")
    points: ColouredPoints | None = None
    points_file: Path | None = None
    if "points" in options.to:
        assert engine is not None
        assert description is not None
        box = options.crop.box(description.space) if options.crop.given else None
        with progress_bar("Points") as progress:
            points = surface_points(engine, exported.images, options.points, box, progress)
        points_file = folder / "points.ply"
        write_points(points, points_file)
        console.print(f"Points: [bold]{points_file}[/] ({len(points.position_m)})")
    if "nerfstudio" in options.to:
        path = export_nerfstudio(exported.images, folder / "nerfstudio", options.link, points_file)
        console.print(f"nerfstudio: [bold]{path}[/]")
    if "colmap" in options.to:
        path = export_colmap(
            exported.images, folder / "colmap", options.link, points, as_text=options.colmap_text
        )
        console.print(f"COLMAP: [bold]{path}[/]")
    if "tum" in options.to:
        files = export_trajectories(exported, folder / "tum")
        console.print(f"TUM: [bold]{folder / 'tum'}[/] ({', '.join(path.name for path in files)})")
    if "mesh" in options.to:
        assert engine is not None
        assert description is not None
        box = options.crop.box(description.space)
        with progress_bar("Mesh") as progress:
            mesh = export_mesh(
                engine, description.space, exported.images, box, options.mesh, folder, progress
            )
        size = " x ".join(f"{side:.2f}" for side in mesh.size_m)
        names = " ".join(f"[bold]{path}[/]" for path in mesh.files)
        console.print(f"Mesh: {names} ({mesh.triangles} triangles, {size} m)")
    if "video" in options.to:
        assert engine is not None
        assert description is not None
        with progress_bar("Video") as progress:
            files = export_video(
                engine, exported.images, options.video, description.sub_pixels, folder, progress
            )
        console.print("Video: " + " ".join(f"[bold]{path}[/]" for path in files))


def main(arguments: Sequence[str]) -> int:
    """Export one run."""
    export(tyro.cli(Options, args=arguments, prog="mulan export"))
    return 0
