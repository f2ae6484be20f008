import subprocess
import sys
from pathlib import Path

import pytest
import torch

from mulan.cli.doctor import diagnose
from mulan.errors import InputError
from mulan.radiance.backend import Device, new_engine
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.gpu.find_gpu import find_gpu
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine
from mulan.reconstruction.field_choice import choose_field, choose_march
from mulan.reconstruction.train_config import TrainConfig

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_GPU = pytest.mark.skipif(find_gpu()[0] is not None, reason="there is a GPU")
SIZES = FieldConfig(log2_table_size=8), MarchConfig(steps=16), SceneSpace((0.0, 0.0, 0.0), 1.0, False)


@WITHOUT_GPU
def test_without_a_gpu_the_cpu_is_taken_and_asking_for_one_is_refused():
    assert Device.AUTO.resolve() == Device.CPU.resolve() == torch.device("cpu")
    assert isinstance(new_engine(*SIZES, True, 0), NativeEngine | TorchEngine)
    with pytest.raises(InputError, match="--device"):
        Device.GPU.resolve()


@WITHOUT_GPU
def test_the_benchmark_says_in_one_sentence_that_it_needs_a_gpu(tmp_path):
    command = [sys.executable, "benchmarks/gpu.py", "--data", str(tmp_path), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    (sentence,) = done.stderr.strip().splitlines()
    assert "needs a GPU" in sentence
    assert not (tmp_path / "out").exists()


def test_the_doctor_says_which_engine_learns():
    (engine,) = (finding.detail for finding in diagnose() if finding.part == "engine")
    gpu = find_gpu()[0] is not None
    assert ("on the GPU" if gpu else "on the CPU") in engine


def test_a_gpu_gets_a_larger_field_and_larger_batches():
    small, large = (choose_field(800, 100, False, on_gpu) for on_gpu in (False, True))
    assert large.levels * 2**large.log2_table_size > small.levels * 2**small.log2_table_size
    assert choose_march(800, False, on_gpu=True).steps > choose_march(800, False).steps
    assert TrainConfig().samples_a_batch(on_gpu=True) > TrainConfig().samples_a_batch(on_gpu=False)
    assert TrainConfig(batch_samples=7).samples_a_batch(on_gpu=True) == 7
