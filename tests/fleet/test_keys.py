"""Mutual TLS with real sessions: who is not known is not heard, who is known writes its own topics alone."""

import os
import stat
from dataclasses import replace
from pathlib import Path

import pytest

from mulan.errors import InputError
from mulan.fleet.keys import make_keys
from mulan.fleet.refusals import LinkStatus
from mulan.fleet.zenoh_session import LinkConfig, open_robot_session
from tests.fleet.conftest import envelope_of, first_of, key_of, recorded_by
from tests.fleet.test_link import base_station, robot, send_all, within


@pytest.fixture
def secured(tmp_path: Path, free_endpoint: LinkConfig) -> LinkConfig:
    make_keys(tmp_path / "keys", ["zebra", "ant"], ["localhost", "127.0.0.1"], 2)
    return LinkConfig(
        free_endpoint.endpoint.replace("tcp/127.0.0.1", "tls/localhost"), keys=tmp_path / "keys"
    )


def test_a_robot_with_its_own_keys_is_heard_and_writes_its_own_topics_alone(
    tmp_path: Path, secured: LinkConfig
) -> None:
    recorded = recorded_by("ant", ["zebra"])
    theirs = first_of(recorded_by("zebra", ["ant"]), "odom")
    with base_station(tmp_path, secured) as base:
        with robot(tmp_path, secured) as link:
            send_all(link, recorded)
            assert link.drained(30)
        impostor = open_robot_session(secured, "ant")  # a robot's own key, another robot's topic
        for number in range(1, 40):
            impostor.put(
                key_of("odom", "zebra"),
                theirs.payload,
                attachment=envelope_of(theirs, number, sender="zebra"),
            )
        with robot(tmp_path, secured) as link:
            assert within(10, lambda: link.status is LinkStatus.OPEN)
        impostor.close()
        assert "zebra" not in base.ingest.robots
        assert base.ingest.robots["ant"].counts["ACCEPTED"] == len(recorded)


def test_a_stranger_is_not_heard(tmp_path: Path, secured: LinkConfig, free_endpoint: LinkConfig) -> None:
    make_keys(tmp_path / "strangers", ["ant"], ["localhost"], 2)  # the same name from another authority
    with base_station(tmp_path, secured) as base:
        with robot(tmp_path, replace(secured, keys=tmp_path / "strangers")) as link:
            assert not within(2.5, lambda: link.status is not None)
        with robot(tmp_path, free_endpoint) as link:  # no keys at all
            assert not within(2.5, lambda: link.status is not None)
        assert not base.ingest.robots


def test_keys_are_private_and_robots_can_be_added(tmp_path: Path) -> None:
    make_keys(tmp_path, ["ant"], ["localhost"], 2)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    make_keys(tmp_path, ["ant", "bee"], ["localhost"], 2)
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    assert (tmp_path / "bee.pem").exists()
    for path in tmp_path.glob("*.key"):
        assert stat.S_IMODE(os.stat(path).st_mode) == 0o600


def test_missing_keys_and_plain_endpoints_are_named(tmp_path: Path, secured: LinkConfig) -> None:
    with pytest.raises(InputError, match="mulan fleet keys"):
        open_robot_session(secured, "mole")
    with pytest.raises(InputError, match="tls/"):
        open_robot_session(replace(secured, endpoint="tcp/localhost:7447"), "ant")
