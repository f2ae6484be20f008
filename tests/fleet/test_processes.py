"""The commands as a person runs them: separate processes on loopback, some of them killed."""

import resource
import time
from pathlib import Path

import numpy as np
import pytest

from mulan.cli.fleet import PARTS
from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.fleet.journal import Journal, sender_of
from mulan.fleet.journal_scan import RecordedMessage
from mulan.fleet.lossy_link import LossConfig
from mulan.fleet.soak_processes import base_member, robot_member, start_all
from mulan.fleet.spool import Spool
from mulan.mission.bag_reader import read_mission
from mulan.mission.bag_writer import write_mission
from mulan.mission.types import Mission
from tests.fleet.conftest import free_port
from tests.mission.conftest import make_robot

ROBOTS = ("zebra", "ant")


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(2)
    path = tmp_path_factory.mktemp("bag") / "mission.mcap"
    robots = (make_robot("zebra", ["ant"], rng), make_robot("ant", ["zebra"], rng))
    write_mission(Mission(robots), path)
    return path


@pytest.fixture(autouse=True)
def sources_on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2] / "src"))


def numbers_of(path: Path, robot: str) -> list[int]:
    found: list[RecordedMessage] = []
    Journal(path, replay=found.append).close()
    return [message.sequence for message in found if sender_of(message)[0] == robot]


def wait_for(done, seconds: float = 90.0) -> None:
    until_s = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < until_s, "it took too long"
        time.sleep(0.05)


def test_nothing_acknowledged_is_lost_when_base_and_robot_are_killed(tmp_path: Path, bag: Path) -> None:
    """The base station dies while it writes, later a robot, and the disk is full for a while."""
    received, endpoint = tmp_path / "m.mcap", f"tcp/127.0.0.1:{free_port()}"
    loss = LossConfig(loss=0.2, duplicate=0.05, delay_s=0.001, jitter_s=0.1, seed=3)
    base = base_member(tmp_path, received, endpoint, ROBOTS)
    # the bag's 1.1 s take eight: long enough for both to be caught at work
    robots = [robot_member(tmp_path, name, bag, 0.14, endpoint, loss) for name in ROBOTS]
    members = [base, *robots]
    try:
        start_all(members, 60)
        wait_for(lambda: received.stat().st_size > 6000)
        base.kill()
        robots[1].kill()
        base.start()
        wait_for(lambda: base.ready)
        # a disk that is full, as the kernel tells it: the file may not grow
        limit = (received.stat().st_size + 10, resource.RLIM_INFINITY)
        resource.prlimit(base.processes[-1].pid, resource.RLIMIT_FSIZE, limit)
        robots[1].start()
        wait_for(lambda: "nothing more is acknowledged" in base.said())
        limit = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
        resource.prlimit(base.processes[-1].pid, resource.RLIMIT_FSIZE, limit)
        wait_for(lambda: not any(robot.running for robot in robots))
        base.stop(20)
    finally:
        for member in members:
            if member.running:
                member.kill()
    assert "there is room again" in (tmp_path / "base-1.log").read_text()
    assert [robot.processes[-1].returncode for robot in robots] == [0, 0], robots[1].said()
    mission = read_mission(received)
    assert [log.name for log in mission.robots] == list(ROBOTS)
    for name in ROBOTS:
        spool = Spool(tmp_path / f"{name}.spool", 10**9)
        assert sorted(numbers_of(received, name)) == list(range(1, spool.last_sequence + 1))
        spool.close()
        original, arrived = read_mission(bag).robot(name), mission.robot(name)
        assert [p.data for p in arrived.photos] == [p.data for p in original.photos]
        for peer, track in original.csi.items():
            assert (arrived.csi[peer].channel == track.channel).all()


def test_a_second_robot_of_a_name_ends_with_a_sentence(tmp_path: Path, bag: Path) -> None:
    received, endpoint = tmp_path / "m.mcap", f"tcp/127.0.0.1:{free_port()}"
    base = base_member(tmp_path, received, endpoint, ROBOTS)
    first = robot_member(tmp_path, "ant", bag, 0.02, endpoint, LossConfig())
    (tmp_path / "other").mkdir()
    second = robot_member(tmp_path / "other", "ant", bag, 0.02, endpoint, LossConfig())
    second.arguments += ["--patience-s", "1"]
    members = [base, first]
    try:
        start_all(members, 60)
        members.append(second)
        second.start()
        wait_for(lambda: not second.running)
        assert second.processes[0].returncode == 2
        assert "another robot sends under this name" in " ".join(second.said().split())
        assert first.running
    finally:
        for member in members:
            if member.running:
                member.kill()
    assert (tmp_path / "base-0.log").read_text().count("ant: another robot sends under this name") == 1


def test_commands_explain_themselves(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["fleet"]) == 0
    assert "mulan fleet base" in capsys.readouterr().out
    for part in PARTS:
        with pytest.raises(SystemExit) as end:
            run_command(["fleet", part, "--help"])
        assert end.value.code == 0
        assert f"mulan fleet {part}" in capsys.readouterr().out
    with pytest.raises(InputError, match="does not exist"):
        run_command(["fleet", "finish", "no.mcap"])
    with pytest.raises(InputError, match="unknown"):
        run_command(["fleet", "dance"])
