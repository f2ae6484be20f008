import subprocess
import sys
from pathlib import Path

from mulan.mission.nerfstudio import write_transforms
from tests.reconstruction.cube_scene import cube_images


def test_two_processes_write_the_same_field_byte_for_byte(tmp_path: Path):
    (tmp_path / "images").mkdir()
    write_transforms(cube_images(tmp_path / "images"), tmp_path / "images" / "transforms.json")
    program = [sys.executable, "-c", "from mulan.cli.main import main; main()", "train"]
    fields = []
    for name, seed in (("a", "5"), ("b", "5"), ("c", "6")):
        options = ["--steps", "40", "--image-size", "24", "--seed", seed]
        data = ["--data", str(tmp_path / "images" / "transforms.json")]
        done = subprocess.run(
            [*program, str(tmp_path / name), *data, *options], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        fields.append((tmp_path / name / "field.safetensors").read_bytes())
    assert fields[0] == fields[1]
    assert fields[0] != fields[2]
