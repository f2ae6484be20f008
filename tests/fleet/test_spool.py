from pathlib import Path

import pytest

from mulan.errors import InputError
from mulan.fleet.refusals import Refusal
from mulan.fleet.spool import Spool
from mulan.fleet.wire_topics import Importance

COORDINATION, IMAGE = Importance.COORDINATION, Importance.IMAGE


def test_what_waits_outlives_the_process(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 10_000)
    for i in range(5):
        spool.add(COORDINATION, "odom", 100 + i, bytes([i]), position=i + 1)
    incarnation = spool.incarnation
    assert spool.settle(2, [(4, 4)], [(5, Refusal.MALFORMED)]) == (3, [(5, Refusal.MALFORMED)])
    spool.close()
    again = Spool(tmp_path / "s", 10_000)
    assert (again.incarnation, again.position, again.settled_below) == (incarnation, 5, 3)
    assert [(m.sequence, m.record_ns, m.payload) for m in again.next_of(COORDINATION, 0, 9)] == [
        (3, 102, b"\2")
    ]
    assert again.add(COORDINATION, "odom", 0, b"") == 6  # a number is never used twice
    again.close()


def test_a_full_spool_gives_up_images_before_odometry(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 1000)
    for _ in range(4):
        spool.add(IMAGE, "camera/image/compressed", 0, bytes(200))
    for _ in range(9):
        spool.add(COORDINATION, "odom", 0, bytes(100))
    assert spool.waiting_bytes <= 1000
    assert spool.dropped == {IMAGE: 4}
    assert [m.sequence for m in spool.next_of(COORDINATION, 0, 99)] == list(range(5, 14))
    spool.add(COORDINATION, "odom", 0, bytes(200))
    assert spool.dropped[COORDINATION] == 1
    assert spool.settled_below == 6  # the base station must not wait for what was given up
    spool.close()


def test_a_refusal_is_told_once(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 1000)
    spool.add(COORDINATION, "odom", 0, b"x")
    assert spool.settle(1, [], [(1, Refusal.MISTIMED)]) == (0, [(1, Refusal.MISTIMED)])
    assert spool.settle(1, [], [(1, Refusal.MISTIMED)]) == (0, [])
    spool.close()


def test_one_spool_serves_one_process(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "s", 1000)
    with pytest.raises(InputError, match="another robot process"):
        Spool(tmp_path / "s", 1000)
    spool.close()


def test_a_damaged_spool_is_told_of(tmp_path: Path) -> None:
    (tmp_path / "s").write_bytes(b"no database at all" * 100)
    with pytest.raises(InputError, match="damaged"):
        Spool(tmp_path / "s", 1000)
