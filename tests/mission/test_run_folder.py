import json

import pytest

from mulan.errors import InputError
from mulan.mission.run_folder import RunFolder, read_json, write_atomically, write_json


def test_a_write_that_fails_keeps_the_old_file_and_leaves_nothing_beside_it(tmp_path):
    path = tmp_path / "metrics.json"
    write_json(path, {"psnr_db": 30})

    def disk_full(temporary):
        temporary.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match="No space left on device"):
        write_atomically(path, disk_full)
    assert read_json(path, "mulan evaluate") == {"psnr_db": 30}
    assert list(tmp_path.iterdir()) == [path]


def test_each_command_adds_its_options_to_the_record(tmp_path):
    run = RunFolder(tmp_path / "run")
    run.record_config("train", {"steps": 5})
    run.record_config("plan", {"robots": 2, "radio_range_m": float("inf")})
    run.record_config("train", {"steps": 6})
    planned = {"robots": 2, "radio_range_m": "Infinity"}
    assert json.loads(run.config.read_text()) == {"train": {"steps": 6}, "plan": planned}


def test_missing_and_damaged_files_name_the_command_that_makes_them(tmp_path):
    run = RunFolder(tmp_path)
    with pytest.raises(InputError, match="mulan plan"):
        read_json(run.plan, "mulan plan")
    run.config.write_text("{")
    with pytest.raises(InputError, match=r"config\.json"):
        run.record_config("train", {})
