"""Whether an exported mesh has the built-in room's true measures: the rover's hull, as JSON and a picture.

mulan demo --out runs/demo
python benchmarks/mesh_scale.py --run runs/demo/oracle --bag runs/demo/mission.mcap --out runs/mesh_scale
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import trimesh
import tyro
from numpy.typing import NDArray

from mulan.cli.progress import progress_bar
from mulan.evaluation.provenance import provenance
from mulan.export.crop import CropConfig
from mulan.export.exported_run import ExportedRun
from mulan.export.mesh_files import MeshConfig, export_mesh
from mulan.geometry import se3
from mulan.localization.accuracy import world_from_truth
from mulan.mission.bag_reader import read_mission
from mulan.mission.run_folder import RunFolder, write_atomically, write_json


@dataclass(frozen=True)
class Options:
    """Mesh the rover of a run on the built-in room and measure its hull."""

    run: Path
    """Trained run, best at true poses."""
    bag: Path
    """The simulated mission it is of, for the room's place in the run's world."""
    out: Path
    """Folder for mesh.ply, mesh.glb, metrics.json and faces.png."""
    resolution: int = 160
    """Cells along the box's longest side."""


@dataclass(frozen=True)
class Face:
    """One side of the hull: where it is along an axis, and the part of it nothing else stands before."""

    axis: int
    sign: int
    true_m: float
    within: dict[int, tuple[float, float]]


SIDE, BOW = {0: (-0.38, 0.05), 2: (0.34, 0.5)}, {1: (-0.2, 0.2), 2: (0.33, 0.51)}
FACES = {
    "bow": Face(0, 1, 0.4405, BOW),
    "stern": Face(0, -1, 0.4405, BOW),
    "left": Face(1, 1, 0.2505, SIDE),
    "right": Face(1, -1, 0.2505, SIDE),
    "deck": Face(2, 1, 0.5505, {0: (-0.1, 0.25), 1: (-0.12, 0.12)}),
}
NEAR_M = 0.12


def offsets_m(position_m: NDArray, face: Face) -> NDArray:
    """How far outside a face the vertices near it lie."""
    near = np.abs(face.sign * position_m[:, face.axis] - face.true_m) < NEAR_M
    for axis, (low, high) in face.within.items():
        near &= (position_m[:, axis] > low) & (position_m[:, axis] < high)
    return face.sign * position_m[near, face.axis] - face.true_m


def main(options: Options) -> None:
    T_world_truth = world_from_truth(read_mission(options.bag))
    assert T_world_truth is not None, "the bag has no ground truth"
    exported = ExportedRun.of(RunFolder(options.run))
    engine, description = exported.field()
    x, y, z = se3.transform(T_world_truth, np.array([0.0, 0.0, 0.6])).tolist()
    crop = CropConfig((x, y, z), (3.2, 3.2, 1.5))
    config = replace(MeshConfig(), resolution=options.resolution)
    with progress_bar("Mesh") as progress:
        export_mesh(
            engine,
            description.space,
            exported.images,
            crop.box(description.space),
            config,
            options.out,
            progress,
        )
    mesh: Any = trimesh.load(options.out / "mesh.ply", process=False)
    position_m = np.asarray(mesh.vertices) @ T_world_truth[:3, :3]
    position_m = position_m - T_world_truth[:3, 3] @ T_world_truth[:3, :3]
    found = {name: offsets_m(position_m, face) for name, face in FACES.items()}
    median_m = {name: float(np.median(off)) if len(off) else None for name, off in found.items()}
    true = {name: face.true_m for name, face in FACES.items()}

    def span_m(a: str, b: str) -> dict[str, float | None]:
        off_a, off_b = median_m[a], median_m[b]
        wide = None if off_a is None or off_b is None else true[a] + true[b] + off_a + off_b
        return {"true_m": true[a] + true[b], "mesh_m": wide}

    record = {
        **provenance(0),
        "resolution": options.resolution,
        "triangles": len(mesh.faces),
        "length": span_m("bow", "stern"),
        "width": span_m("left", "right"),
        "median_offset_m": median_m,
    }
    write_json(options.out / "metrics.json", record)
    figure, axes = plt.subplots(figsize=(6, 4))
    for name, off in found.items():
        axes.hist(100 * off, np.linspace(-8, 8, 65).tolist(), histtype="step", label=f"{name} ({len(off)})")
    axes.set(xlabel="vertices outside the true face [cm]", ylabel="vertices")
    axes.legend()
    write_atomically(options.out / "faces.png", lambda path: figure.savefig(path, dpi=120))
    print(record["length"], record["width"], median_m)


if __name__ == "__main__":
    main(tyro.cli(Options))
