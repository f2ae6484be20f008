"""The whole fleet as a person runs it: world, robots, base station, learner and page as processes."""

import os
from pathlib import Path
from urllib.request import urlopen

import pytest
from rosbags.rosbag2 import Reader

from mulan.errors import InputError
from mulan.fleet.demo import DemoConfig, FleetDemo
from mulan.mission import messages
from mulan.mission.run_folder import read_json
from mulan.report.page import write_report
from tests.fleet.conftest import free_port

LEARNER = (
    "--learn.train.batch-samples 2048 --learn.bearings.azimuth-count 90 --learn.bearings.elevation-count 31"
    " --learn.seen-views 3 --learn.plan.free-space.places 2 --learn.plan.candidates.directions 4"
)


@pytest.mark.skipif(
    "MULAN_LONG_TESTS" not in os.environ,
    reason="takes minutes of an idle machine; set MULAN_LONG_TESTS to run it",
)
def test_three_simulated_robots_are_reconstructed_while_they_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2] / "src"))
    config = DemoConfig(
        tmp_path,
        minutes=3.0,  # at most: it ends when a robot has gone on a goal
        width=24,
        height=18,
        samples_per_pixel=2,
        held_out=2,
        packets_per_second=50.0,
        speed=4.0,
        round_s=1.0,
        learner=tuple(LEARNER.split()),
        port=free_port(),
    )
    demo, answers = FleetDemo(config), []

    def page_is_open(url: str) -> None:
        with urlopen(url, timeout=20) as answer:
            answers.append(answer.status)

    def a_robot_was_sent_somewhere() -> bool:
        wishes = [read_json(path, "a robot") for path in (tmp_path / "world").glob("[!.]*/wish_*.json")]
        return bool(answers) and any(wish["T_here_body"] is not None for wish in wishes)

    demo.drive(page_is_open, a_robot_was_sent_somewhere)
    assert answers == [200]
    metrics = demo.judge()
    assert metrics["photographs"] >= 9
    assert metrics["camera_rms_m"] < 0.3
    assert metrics["live"]["psnr_db"] > 8
    assert metrics["live_minus_offline_db"] > -0.5
    assert read_json(tmp_path / "metrics.json", "a test")["offline"]["steps"] > 0
    with Reader(demo.bag) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    for name in ("alpha", "beta", "gamma"):
        assert counts[messages.POSE.of(name)] > 0
    assert any(counts.get(messages.GOAL.of(name), 0) for name in ("alpha", "beta", "gamma"))
    assert set(metrics["goals_gone_to"]) == {"alpha", "beta", "gamma"}
    assert "PSNR" in write_report(demo.run).read_text()
    with pytest.raises(InputError, match="holds an earlier demo"):
        FleetDemo(config)
