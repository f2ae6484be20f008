import json
import sys
from pathlib import Path

import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.mission.image_sets import read_posed_images
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.run_folder import RunFolder
from mulan.radiance.kernels.native_library import find_native_library
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.field_file import load_field
from mulan.reconstruction.held_out import evaluate_held_out
from tests.reconstruction.cube_scene import cube_images

from .fake_peer import write_runner


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A cut-out cube with test views and an opaque one without, in place of lego and fox."""
    folders = []
    for name, opaque in (("object", False), ("place", True)):
        folder = tmp_path_factory.mktemp(name)
        write_transforms(cube_images(folder, opaque=opaque), folder / "transforms.json")
        folders.append(folder)
    return folders[0], folders[1]


@pytest.fixture(scope="module")
def finished(sets: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole benchmark with a five-hundredth of the time."""
    folder = tmp_path_factory.mktemp("engine")
    write_runner(folder / "peers", "nerfacto")
    write_runner(folder / "peers", "broken", "raise SystemExit('gave up')")
    assert run_command([*command(sets, folder), "--peer-python", sys.executable]) == 0
    return folder


def command(sets: tuple[Path, Path], folder: Path) -> list[str]:
    quick = ["--budget-scale", "0.002", "--torch-budget", "0.2", "--peer-budget", "4"]
    throughput = ["--throughput.warm-up-steps", "3", "--throughput.steps", "2", "--throughput.repeats", "1"]
    peers = ["--peer-runners", str(folder / "peers"), "--peers", "nerfacto --bonus-db 2, broken"]
    where = ["--out", str(folder / "out"), "--data", str(sets[0]), "--fox", str(sets[1])]
    return ["evaluate", "engine", *where, *quick, *throughput, *peers]


def read(folder: Path) -> dict:
    return json.loads((folder / "out" / "metrics.json").read_text())


def test_every_training_ends_with_a_score_of_all_views(finished: Path):
    metrics = read(finished)
    budgets = {"lego_100": {"0.01", "0.12"}, "lego_200": {"0.12", "0.36"}, "lego_400": {"0.6"}}
    for scene, expected in (budgets | {"fox_270x480": {"0.03", "0.12"}}).items():
        found = metrics[scene]
        assert set(found["psnr_db_at_s"]) == expected
        for budget, curve in found["psnr_curves"].items():
            assert curve == sorted(curve)
            assert curve[-1][1] == found["psnr_db_at_s"][budget]
            assert curve[-1][0] >= float(budget)
        assert found["psnr_curve"] == list(found["psnr_curves"].values())[-1]
        assert found["views"] == 2
        assert found["render_rays_per_s"] > 0
        assert 0.05 < found["peak_memory_gb"] < 100
        by_view = json.loads((finished / "out" / f"{scene}_views.json").read_text())
        assert {len(views) for curve in by_view.values() for _, views in curve} == {2}


def test_the_score_is_that_of_the_field_on_disk(sets, finished: Path):
    out = finished / "out"
    test = load_captured(read_posed_images(sets[0]).test, 400)
    engine, description = load_field(out / "lego_400_0.6s" / "field.safetensors")
    scored = evaluate_held_out(engine, test, RunFolder(out), keep=0, sub_pixels=description.sub_pixels)
    assert read(finished)["lego_400"]["psnr_db_at_s"]["0.6"] == pytest.approx(scored["psnr_db"], abs=1e-3)


def test_throughput_of_native_and_both_torch_paths_with_sizes(finished: Path):
    metrics = read(finished)
    assert set(metrics["samples_per_s"]) == {"native", "torch_tuned", "torch_naive"}
    assert metrics["samples_per_s"]["torch_tuned"] > 0
    assert metrics["samples_per_s"]["torch_naive"] > 0
    if find_native_library()[0] is None:
        assert metrics["samples_per_s"]["native"] is None
    else:
        assert metrics["samples_per_s"]["native"] > 0
        assert set(metrics["ratios"]) == {"native_over_torch_tuned", "native_over_torch_naive"}
    assert metrics["sizes"]["field"]["levels"] == 8
    assert metrics["sizes"]["rays_a_batch"] > 0


def test_peers_are_compared_on_the_views_they_were_scored_on(finished: Path):
    peers = read(finished)["peers"]
    assert set(peers) == {"torch_tuned", "torch_naive", "nerfacto", "broken"}
    nerfacto = peers["nerfacto"]["fox_270x480"]
    assert nerfacto["psnr_curve"][-1][1] == 6.0
    first_view = json.loads((finished / "out" / "fox_270x480_views.json").read_text())["0.12"][-1]
    assert nerfacto["ours_same_views"]["psnr_curves"]["0.12"][-1] == [first_view[0], first_view[1][0]]
    assert "gave up" in peers["broken"]["lego_100"]["not_run"]
    assert peers["torch_tuned"]["lego_100"]["psnr_curve"][-1][0] >= 0.2


def test_there_is_a_picture_and_a_record_of_the_options(finished: Path):
    assert (finished / "out" / "psnr.png").read_bytes().startswith(b"\x89PNG")
    assert "evaluate engine" in json.loads((finished / "out" / "config.json").read_text())


def test_measuring_one_part_anew_keeps_the_others(sets, finished: Path, capsys):
    before = read(finished)
    assert run_command([*command(sets, finished), "--only", "peers"]) == 0
    after = read(finished)
    assert after["lego_200"] == before["lego_200"]
    assert "no Python" in after["peers"]["nerfacto"]["lego_100"]["not_run"]
    printed = capsys.readouterr().out
    assert "samples/s, native over torch" in printed
    assert "psnr.png" in printed


def test_an_unknown_part_is_one_sentence(sets, tmp_path: Path):
    with pytest.raises(InputError, match="choose from lego_100"):
        run_command([*command(sets, tmp_path), "--only", "lego_800"])
