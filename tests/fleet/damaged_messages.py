"""Damages a robot's messages at random, lets the base station judge them, and writes what it accepts."""

import json
import sys
from collections import Counter
from pathlib import Path

import numpy as np

from mulan.fleet.ingest import Ingest, IngestConfig
from mulan.fleet.journal import Entry, Journal
from mulan.fleet.verdict import Arrival
from tests.fleet.conftest import SENT_NS, envelope_of, key_of, recorded_by


def flip_bits(data: bytearray, rng: np.random.Generator) -> None:
    """Turn one to three random bits over."""
    for _ in range(rng.integers(1, 4)):
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)


def judge_damaged(count: int, seed: int) -> tuple[Counter[str], list[Entry]]:
    """Outcomes of the damaged messages, and what was accepted of them after one whole log."""
    rng = np.random.default_rng(seed)
    config = IngestConfig(robots=("ant", "zebra"), messages_per_s=1e9, bytes_per_s=1e12)
    ingest, recorded = Ingest("m", config), recorded_by("ant", ["zebra"])
    outcomes, accepted = Counter[str](), []
    for number in range(count + len(recorded)):
        whole = number < len(recorded)
        message = recorded[number if whole else rng.integers(len(recorded))]
        attachment, payload = bytearray(envelope_of(message, number + 1)), bytearray(message.payload)
        key = key_of(message.suffix)
        match -1 if whole else rng.integers(6):
            case 0:
                flip_bits(attachment, rng)
            case 1 | 2:
                flip_bits(payload, rng)
            case 3:
                payload = payload[: rng.integers(len(payload))]
            case 4:
                payload += payload[: rng.integers(1, len(payload))]
            case 5:
                key = key_of(recorded[rng.integers(len(recorded))].suffix)
        verdict = ingest.judge(key, bytes(attachment), bytes(payload), SENT_NS, 0.0)
        ingest.robots["ant"].refused.clear()  # as if the robot had been told
        if not whole:
            outcomes[verdict.outcome.name] += 1
        if verdict.outcome is Arrival.ACCEPTED and verdict.entry is not None:
            ingest.settle(verdict)
            accepted.append(verdict.entry)
    return outcomes, accepted


if __name__ == "__main__":
    found, entries = judge_damaged(int(sys.argv[2]), seed=11)
    journal = Journal(Path(sys.argv[1]), durable=False)
    journal.append(entries)
    journal.close()
    print(json.dumps(found))
