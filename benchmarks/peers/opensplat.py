"""OpenSplat (3-D Gaussian splatting in C++) on the CPU, run as a program of its own.

PEER_PYTHON benchmarks/peers/opensplat.py --program OPENSPLAT --data LEGO --image-size 100 --out os.json

The program writes its Gaussians every few hundred steps; splats.py scores them afterwards, off the clock.
Object scenes only: it ignores the principal point and needs a point cloud, so photographs are refused.
"""

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from protocol import Result, common_notes, parser, psnr_db, scene_of
from scene import Scene, View
from splats import Splats, read_ply, render

BACKGROUND = (0.6130, 0.0101, 0.3984)  # fixed in the program; photographs are put over it, renders over white
EXTENT_M = 1.3  # half side of the cube the first Gaussians are drawn in, as the article does for these scenes


def write_project(scene: Scene, folder: Path, points: int, seed: int) -> None:
    """The training views as a nerfstudio project; random points where a COLMAP cloud would go."""
    camera = scene.camera
    frames = []
    for i, view in enumerate(scene.train):
        name = f"{i:04d}.png"
        Image.fromarray(np.rint(view.over(BACKGROUND) * 255).astype(np.uint8)).save(folder / name)
        frames.append({"file_path": name, "transform_matrix": view.T_world_camera.tolist()})
    meta = {"camera_model": "OPENCV", "w": camera.width, "h": camera.height, "ply_file_path": "points.ply"}
    meta |= {"fl_x": camera.fl_x, "fl_y": camera.fl_y, "cx": camera.cx, "cy": camera.cy, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(meta))
    draw = np.random.default_rng(seed)
    place, colour = draw.uniform(-EXTENT_M, EXTENT_M, (points, 3)), draw.integers(0, 256, (points, 3))
    header = ["ply", "format ascii 1.0", f"element vertex {points}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    rows = ["{:.6f} {:.6f} {:.6f} {} {} {}".format(*p, *c) for p, c in zip(place, colour, strict=True)]
    (folder / "points.ply").write_text("\n".join([*header, "end_header", *rows]) + "\n")


def train(command: list[str], folder: Path, options: argparse.Namespace) -> list[float]:
    """Run the program; seconds on the training clock after each step, the writing of files taken out."""
    environment = os.environ | {"OMP_NUM_THREADS": str(options.threads), "OMP_WAIT_POLICY": "passive"}
    gaps: list[float] = []
    writing = False
    last_s: float | None = None
    with subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        said: list[str] = []
        for line in process.stdout:
            said = [*said[-5:], line.strip()]
            if line.startswith("Wrote"):
                writing = True
            if not re.match(r"Step \d+:", line):
                continue
            now_s = _now_s(process.pid, options)
            typical_s = statistics.median(gaps[-20:]) if gaps else 0.0
            gaps.append(typical_s if writing or last_s is None else now_s - last_s)
            writing, last_s = False, now_s
            if sum(gaps) > options.budget_s:
                process.terminate()
    if not gaps:
        raise SystemExit(f"OpenSplat trained nothing: {' | '.join(said)}")
    return list(np.cumsum(gaps))


def _now_s(pid: int, options: argparse.Namespace) -> float:
    if options.clock == "wall":
        return time.perf_counter()
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") / options.threads


def score(splats: Splats, scene: Scene, views: list[View], unit: float) -> float:
    """Mean PSNR over the views [dB]: over white or the program's own colour, by depth or in its own order.

    The best of the four counts, so that nothing of the harness speaks against the peer.

    Args:
        splats: Saved Gaussians.
        scene: Its camera.
        views: Photographs to score on.
        unit: Length the program scales the scene to.
    """

    def mean_psnr_db(background: tuple[float, float, float], as_program: float | None) -> float:
        pairs = [
            (render(splats, scene.camera, v.T_world_camera, background, as_program=as_program), v)
            for v in views
        ]
        return float(np.mean([psnr_db(image, v.over(background)) for image, v in pairs]))

    return max(mean_psnr_db(b, order) for b in ((1.0, 1.0, 1.0), BACKGROUND) for order in (None, unit))


def main() -> None:
    options = parser(str(__doc__).splitlines()[0])
    options.add_argument("--program", default="opensplat", help="the opensplat program; default: on the PATH")
    options.add_argument("--iterations", type=int, default=4000, help="length of its schedule")
    options.add_argument("--points", type=int, default=10_000, help="Gaussians to start from")
    options.add_argument("--save-every", type=int, default=200, help="steps between scored states")
    given = options.parse_args()
    program = shutil.which(given.program)
    if program is None:
        raise SystemExit(f"{given.program}: no such program; see benchmarks/peers/README.md on OpenSplat")
    scene = scene_of(given)
    if not scene.is_object:
        raise SystemExit(
            f"{given.data}: OpenSplat needs a point cloud with photographs; give an object scene"
        )
    version = subprocess.run([program, "--version"], capture_output=True, text=True).stdout.strip()
    result = Result("OpenSplat (CPU)", version, notes=common_notes(scene, given))
    views = scene.test[:: given.eval_every_nth_view]
    origins = np.stack([view.T_world_camera[:3, 3] for view in scene.train])
    unit = float(np.abs(origins - origins.mean(0)).max())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_project(scene, folder, given.points, given.seed)
        command = [program, str(folder), "--cpu", "--keep-crs", "-o", str(folder / "out.ply")]
        command += ["-n", str(given.iterations), "-s", str(given.save_every), "--num-downscales", "0"]
        at_s = train(command, folder, given)
        saved = sorted(folder.glob("out_*.ply"), key=lambda path: int(path.stem[4:]))
        for path in [path for path in saved if int(path.stem[4:]) <= len(at_s)]:
            splats = read_ply(path)
            psnr = score(splats, scene, views, unit)
            seconds = at_s[int(path.stem[4:]) - 1]
            result.psnr_curve.append((round(seconds, 3), round(psnr, 3)))
            print(f"OpenSplat: {seconds:.1f} s, {path.stem[4:]} steps, {psnr:.2f} dB", flush=True)
    result.rays_per_s = len(at_s) * scene.camera.width * scene.camera.height / at_s[-1]
    result.notes |= {
        "steps": len(at_s),
        "s_per_step": at_s[-1] / len(at_s),
        "settings": f"defaults but --num-downscales 0, -n {given.iterations}, {given.points} random points",
        "psnr": "best of four: over white or the fixed colour it trains over, by depth or in its own order",
    }
    result.finish(given.out)


if __name__ == "__main__":
    main()
