"""Recordings damaged in ten thousand ways: each is refused with a reason or read sensibly (JSON, picture).

Real files are mutated (bits, lengths, headers, records, archive members, types, shapes, pickles); nothing may
crash, hang, or come back zero or not finite.

python benchmarks/fuzz_recordings.py --data $MULAN_DATA/wsr_aoa --out runs/fuzz
"""

import io
import pickle
import resource
import signal
import struct
import sys
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import tyro
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import write_json
from mulan.mission.types import CsiTrack
from mulan.wireless.recordings.intel5300 import read_intel5300
from mulan.wireless.recordings.wsr import read_wsr_run

GOOD = ("refused", "read")
Members = dict[str, bytes]


@dataclass(frozen=True)
class Options:
    """Mutate real recordings and read them."""

    data: Path
    """Folder of WSR recordings with npz and raw runs."""
    out: Path
    """Folder for metrics.json and outcomes.png."""
    cases: int = 10_000
    """Damaged inputs, half of each format."""
    seed: int = 0
    """Source of all randomness."""
    limit_s: float = 5.0
    """A single input that takes longer counts as a hang."""


class Hang(BaseException):
    """The time limit was reached; no reader may catch it."""


def _flip(data: bytearray, rng: np.random.Generator, begin: int = 0) -> None:
    for at in rng.integers(begin, max(len(data), begin + 1), rng.integers(1, 20)):
        if at < len(data):
            data[at] ^= 1 << int(rng.integers(8))


def _records(data: bytes) -> list[bytes]:
    found, at = [], 0
    while at + 2 <= len(data):
        length = 2 + struct.unpack_from(">H", data, at)[0]
        found.append(data[at : at + length])
        at += length
    return found


def damaged_chain(data: bytes, rng: np.random.Generator) -> bytes:
    """A .dat file with one to three faults."""
    for _ in range(rng.integers(1, 4)):
        changed, records = bytearray(data), _records(data)
        at = int(rng.integers(max(len(data), 1)))
        k = int(rng.integers(max(len(records), 1)))
        start = sum(map(len, records[:k]))
        match int(rng.integers(14)):
            case 0:
                _flip(changed, rng)
            case 1:
                del changed[at:]
            case 2:
                del changed[at : at + int(rng.integers(1, 300))]
            case 3:
                changed[at:at] = rng.bytes(int(rng.integers(1, 300)))
            case 4 if records:
                changed[start:start] = records[k] * int(rng.integers(1, 4))
            case 5 if records:
                del changed[start : start + len(records[k])]
            case 6:
                changed[start : start + 2] = rng.bytes(2)
            case 7:  # any header field
                field = start + int(rng.integers(2, 42))
                changed[field : field + 1] = rng.bytes(1)
            case 8:
                changed[at : at + int(rng.integers(1, 2000))] = bytes(int(rng.integers(1, 2000)))
            case 9:
                changed += bytes(int(rng.integers(1, 500)))
            case 10:
                changed += rng.bytes(int(rng.integers(1, 500)))
            case 11:  # channels of zero
                changed = bytearray(b"".join(r[:41] + bytes(max(len(r) - 41, 0)) for r in records))
            case 12:
                changed = bytearray(rng.bytes(int(rng.integers(0, 2000))))
            case 13:
                changed[start + 2 : start + 3] = rng.bytes(1)
            case _:
                pass
        data = bytes(changed)
    return data


class _Pickled:
    """Raises if anyone unpickles it."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return exec, ("raise SystemError('a pickle was opened')",)


def _npy(array: NDArray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, allow_pickle=True)
    return stream.getvalue()


def _damaged_array(array: NDArray, rng: np.random.Generator) -> NDArray:
    changed = array.copy()
    match int(rng.integers(12)):
        case 0:
            kinds = ["f4", "f8", "i8", "i1", "u4", ">f8", "c16", "U3", "S4", "M8[s]", "?", "O"]
            try:
                return changed.astype(rng.choice(kinds))
            except (TypeError, ValueError):
                return np.array(str(changed))
        case 1:
            return changed[: int(rng.integers(len(changed) + 1))] if changed.ndim else changed[None]
        case 2:
            return changed.reshape(-1)
        case 3:
            return changed[..., None]
        case 4 if changed.dtype.kind == "f" and changed.size:
            where = rng.integers(changed.size, size=rng.integers(1, 5))
            changed.reshape(-1)[where] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0])
            return changed
        case 5:
            return np.zeros_like(changed)
        case 6:
            return np.asfortranarray(changed)
        case 7:
            return changed[::-1]
        case 8:
            return np.array([_Pickled()], object)
        case 9:
            return np.zeros(3, [("time", "f8"), ("x", "i4")])
        case 10 if changed.dtype.kind in "iuf" and changed.size:
            raw = bytearray(changed.tobytes())
            _flip(raw, rng)
            return np.frombuffer(bytes(raw), changed.dtype).reshape(changed.shape)
        case _:
            return np.concatenate([changed, changed]) if changed.ndim else changed


def _damaged_header(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    match int(rng.integers(4)):
        case 0:
            changed[: min(len(changed), 128)] = rng.bytes(min(len(changed), 128))
        case 1:
            head = bytearray(changed[:128])
            _flip(head, rng)
            changed[:128] = head
        case 2:
            wish = rng.choice(
                [b"(99999999999,)", b"(-1, 30, 2)", b"(2**70,)", b"((((((1,),),),),)", b"(1e9,)", b"(0, 14)"]
            )
            at = changed.find(b"(", 10)
            if at > 0:
                changed[at : at + len(wish)] = wish
        case _:
            del changed[int(rng.integers(len(changed) + 1)) :]
    return bytes(changed)


def damaged_archive(members: Members, rng: np.random.Generator) -> bytes:
    """An .npz file with one to three faults in its arrays, their headers or the archive."""
    members = dict(members)
    for _ in range(rng.integers(1, 4)):
        names = list(members)
        if not names:
            break
        name = names[int(rng.integers(len(names)))]
        match int(rng.integers(8)):
            case 0:
                members.pop(name)
            case 1:
                members[str(rng.choice(["links", "tx2_csi_rx", "mocap", "x", "../x", ""]))] = members[name]
            case 2:
                members[name] = _damaged_header(members[name], rng)
            case 3:
                members[name] = members[names[int(rng.integers(len(names)))]]
            case 4:
                members[name] = rng.bytes(int(rng.integers(300)))
            case 5:
                members[name] = pickle.dumps(_Pickled())
            case _:
                try:
                    array = np.lib.format.read_array(io.BytesIO(members[name]), allow_pickle=False)
                except Exception:  # damaged in an earlier round
                    continue
                members[name] = _npy(_damaged_array(array, rng))
    stream = io.BytesIO()
    methods = [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]
    method = methods[int(rng.choice(4, p=[0.7, 0.2, 0.05, 0.05]))]
    with zipfile.ZipFile(stream, "w", method, compresslevel=1) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
        if rng.random() < 0.005 and method == zipfile.ZIP_DEFLATED:
            archive.writestr("bomb.npy", bytes(20 * 2**20))
    changed = bytearray(stream.getvalue())
    match int(rng.integers(10)):
        case 0:
            _flip(changed, rng)
        case 1:
            _flip(changed, rng, max(0, len(changed) - 1500))  # the directory
        case 2:
            del changed[int(rng.integers(len(changed))) :]
        case 3:
            at = int(rng.integers(len(changed)))
            changed[at : at + 200] = rng.bytes(200)
        case _:
            pass
    return bytes(changed)


def _fault_of_tracks(tracks: list[CsiTrack]) -> str | None:
    for track in tracks:
        if not np.isfinite(track.channel).all() or not np.isfinite(track.time_s).all():
            return "not finite"
        if not track.channel.any():
            return "silent zeros"
    return None if tracks else "nothing"


def read_chain(path: Path) -> str | None:
    """Read every sender of a .dat file; returns what is wrong with the result."""
    packets = read_intel5300(path)
    if not np.isfinite(packets.channel).all() or not packets.channel.any():
        return "silent zeros"
    tracks = []
    for mac in packets.senders[:20]:
        try:
            tracks.append(packets.track("peer", mac))
        except InputError:
            continue  # that one sent only zeros
    return _fault_of_tracks(tracks)


def read_archive(path: Path) -> str | None:
    """Read a decoded run; returns what is wrong with the result."""
    run = read_wsr_run(path)
    numbers = [run.mocap.position_m, run.t265.T_odom_body, run.odometry.T_odom_body, run.start_m]
    if not all(np.isfinite(array).all() for array in numbers):
        return "not finite"
    return _fault_of_tracks([track for link in run.links for track in (link.forward, link.reverse)])


def outcome(read: Callable[[Path], str | None], path: Path, limit_s: float) -> tuple[str, str]:
    """What a reader made of a file ("refused" and "read" are good), and the details."""

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        fault = read(path)
        return ("read", "") if fault is None else (fault, "")
    except InputError as refusal:
        named = path.name in str(refusal)
        return ("refused", refusal.field) if named else ("unnamed refusal", str(refusal))
    except Hang:
        return "hang", traceback.format_exc()
    except Exception as crash:
        return f"crash: {type(crash).__name__}", traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def members_of(path: Path) -> Members:
    """Raw members of an archive."""
    with zipfile.ZipFile(path) as archive:
        return {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}


def main(options: Options) -> None:
    rng = np.random.default_rng(options.seed)
    chains = [path.read_bytes()[: 233 * 60] for path in sorted(options.data.glob("*/raw/*/*.dat"))]
    archives = [members_of(path) for path in sorted(options.data.glob("*/npz/*.npz"))[::8]]
    if not chains or not archives:
        sys.exit(f"{options.data}: no raw/*/*.dat or npz/*.npz below it")
    counts = {"dat": Counter[str](), "npz": Counter[str]()}
    failures, slowest_s, begin = [], 0.0, time.perf_counter()
    with TemporaryDirectory() as folder:
        for case in range(options.cases):
            if case % 2:
                kind, read = "npz", read_archive
                data = damaged_archive(archives[int(rng.integers(len(archives)))], rng)
            else:
                kind, read = "dat", read_chain
                data = damaged_chain(chains[int(rng.integers(len(chains)))], rng)
            path = Path(folder) / f"case.{kind}"
            path.write_bytes(data)
            started = time.perf_counter()
            verdict, details = outcome(read, path, options.limit_s)
            slowest_s = max(slowest_s, time.perf_counter() - started)
            counts[kind][verdict] += 1
            if verdict not in GOOD:
                failures.append({"case": case, "kind": kind, "verdict": verdict, "details": details})
    result: dict[str, Any] = {
        "provenance": provenance(options.seed),
        "cases": options.cases,
        "outcomes": {kind: dict(count) for kind, count in counts.items()},
        "failures": failures,
        "slowest_s": round(slowest_s, 4),
        "peak_memory_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "wall_s": round(time.perf_counter() - begin, 1),
    }
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(options.out / "metrics.json", result)
    figure, axes = plt.subplots(figsize=(6, 2))
    for row, count in enumerate(counts.values()):
        left = 0
        for verdict, number in sorted(count.items(), reverse=True):
            axes.barh(row, number, left=left)
            axes.text(left + number / 2, row, f"{verdict}\n{number}", ha="center", va="center", fontsize=8)
            left += number
    axes.set_yticks(range(len(counts)), list(counts))
    axes.set(xlabel="damaged inputs", title="outcomes")
    figure.savefig(options.out / "outcomes.png", dpi=120, bbox_inches="tight")
    print(result["outcomes"], f"{len(failures)} failures, slowest {slowest_s:.3f} s")
    if failures:
        sys.exit(1)


if __name__ == "__main__":
    main(tyro.cli(Options))
