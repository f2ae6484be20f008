"""What a soak test says of its bag."""

from pathlib import Path

import numpy as np
import pytest

from mulan.fleet.journal import Entry, Journal
from mulan.fleet.journal_scan import RecordedMessage
from mulan.fleet.soak_arrivals import ReplayedTime, arrivals
from mulan.fleet.soak_localization import as_it_arrived
from mulan.fleet.soak_mission import SoakMissionConfig, simulate_soak_mission
from mulan.mission import messages
from mulan.mission.bag_reader import read_mission, robots_of
from mulan.mission.types import Mission
from mulan.wireless.bearing import BearingConfig
from tests.fleet.growing import entries_of

STARTED_NS = 1_800_000_000 * 10**9
BAG_NS = 1_000_000_000 * 10**9


def test_lag_counts_from_when_a_message_was_recorded(tmp_path: Path) -> None:
    """A replay at half speed: what the bag has at 2 s was recorded 4 s after the start."""
    path = tmp_path / "m.mcap"
    journal = Journal(path)
    for number, (bag_s, arrived_s) in enumerate(((0.0, 0.5), (2.0, 4.25), (3.0, 36.0)), 1):
        record_ns, received_ns = BAG_NS + int(bag_s * 1e9), STARTED_NS + int(arrived_s * 1e9)
        topic = messages.ODOMETRY
        journal.append([Entry(topic.of("ant"), topic.msgtype, "ant", 7, number, record_ns, received_ns, b"")])
    journal.append([Entry("/robots", messages.ROBOTS_TYPE, "", 0, 0, 0, STARTED_NS, b"")])
    journal.close()
    in_bag: list[RecordedMessage] = []
    Journal(path, replay=in_bag.append).close()
    found = arrivals(in_bag, {"ant": ReplayedTime(STARTED_NS, BAG_NS, 0.5)})
    assert found.lag_s == pytest.approx([0.5, 0.25, 30.0], abs=1e-6)
    figures = found.figures()
    assert figures["lag_s"] == {"coordination": pytest.approx({"median": 0.5, "p95": 27.05, "largest": 30.0})}
    assert figures["messages_per_s"]["busiest_second"] == 1


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("soak") / "mission.mcap"
    config = SoakMissionConfig(
        robots=2,
        packets_per_second=60.0,
        round_every_s=20.0,
        photograph_every_s=8.0,
        width=24,
        height=18,
        samples_per_pixel=1,
    )
    simulate_soak_mission(config, 40.0, 3, path)
    return path


def test_the_mission_lasts_as_long_as_the_test(bag: Path) -> None:
    mission = read_mission(bag)
    assert robots_of(bag) == [robot.name for robot in mission.robots]
    for robot in mission.robots:
        time_s = robot.odometry.time_s
        assert time_s[-1] - time_s[0] == pytest.approx(40.0, rel=0.1)
        assert len(robot.photos) == 8


def test_what_had_come_by_an_instant_is_localized(bag: Path, tmp_path: Path) -> None:
    mission = read_mission(bag)
    received = Journal(tmp_path / "received.mcap")
    received.append(entries_of(Mission(mission.robots), tmp_path))
    received.close()
    coarse = BearingConfig(azimuth_count=90, elevation_count=31)
    told = as_it_arrived(tmp_path / "received.mcap", 2, tmp_path, coarse)
    assert [round(record["minutes"] * 60) for record in told] == pytest.approx([20, 40], abs=3)
    assert told[0]["messages"] < told[1]["messages"]
    assert told[-1]["placed"] == 2
    assert max(told[-1]["position_rms_m"].values()) < 0.3
    assert np.isfinite(list(told[-1]["yaw_rms_deg"].values())).all()
    assert not (tmp_path / "beginning.mcap").exists()
