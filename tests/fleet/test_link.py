"""Base station and robots in one process, over real Zenoh sessions on loopback."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mulan.errors import InputError
from mulan.fleet.base_station import BaseConfig, BaseStation
from mulan.fleet.envelope import PROTOCOL_VERSION
from mulan.fleet.ingest import IngestConfig
from mulan.fleet.journal import Journal, sender_of
from mulan.fleet.journal_scan import RecordedMessage
from mulan.fleet.lossy_link import LossConfig, LossyLink
from mulan.fleet.refusals import LinkStatus
from mulan.fleet.robot_link import RobotConfig, RobotLink
from mulan.fleet.zenoh_session import LinkConfig, open_robot_session
from mulan.mission.bag_reader import read_mission
from tests.fleet.conftest import EPOCH_NS, Recorded, envelope_of, key_of, recorded_by

BAD_LINK = LossConfig(loss=0.3, duplicate=0.1, delay_s=0.005, jitter_s=0.1, seed=4)
ROBOTS = ("zebra", "ant")
BEHIND_NS = EPOCH_NS + 60 * 10**9 - time.time_ns()  # the small log was recorded long ago


@contextmanager
def base_station(folder: Path, link: LinkConfig, lease_s: float = 5.0) -> Iterator[BaseStation]:
    ingest = IngestConfig(robots=ROBOTS, lease_s=lease_s)
    base = BaseStation(BaseConfig(folder / "m.mcap", "m", link=link, ingest=ingest))
    try:
        yield base
    finally:
        base.close()


@contextmanager
def robot(
    folder: Path,
    link: LinkConfig,
    name: str = "ant",
    loss: LossConfig | None = None,
    spool: str = "",
    clock_every_s: float = 1e9,
    offset_ns: int = 0,
    version: int = PROTOCOL_VERSION,
) -> Iterator[RobotLink]:
    config = RobotConfig(
        name,
        folder / f"{spool or name}.spool",
        "m",
        link=link,
        loss=loss or LossConfig(),
        clock_every_s=clock_every_s,
    )
    opened = RobotLink(config, lambda: time.time_ns() + BEHIND_NS + offset_ns, version=version)
    try:
        yield opened
    finally:
        opened.close()


def send_all(link: RobotLink, recorded: list[Recorded]) -> None:
    for message in recorded:
        link.send_encoded(message.suffix, message.record_ns, message.payload)


def within(seconds: float, done: Callable[[], bool]) -> bool:
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        if done():
            return True
        time.sleep(0.01)
    return done()


def in_bag(path: Path) -> list[RecordedMessage]:
    found: list[RecordedMessage] = []
    Journal(path, replay=found.append).close()
    return found


def test_a_bad_link_delivers_everything_once(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    sent = {name: recorded_by(name, [peer]) for name, peer in (("ant", "zebra"), ("zebra", "ant"))}
    with base_station(tmp_path, free_endpoint) as base:
        with (
            robot(tmp_path, free_endpoint, "ant", BAD_LINK) as ant,
            robot(tmp_path, free_endpoint, "zebra", BAD_LINK) as zebra,
        ):
            send_all(ant, sent["ant"])
            send_all(zebra, sent["zebra"])
            assert ant.drained(30)
            assert zebra.drained(30)
            assert ant.counts.resent > 0
        assert base.ingest.robots["ant"].counts["DUPLICATE"] > 0
    mission = read_mission(tmp_path / "m.mcap")
    assert [log.name for log in mission.robots] == list(ROBOTS)  # in the order the base station was given
    for name in ROBOTS:
        mine = [m for m in in_bag(tmp_path / "m.mcap") if sender_of(m)[0] == name]
        payloads = Counter(m.payload for m in mine if not m.channel.topic.endswith("/clock"))
        assert payloads == Counter(m.payload for m in sent[name])


def test_a_link_that_loses_nearly_everything_delivers_all(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    recorded = recorded_by("ant", ["zebra"])
    hopeless = LossConfig(loss=0.85, delay_s=0.002, jitter_s=0.01, seed=5)
    with (
        base_station(tmp_path, free_endpoint) as base,
        robot(tmp_path, free_endpoint, loss=hopeless) as link,
    ):
        send_all(link, recorded)
        assert within(60, lambda: base.journal.messages == len(recorded) + 1)  # and the robots' names
    payloads = Counter(m.payload for m in in_bag(tmp_path / "m.mcap") if sender_of(m)[0])
    assert payloads == Counter(m.payload for m in recorded)


def test_what_was_recorded_without_a_base_station_arrives_later(
    tmp_path: Path, free_endpoint: LinkConfig
) -> None:
    recorded = recorded_by("ant", ["zebra"])
    with robot(tmp_path, free_endpoint) as link:
        send_all(link, recorded[:20])
    with robot(tmp_path, free_endpoint) as link:
        send_all(link, recorded[20:])
        with base_station(tmp_path, free_endpoint):
            assert link.drained(20)
        assert link.counts.stored == len(recorded)
    found = in_bag(tmp_path / "m.mcap")
    assert sorted(m.payload for m in found if sender_of(m)[0]) == sorted(m.payload for m in recorded)


def test_a_base_station_that_comes_back_goes_on(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    recorded = recorded_by("ant", ["zebra"])
    with robot(tmp_path, free_endpoint) as link:
        with base_station(tmp_path, free_endpoint):
            send_all(link, recorded[:25])
            assert link.drained(20)
        send_all(link, recorded[25:])
        with base_station(tmp_path, free_endpoint):
            assert link.drained(20)
        assert link.counts.bases == 2
    assert len([m for m in in_bag(tmp_path / "m.mcap") if sender_of(m)[0]]) == len(recorded)


def test_the_second_robot_of_a_name_is_refused_and_told(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    recorded = recorded_by("ant", ["zebra"])
    with base_station(tmp_path, free_endpoint) as base:
        with robot(tmp_path, free_endpoint) as first:
            assert within(10, lambda: first.status is LinkStatus.OPEN)
            with robot(tmp_path, free_endpoint, spool="other") as second:
                assert within(10, lambda: second.status is LinkStatus.NAME_TAKEN)
                send_all(second, recorded)
                send_all(first, recorded)
                assert first.drained(20)
                assert len(second.spool) == len(recorded)
                assert first.status is LinkStatus.OPEN
        assert base.ingest.robots["ant"].counts["ACCEPTED"] == len(recorded)
        # the first has said goodbye, so the name is free
        with robot(tmp_path, free_endpoint, spool="other") as second:
            assert second.drained(20)


def test_a_robot_of_another_version_is_told(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    with base_station(tmp_path, free_endpoint), robot(tmp_path, free_endpoint, version=2) as link:
        assert within(10, lambda: link.status is LinkStatus.WRONG_VERSION)


def test_an_unknown_robot_is_told(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    with base_station(tmp_path, free_endpoint) as base:
        with robot(tmp_path, free_endpoint, "mole") as link:
            assert within(10, lambda: link.status is LinkStatus.UNKNOWN_ROBOT)
        assert base.ingest.intrusions["UNKNOWN_ROBOT"] > 0
        assert "mole" not in base.ingest.robots


@pytest.mark.parametrize("offset_s", [-40.0, 3.25])
def test_clock_offset_is_found_within_its_bound(
    tmp_path: Path, free_endpoint: LinkConfig, offset_s: float
) -> None:
    bad = LossConfig(delay_s=0.01, jitter_s=0.05, seed=1)
    with (
        base_station(tmp_path, free_endpoint) as base,
        robot(tmp_path, free_endpoint, loss=bad, clock_every_s=0.3, offset_ns=int(offset_s * 1e9)) as link,
    ):
        send_all(link, recorded_by("ant", ["zebra"]))
        assert within(15, lambda: base.clocks.get("ant") is not None)
        estimate = link.clock.estimate
        assert estimate is not None
        true_ns = -BEHIND_NS - int(offset_s * 1e9)
        assert abs(estimate.offset_ns - true_ns) <= estimate.bound_ns
        assert estimate.bound_ns < 0.5e9
        assert abs(base.clocks["ant"].offset_ns - estimate.offset_ns) < 0.5e9
    assert any(m.channel.topic == "/ant/clock" for m in in_bag(tmp_path / "m.mcap"))


def test_garbage_on_the_network_changes_nothing(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    recorded = recorded_by("ant", ["zebra"])
    with base_station(tmp_path, free_endpoint) as base:
        intruder = open_robot_session(free_endpoint, "ant")
        with robot(tmp_path, free_endpoint) as link:
            assert within(10, lambda: link.status is LinkStatus.OPEN)
            for i in range(300):
                intruder.put("mulan/m/ant/odom", bytes(i))
                intruder.put("mulan/m/**", bytes(i), attachment=bytes(88))
                intruder.put(key_of("odom"), b"x" * i, attachment=envelope_of(recorded[2], i, sender="bee"))
                intruder.delete("mulan/m/ant/odom")
            intruder.put("mulan/m/ant/odom", bytes(8_000_000), attachment=envelope_of(recorded[2], 1))
            send_all(link, recorded)
            assert link.drained(20)
            assert within(10, lambda: base.ingest.intrusions["WRONG_SENDER"] == 300)
        intruder.close()
    assert len([m for m in in_bag(tmp_path / "m.mcap") if sender_of(m)[0]]) == len(recorded)


def test_loss_comes_by_seed() -> None:
    def through(seed: int) -> list[int]:
        got: list[int] = []
        link = LossyLink(LossConfig(loss=0.3, duplicate=0.2, jitter_s=0.01, seed=seed), got.append, 0)
        for i in range(200):
            link.send(i)
        assert within(5, lambda: len(got) == 200 - link.lost + link.duplicated)
        link.close()
        return got

    first, again, other = through(1), through(1), through(2)
    assert sorted(first) == sorted(again) != sorted(other)
    assert first != sorted(first)  # later messages overtook earlier ones


def test_endpoints_that_cannot_be_used_are_named(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    with (
        base_station(tmp_path, free_endpoint),
        pytest.raises(InputError, match="choose a free port"),
        base_station(tmp_path / "other", free_endpoint),
    ):
        pass
    with pytest.raises(InputError, match="endpoint"):
        open_robot_session(LinkConfig("nonsense"), "ant")


def test_the_peer_mode_works_too(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    with (
        base_station(tmp_path, LinkConfig(free_endpoint.endpoint, mode="peer")),
        robot(tmp_path, free_endpoint) as link,
    ):
        send_all(link, recorded_by("ant", ["zebra"]))
        assert link.drained(20)
