"""Small image sets on disk."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from mulan.geometry import se3
from mulan.mission import pixels


def write_images(folder: Path, names: list[str], size: tuple[int, int] = (8, 6)) -> None:
    rng = np.random.default_rng(len(names))
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        encode = pixels.encode_png if name.endswith("png") else pixels.encode_jpeg
        path.write_bytes(encode(rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)))


def frame(name: str, turn_rad: float = 0.3, **fields: Any) -> dict[str, Any]:
    T = se3.exp(np.array([0.1, turn_rad, -0.2, 1.0, 2.0, 3.0]))
    return {"file_path": name, "transform_matrix": T.tolist(), **fields}


def write_record(path: Path, record: dict[str, Any]) -> Path:
    path.write_text(json.dumps(record))
    return path
