import os
from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.fleet.growing_bag import GrowingBag
from mulan.fleet.journal import Journal
from mulan.mission import messages
from mulan.mission.bag_reader import read_mission
from mulan.mission.types import Mission
from tests.fleet.growing import append_until, entries_of
from tests.mission.conftest import make_robot


@pytest.fixture
def mission() -> Mission:
    rng = np.random.default_rng(5)
    return Mission((make_robot("zebra", ["ant"], rng), make_robot("ant", ["zebra"], rng)))


def test_what_was_read_bit_by_bit_is_what_the_finished_bag_holds(tmp_path: Path, mission: Mission) -> None:
    path = tmp_path / "m.mcap"
    journal, bag = Journal(path), GrowingBag(path)
    entries = entries_of(mission, tmp_path)
    counts = []
    for share in (0.3, 0.31, 0.7, 1.0):
        before = len(entries)
        entries = append_until(journal, entries, share)
        counts.append(bag.read() == before - len(entries))
        assert not bag.finished
    journal.close()
    assert all(counts)
    assert bag.finished
    assert bag.read() == 0
    grown, whole = bag.mission(), read_mission(path)
    assert grown is not None
    assert [log.name for log in grown.robots] == ["zebra", "ant"]
    for got, expected in zip(grown.robots, whole.robots, strict=True):
        assert np.array_equal(got.odometry.T_odom_body, expected.odometry.T_odom_body)
        end_s = expected.odometry.time_s[-1]
        assert [p.data for p in got.photos] == [p.data for p in expected.photos if p.time_s <= end_s]
        for peer, track in expected.csi.items():
            assert np.array_equal(got.csi[peer].channel, track.channel)
            assert np.array_equal(got.csi[peer].frame_counter, track.frame_counter)


def test_a_reader_goes_on_when_the_base_station_was_killed_amid_a_message(
    tmp_path: Path, mission: Mission
) -> None:
    path = tmp_path / "m.mcap"
    journal, bag = Journal(path), GrowingBag(path)
    rest = append_until(journal, entries_of(mission, tmp_path), 0.4)
    bag.read()
    end = path.stat().st_size
    journal.append(rest[:1])
    journal.abandon()
    os.truncate(path, end + 20)
    assert bag.read() == 0
    journal = Journal(path)
    journal.append(rest)
    journal.close()
    assert bag.read() == len(rest)
    grown = bag.mission()
    assert grown is not None
    assert len(grown.robot("ant").odometry.time_s) == len(mission.robot("ant").odometry.time_s)


def test_nothing_is_used_before_its_odometry_and_its_calibration_have_come(
    tmp_path: Path, mission: Mission
) -> None:
    path = tmp_path / "m.mcap"
    entries = entries_of(mission, tmp_path)
    late = [entry for entry in entries if entry.topic == messages.CAMERA_INFO.of("ant")]
    early = [entry for entry in entries if entry not in late]
    journal, bag = Journal(path), GrowingBag(path)
    journal.append(early)
    bag.read()
    alone = bag.mission()
    assert alone is not None
    assert [log.name for log in alone.robots] == ["zebra"]
    assert not alone.robots[0].csi
    journal.append(late)
    bag.read()
    margin_s = 0.65
    both = bag.mission(margin_s)
    assert both is not None
    assert [log.name for log in both.robots] == ["zebra", "ant"]
    for log in both.robots:
        assert log.photos
        assert len(log.photos) < len(mission.robot(log.name).photos)
        assert log.photo_time_s.max() <= log.odometry.time_s[-1] - margin_s
    journal.close()


def test_there_is_no_mission_without_its_anchor(tmp_path: Path, mission: Mission) -> None:
    path = tmp_path / "m.mcap"
    bag = GrowingBag(path)
    assert bag.read() == 0
    assert bag.mission() is None
    assert not bag.finished
    journal = Journal(path)
    journal.append([e for e in entries_of(mission, tmp_path) if not e.topic.startswith("/zebra/")])
    bag.read()
    assert bag.mission() is None
    journal.close()


def test_another_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.mcap"
    path.write_bytes(b"not a bag at all")
    with pytest.raises(InputError, match="is not an MCAP file"):
        GrowingBag(path).read()
