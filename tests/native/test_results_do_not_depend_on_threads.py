"""Bit-equal: training, ray and pose gradients and rendering, across numbers of threads and processes."""

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels.native_grid import NativeGridConfig
from mulan.radiance.kernels.native_library import NativeLibrary
from mulan.radiance.native_engine import NativeConfig, NativeEngine
from mulan.radiance.ray_gradients import pose_gradients
from mulan.radiance.space import SceneSpace
from tests.native.spheres import batch_around, rays_around

FIELD = FieldConfig(levels=6, log2_table_size=12, finest_resolution=64, width=16, geometry_features=8)
MARCH = MarchConfig(steps=96, occupancy_resolution=32)


def digest_of_a_training(library: NativeLibrary, threads: int, unbounded: bool) -> str:
    """Everything that a training with pose refinement and a rendering compute, as one digest."""
    space = SceneSpace((0.0, 0.0, 0.0), 0.8, unbounded)
    native = NativeConfig(threads, occupancy=NativeGridConfig(warm_up_refreshes=1))
    engine = NativeEngine(FIELD, MARCH, space, True, seed=3, native=native, library=library)
    g = torch.Generator().manual_seed(0)
    digest = hashlib.sha256()
    for _ in range(40):
        batch = batch_around(400, g)
        report, gradients = engine.train_step_with_ray_gradients(batch, 1.0)
        image = torch.randint(5, (400,), generator=g)
        R = torch.eye(3).expand(5, 3, 3)
        poses = pose_gradients(library, gradients, batch.directions, image, R)
        digest.update(repr(report).encode())
        for array in (gradients.origins, gradients.directions, poses):
            digest.update(array.numpy().tobytes())
    o, d = rays_around(1000, g)
    rendering, samples = engine.render(o, d), engine.sample(o, d)
    for array in (*vars(rendering).values(), *vars(samples).values(), *engine.state().values()):
        digest.update(array.numpy().tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize("unbounded", [False, True], ids=["bounded", "unbounded"])
def test_any_number_of_threads_gives_the_same_bits(library: NativeLibrary, unbounded: bool) -> None:
    digests = {digest_of_a_training(library, threads, unbounded) for threads in (1, 2, 3, 5)}
    assert len(digests) == 1


def test_another_process_gives_the_same_bits(library: NativeLibrary) -> None:
    program = (
        "import sys; from pathlib import Path; "
        "from mulan.radiance.kernels.native_library import NativeLibrary; "
        "from tests.native.test_results_do_not_depend_on_threads import digest_of_a_training as digest; "
        "print(digest(NativeLibrary(Path(sys.argv[1])), 2, True))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(library.path)],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == digest_of_a_training(library, 3, True)
