"""What nerfstudio demands of a folder, by its parser's behaviour; it is too large to install here."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h")
CAMERA_MODELS = ("OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE", "EQUIRECTANGULAR")


def check_nerfstudio(folder: Path) -> dict[str, Any]:
    """Assert that a folder would be read; returns ``transforms.json``."""
    meta = json.loads((folder / "transforms.json").read_text())
    assert meta["camera_model"] in CAMERA_MODELS
    files = []
    for frame in meta["frames"]:
        file = folder / frame["file_path"]
        assert file.is_file()
        # downscaled copies are sought by the bare name, so bare names must differ
        files.append(file.name)
        for key in INTRINSICS:
            assert (key in meta) != (key in frame), key  # once for all, or in each
        size = Image.open(file).size
        assert size == (meta.get("w", frame.get("w")), meta.get("h", frame.get("h")))
        T = np.array(frame["transform_matrix"])
        assert T.shape == (4, 4)
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-9)
        assert np.linalg.det(T[:3, :3]) > 0
        np.testing.assert_array_equal(T[3], [0, 0, 0, 1])
    assert len(set(files)) == len(files)
    splits = [key for key in ("train_filenames", "val_filenames", "test_filenames") if key in meta]
    assert len(splits) in (0, 3)  # a file that names some splits must name all
    names = {frame["file_path"] for frame in meta["frames"]}
    for split in splits:
        assert set(meta[split]) <= names
        assert meta[split]
    return meta
