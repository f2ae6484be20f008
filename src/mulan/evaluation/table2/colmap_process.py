"""COLMAP in a process of its own: what it aborts on, or takes too long for, costs one setup and no more.

``python -m mulan.evaluation.table2.colmap_process FOLDER`` does the job in ``FOLDER/job.json`` and writes its
maps to ``FOLDER/maps``. Each step is one line on standard output; COLMAP's own words go to standard error.
"""

import json
import sys
from pathlib import Path
from typing import Any

STEPS = ("features", "matching", "mapping")


def main(folder: Path) -> int:
    """Features, exhaustive matching, incremental mapping, on the CPU, with lenses that are known."""
    import pycolmap

    job = json.loads((folder / "job.json").read_text())
    database, photographs, threads = folder / "database.db", job["photographs"], job["threads"]
    pycolmap.set_random_seed(job["seed"])
    print(STEPS[0], flush=True)
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.use_gpu = threads, False
    extraction.sift.max_num_features = job["features"]
    for camera in job["cameras"]:
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model, reader.camera_params = "OPENCV", camera["lens"]
        one = pycolmap.CameraMode.PER_FOLDER
        pycolmap.extract_features(database, photographs, camera["names"], one, reader, extraction)
    print(STEPS[1], flush=True)
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads, matching.use_gpu = threads, False
    pycolmap.match_exhaustive(database, matching)
    print(STEPS[2], flush=True)
    maps = folder / "maps"
    maps.mkdir()
    pycolmap.incremental_mapping(database, photographs, maps, _mapping(pycolmap, job))
    return 0


def _mapping(pycolmap: Any, job: dict[str, Any]) -> Any:
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.num_threads, mapping.random_seed = job["threads"], job["seed"]
    mapping.ba_refine_focal_length = mapping.ba_refine_extra_params = False
    mapping.mapper.abs_pose_refine_focal_length = mapping.mapper.abs_pose_refine_extra_params = False
    mapping.extract_colors = False
    return mapping


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
