"""Loads a posed image set with little memory to spare; prints whether it fits and what it took."""

import json
import resource
import sys
from pathlib import Path

import torch

from mulan.mission.nerfstudio import read_transforms
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.photographs import load_photographs
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import NoWeights


def own_memory_bytes(kind: str) -> int:
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith(kind)).split()[1]) * 1024


def main() -> None:
    folder, share, headroom_bytes = Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
    images = read_transforms(folder / "transforms.json")
    before = own_memory_bytes("RssAnon")
    limit = own_memory_bytes("VmData") + headroom_bytes
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    config = TrainConfig(image_size=10_000, image_memory_share=share)
    try:
        photographs = load_photographs(images, config, folder / "decoded")
        data = photographs.with_weights(NoWeights(), SceneSpace((0.0, 0.0, 0.0), 1.0, False))
    except (MemoryError, RuntimeError):  # numpy's word for it, and torch's
        print(json.dumps({"fits": False}))
        return
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        data.sample(4096, generator)
    print(json.dumps({"fits": True, "grown_bytes": own_memory_bytes("RssAnon") - before}))


if __name__ == "__main__":
    main()
