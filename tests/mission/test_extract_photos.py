import pytest

from mulan.errors import InputError
from mulan.mission.extract import extract_photos
from mulan.mission.run_folder import RunFolder
from mulan.mission.types import Mission


def test_photographs_are_written_byte_for_byte_and_numbered_in_order(mission, tmp_path):
    run = RunFolder(tmp_path / "run")
    files = extract_photos(mission, run)
    assert list(files) == ["zebra", "ant", "bee", "held_out"]
    for log in mission.robots:
        assert files[log.name] == [run.images / log.name / f"{i:06d}.jpg" for i in range(3)]
        assert [path.read_bytes() for path in files[log.name]] == [photo.data for photo in log.photos]
    assert [path.name for path in files["held_out"]] == ["000000.png", "000001.png"]
    assert mission.held_out is not None
    assert files["held_out"][0].read_bytes() == mission.held_out.photos[0].data


def test_without_test_views_there_is_no_folder_for_them(mission, tmp_path):
    files = extract_photos(Mission(mission.robots[:1]), RunFolder(tmp_path))
    assert list(files) == ["zebra"]
    assert not (tmp_path / "images" / "held_out").exists()


def test_a_folder_that_cannot_be_written_is_named(mission, tmp_path):
    (tmp_path / "images").write_text("a file where the folder should be")
    with pytest.raises(InputError, match="writing"):
        extract_photos(mission, RunFolder(tmp_path))
