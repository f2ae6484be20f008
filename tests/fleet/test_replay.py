from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.fleet.image_budget import ImageBudget, ImageConfig
from mulan.fleet.odometry_thinning import OdometryConfig, OdometryThinning
from mulan.fleet.replay import ReplayClock
from mulan.fleet.send_window import SendWindow, WindowConfig
from mulan.fleet.spool import Spool
from mulan.fleet.view_novelty import NoveltyConfig, ViewNovelty
from mulan.fleet.wire_topics import Importance
from mulan.geometry import se3
from mulan.mission import pixels

TICK_NS = 20_000_000


def test_odometry_keeps_keyframes_photograph_neighbours_and_apertures() -> None:
    thinning: OdometryThinning[int] = OdometryThinning(OdometryConfig(keyframe_s=1.0))
    sent: dict[int, Importance] = {}
    for tick in range(400):
        for _, number, importance in thinning.odometry(tick * TICK_NS, tick):
            sent[number] = importance
        found = thinning.photograph() if tick == 75 else []
        found += thinning.packet(tick * TICK_NS + 5) if 200 <= tick <= 300 else []
        for _, number, importance in found:
            sent[number] = importance
    coordination = [n for n, importance in sent.items() if importance is Importance.COORDINATION]
    assert {0, 50, 100, 150} <= set(coordination)
    assert {75, 76} <= set(coordination)  # around the photograph taken at tick 75
    assert len(coordination) <= 12
    assert set(range(181, 320)) <= set(sent)  # 0.4 s before the first packet to 0.4 s after the last
    assert {n for n, i in sent.items() if i is Importance.RADIO} >= set(range(201, 320))


def test_all_odometry_is_sent_when_asked() -> None:
    thinning: OdometryThinning[int] = OdometryThinning(OdometryConfig(keyframe_s=0))
    assert all(len(thinning.odometry(tick * TICK_NS, tick)) == 1 for tick in range(50))


def photograph(seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    return pixels.encode_jpeg(rng.integers(0, 256, (60, 80, 3), dtype=np.uint8), 95)


def test_photographs_keep_to_their_rate() -> None:
    budget, sent = ImageBudget(ImageConfig(kilobytes_per_s=4, burst_s=3)), 0
    for i in range(60):
        T = np.eye(4)
        T[0, 3] = i * 0.3
        sent += len(budget.fit(photograph(i), float(i), T) or b"")
    assert 0.5 * 4e3 * 60 < sent <= 4e3 * (60 + 3)
    assert budget.recompressed > 0
    assert budget.sent + budget.left_out == 60


def test_without_a_budget_every_photograph_goes_as_it_was() -> None:
    budget = ImageBudget(ImageConfig())
    assert budget.fit(photograph(0), 0.0, np.eye(4)) == photograph(0)


def test_with_a_budget_a_robot_that_stands_sends_one_photograph() -> None:
    budget = ImageBudget(ImageConfig(kilobytes_per_s=1000))
    poses = [np.eye(4)] * 5 + [se3.exp(np.array([0, 0, 0.2, 0, 0, 0]))]
    sent = [budget.fit(photograph(i), float(i), T) is not None for i, T in enumerate(poses)]
    assert sent == [True, False, False, False, False, True]


def at(x_m: float, yaw_rad: float = 0.0) -> np.ndarray:
    return se3.exp(np.array([0, 0, yaw_rad, x_m, 0, 0]))


def test_a_photograph_tells_less_beside_others_like_it() -> None:
    novelty = ViewNovelty(NoveltyConfig())
    assert novelty.gain_nats(at(0)) == novelty.most_nats
    novelty.add(at(0))
    gains = [novelty.gain_nats(at(x)) for x in (0.0, 0.1, 0.3, 1.0)]
    assert gains == sorted(gains)
    assert gains[0] < 0.35 * novelty.most_nats
    assert gains[-1] == pytest.approx(novelty.most_nats, rel=0.01)
    assert novelty.gain_nats(at(0, 0.5)) > 0.9 * novelty.most_nats
    # between two known views less is new than beside one
    beside = novelty.gain_nats(at(0.2))
    novelty.add(at(0.4))
    assert novelty.gain_nats(at(0.2)) < beside


def test_a_scarce_budget_goes_to_photographs_that_tell_more() -> None:
    """A robot creeps for a minute, then tours; the budget holds a third of what it takes."""
    rate = 0.3 * len(photograph(0)) / 1e3
    budget = ImageBudget(ImageConfig(kilobytes_per_s=rate, burst_s=30, qualities=()))
    ways_m = [*(0.06 * np.arange(60)), *(4 + 0.5 * np.arange(15))]
    sent = [budget.fit(photograph(i), float(i), at(x)) is not None for i, x in enumerate(ways_m)]
    creeping, touring = sum(sent[:60]), sum(sent[60:])
    assert creeping >= 8
    assert touring / 15 > 1.5 * creeping / 60


def test_important_messages_overtake_images(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 10**9)
    for _ in range(5):
        spool.add(Importance.IMAGE, "camera/image/compressed", 0, bytes(1000))
        spool.add(Importance.COORDINATION, "odom", 0, bytes(10))
    window = SendWindow(WindowConfig(), spool)
    assert [m.suffix for m, _ in window.due(0.0)] == ["odom"] * 5 + ["camera/image/compressed"] * 5
    spool.close()


def test_unanswered_messages_wait_longer_each_time(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 10**9)
    spool.add(Importance.COORDINATION, "odom", 0, b"x")
    window = SendWindow(WindowConfig(first_wait_s=0.5, longest_wait_s=8), spool)
    sent_s = [step * 0.01 for step in range(6000) if window.due(step * 0.01)]
    gaps = np.diff(sent_s)
    assert (gaps[1:4] > 1.5 * gaps[:3]).all()
    assert gaps.max() < 9
    window.settle(1, [], [])
    assert len(window) == 0
    spool.close()


def test_while_answers_come_what_was_lost_is_soon_sent_again(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 10**9)
    spool.add(Importance.COORDINATION, "odom", 0, b"x")
    window, sent_s = SendWindow(WindowConfig(), spool), []
    for step in range(2000):
        if step % 600 == 0:
            window.heard(step * 0.05)  # one answer in 30 s
        sent_s += [step * 0.05] * len(window.due(step * 0.05))
    assert np.diff(sent_s).max() < 2.3
    # a link on which most messages took many attempts is tried again at the pace of its round trips
    for _ in range(100):
        sequence = spool.add(Importance.COORDINATION, "odom", 0, b"x")
        for step in range(8):
            window.due(100.0 + 1000 * sequence + 30 * step)
        window.settle(sequence, [], [])
    begin_s = 1e6
    spool.add(Importance.COORDINATION, "odom", 0, b"x")
    window.heard(begin_s)
    sent_s = [begin_s + 0.05 * i for i in range(100) if window.due(begin_s + 0.05 * i)]
    assert np.diff(sent_s)[:6].max() < 1.1
    spool.close()


def test_radio_that_waits_for_answers_does_not_keep_odometry_out(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 10**9)
    for _ in range(500):
        spool.add(Importance.RADIO, "csi", 0, b"x")
    window = SendWindow(WindowConfig(), spool)
    window.due(0.0)
    spool.add(Importance.COORDINATION, "odom", 0, b"x")
    assert [m.suffix for m, _ in window.due(0.1)] == ["odom"]
    spool.close()


def test_a_slow_base_station_is_not_flooded(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 10**9)
    for _ in range(3000):
        spool.add(Importance.RADIO, "csi", 0, b"x")
    window, now_s = SendWindow(WindowConfig(), spool), 0.0
    window.round_trip(0.05)
    for _ in range(60):  # prompt answers open the window
        taken = window.due(now_s)
        window.round_trip(0.05)
        window.settle(max((m.sequence for m, _ in taken), default=0), [], [])
        now_s += 0.1
    assert window.allowed > 500
    before = window.allowed
    window.round_trip(3.0)
    assert window.allowed < 0.7 * before
    spool.close()


def test_a_robot_that_is_not_in_the_bag_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        ReplayClock(tmp_path / "no.mcap", "ant", 1.0, tmp_path / "s", 10)
