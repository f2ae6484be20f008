from collections import Counter

import numpy as np
import pytest
from benchmarks.fuzz_recordings import (
    GOOD,
    damaged_archive,
    damaged_chain,
    members_of,
    outcome,
    read_archive,
    read_chain,
)

from mulan.wireless.recordings.further_chips import CsiFileOptions, read_csi_file

from .cards import npz, recording, run_arrays
from .test_further_chips import atheros_record, nexmon_file

LIMIT_S = 5.0


def tally(read, damage, base, path, cases, seed):
    rng = np.random.default_rng(seed)
    verdicts = Counter()
    for case in range(cases):
        path.write_bytes(damage(base, rng))
        verdict, details = outcome(read, path, LIMIT_S)
        assert verdict in GOOD, f"case {case}: {verdict}: {details}"
        verdicts[verdict] += 1
    return verdicts


def test_damaged_intel_files_are_refused_or_read_sensibly(tmp_path):
    base = recording(np.random.default_rng(0), packets=30)
    verdicts = tally(read_chain, damaged_chain, base, tmp_path / "card.dat", 500, 1)
    assert min(verdicts[v] for v in GOOD) > 50  # the damage is neither trivial nor always fatal


def test_damaged_decoded_runs_are_refused_or_read_sensibly(tmp_path):
    base = members_of(npz(tmp_path / "base.npz", run_arrays(np.random.default_rng(0))))
    verdicts = tally(read_archive, damaged_archive, base, tmp_path / "run.npz", 500, 2)
    assert min(verdicts[v] for v in GOOD) > 10


@pytest.mark.parametrize("card", ["atheros", "nexmon"])
def test_damaged_files_never_reach_code_that_trusts_them(tmp_path, card):
    pytest.importorskip("csiread", reason="the extra csi is not installed")
    rng = np.random.default_rng(3)
    if card == "atheros":
        csi = rng.integers(-500, 500, (12, 56, 2, 1)) * (1 + 0.5j)
        base = b"".join(atheros_record(np.round(c), 10**9 + 2500 * k) for k, c in enumerate(csi))
    else:
        base = nexmon_file([(b"abcdef", k, 0, rng.integers(-99, 99, 64) * (1 + 1j)) for k in range(12)])

    def read(path):
        track = read_csi_file(path, CsiFileOptions(carrier_hz=5.2e9))
        return None if np.isfinite(track.channel).all() and track.channel.any() else "silent zeros"

    tally(read, damaged_chain, base, tmp_path / "card.dat", 300, 4)
