r"""How well a map of perfect shape would show held-out views if localization alone said where it lies.

mulan evaluate table1 --protocol loop --image-size 200 --steps 9000 --seeds 5 --only A,B,alone,ours \
    --out runs/table1_loop_200
python benchmarks/loop_ceiling.py --run runs/table1_loop_200 --out runs/loop_ceiling

Photographs tell a map's shape, never its size, and its place only through the photograph whose pose is known
exactly. Here both shape and that photograph are perfect: the true poses, moved and scaled together to where
localization's joint Gaussian finds them most probable. The field learnt from true poses (setup A) goes
along and is judged at the true poses of the held-out views. No way of correcting poses by photographs can be
expected
to do better in this protocol.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.provenance import provenance
from mulan.geometry import se3
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.posed_images import PosedImage
from mulan.mission.run_folder import read_json, write_json
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_file import load_field
from mulan.reconstruction.held_out import psnr_db
from mulan.reconstruction.refinement.field_frame import FieldFrame
from mulan.reconstruction.refinement.pose_prior import PosePrior
from mulan.reconstruction.refinement.refine import pose_state

_STEPS = 8  # of Gauss-Newton; three are enough


@dataclass(frozen=True)
class Options:
    """Where localization alone would put a map of perfect shape."""

    run: Path
    """Folder of 'mulan evaluate table1 --protocol loop', setups A and B included."""
    out: Path
    """Folder for metrics.json."""


def most_probable(prior: PosePrior, T_true: Float[NDArray, "n 4 4"]) -> tuple[FieldFrame, FieldFrame, float]:
    """Where the true shape lies truly and most probably, and the standard deviation of its relative size."""
    true = FieldFrame(se3.from_parts(np.eye(3), T_true[:, :3, 3].mean(0)))
    frame, shape, information = true, true.to_field(T_true), np.eye(7)
    for _ in range(_STEPS):
        T = frame.to_world(shape)
        J = frame.carries(T).reshape(-1, 7)
        information = J.T @ prior.precision @ J
        frame = frame.moved(
            -np.linalg.solve(information, J.T @ prior.precision @ prior.residual(T).reshape(-1))
        )
    return true, frame, float(np.sqrt(np.linalg.inv(information)[6, 6]))


def mean_psnr_db(field: Path, views: tuple[PosedImage, ...], size: int, T: Float[NDArray, "n 4 4"]) -> float:
    """Of a field looked at from other poses than those of the photographs it is compared with."""
    engine, description = load_field(field)
    data = ImageTensors(load_captured(views, size))
    data.T_world_camera = torch.from_numpy(T).float()
    scores = [psnr_db(engine, data, i, description.sub_pixels) for i in range(len(views))]
    return float(np.mean(scores))


def seed_figures(folder: Path, size: int) -> dict[str, float]:
    """One seed: setup A where it is, and where localization alone would put it."""
    true, believed = read_transforms(folder / "true.json"), read_transforms(folder / "believed.json")
    state = pose_state(believed)
    assert state is not None, "in this protocol no robot is exact"
    T_true = np.stack([image.T_world_camera for image in true.train])
    at_truth, found, size_sigma = most_probable(state.prior, T_true)
    T_views = np.stack([view.T_world_camera for view in true.test])
    field = folder / "A" / "field.safetensors"
    return {
        "a_psnr_db": mean_psnr_db(field, true.test, size, T_views),
        "psnr_db": mean_psnr_db(field, true.test, size, at_truth.to_world(found.to_field(T_views))),
        "size_error": found.metres_per_unit - 1,
        "size_sigma": size_sigma,
    }


def main(options: Options) -> None:
    options.out.mkdir(parents=True, exist_ok=True)
    table = read_json(options.run / "metrics.json", "mulan evaluate table1")
    size = read_json(options.run / "config.json", "mulan evaluate table1")["evaluate table1"]["image_size"]
    seeds: dict[str, Any] = {}
    for folder in sorted(options.run.glob("seed_*")):
        seeds[folder.name] = found = seed_figures(folder, size)
        print(folder.name, {name: round(value, 4) for name, value in found.items()}, flush=True)
    a_db, moved_db = (float(np.mean([s[name] for s in seeds.values()])) for name in ("a_psnr_db", "psnr_db"))
    b_db, alone_db = (table["setups"][name]["psnr_db"]["mean"] for name in ("B", "alone"))
    metrics = {
        "provenance": provenance(0) | {"seeds": sorted(table["provenance"]["seeds"])},
        "seeds": seeds,
        "a_psnr_db": a_db,
        "psnr_db": moved_db,
        "gap_recovered": (moved_db - b_db) / (a_db - b_db),
        "gap_recovered_vs_alone": (moved_db - alone_db) / (a_db - alone_db),
    }
    write_json(options.out / "metrics.json", metrics)
    print({name: value for name, value in metrics.items() if isinstance(value, float)})


if __name__ == "__main__":
    main(tyro.cli(Options))
