"""What is lost without the native engine, why, and how to get it: said by a training and by the doctor."""

import logging
import re
import subprocess
from pathlib import Path

import pytest

import mulan.radiance.speed  # noqa: F401  (not to be looked for while the package's path is another)
from mulan.cli.main import run_command
from mulan.mission.nerfstudio import write_transforms
from mulan.radiance import backend
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels import native_library
from mulan.radiance.kernels.native_library import NativeLibrary, find_native_library
from mulan.radiance.kernels.native_structures import ABI_VERSION
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine
from tests.reconstruction.cube_scene import cube_images

BOX = SceneSpace((0.0, 0.0, 0.0), 1.0, False)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Where the package now looks for its library: nothing is there."""
    (tmp_path / "native").mkdir()
    monkeypatch.setattr(native_library.mulan.radiance, "__path__", [str(tmp_path)])
    find_native_library.cache_clear()
    yield tmp_path / "native"
    monkeypatch.undo()
    find_native_library.cache_clear()


def other_version(path: Path) -> None:
    source = path.with_suffix(".c")
    source.write_text(f"int mulan_abi_version(void) {{ return {ABI_VERSION + 1}; }}")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(path), str(source)], check=True)


def half_a_version(path: Path) -> None:
    source = path.with_suffix(".c")
    source.write_text(f"int mulan_abi_version(void) {{ return {ABI_VERSION}; }}")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(path), str(source)], check=True)


def text(path: Path) -> None:
    path.write_text(
        "this is not a library, but it is longer than the first few bytes of one would have to be"
    )


def cut_off(path: Path) -> None:
    half_a_version(path)
    path.write_bytes(path.read_bytes()[:-1000])


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (None, "no libmulan_native"),
        (other_version, f"is not version {ABI_VERSION}"),
        (half_a_version, "lacks mulan_"),
        (text, "invalid ELF header|file too short|slice is not valid"),
        (cut_off, "is cut off"),
    ],
)
def test_the_torch_engine_runs_and_says_why(
    folder: Path, caplog: pytest.LogCaptureFixture, spoil, reason: str
) -> None:
    if spoil:
        spoil(folder / native_library.FILE_NAME)
    with caplog.at_level(logging.WARNING):
        engine = backend.new_engine(FieldConfig(), MarchConfig(), BOX, True, 0)
    assert isinstance(engine, TorchEngine)
    (record,) = caplog.records

    assert re.search(reason, record.getMessage()), record.getMessage()
    assert backend.WITHOUT_NATIVE in record.getMessage()


def test_an_older_library_that_loads_beats_a_newer_one_that_does_not(
    folder: Path, library: NativeLibrary
) -> None:
    (folder / "build").mkdir()
    (folder / native_library.FILE_NAME).write_bytes(library.path.read_bytes())
    text(folder / "build" / native_library.FILE_NAME)
    found, detail = find_native_library()
    assert found is not None, detail
    assert found.path == folder / native_library.FILE_NAME


def test_a_training_begins_with_it(folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "images").mkdir()
    write_transforms(cube_images(tmp_path / "images", train=4), tmp_path / "images" / "transforms.json")
    data = ["--data", str(tmp_path / "images" / "transforms.json")]
    with caplog.at_level(logging.INFO):
        assert run_command(["train", str(tmp_path / "run"), *data, "--steps", "2", "--image-size", "24"]) == 0
    assert caplog.records[0].getMessage().startswith("no native engine (no libmulan_native")
    assert (tmp_path / "run" / "field.safetensors").is_file()


def test_the_doctor_says_it_and_measures_the_torch_engine(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["doctor"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "the slower torch engine runs" in printed
    assert "apt-get install g++" in printed
    assert "M samples/s" in printed
