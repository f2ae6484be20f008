"""Time and memory of the angle-of-arrival profile and of whole real links on one core; JSON and a picture.

python benchmarks/radio_speed.py --data $MULAN_DATA/wsr_aoa --out runs/radio_speed

Each part runs in a process of its own, pinned to one core with one thread, and reports that process's peak
memory. Without --data only simulated paths are measured.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import write_json
from mulan.wireless.directions import direction_grid, unit_direction
from mulan.wireless.profile import bartlett_power, wavenumber_rad_m

WAVELENGTH_M = 0.0541
RANGE_M = 5.0
SOURCE_M = np.array([3.0, 2.0, 0.7])  # from the middle of the path
NAIVE_ELEMENTS = 2_000_000  # of the steering matrix at once; the whole matrix is slower and needs gigabytes
GOALS = {300: 25.0, 1000: 100.0}


class Part(Enum):
    """What one process measures."""

    ALL = "all"
    PLANE = "plane"
    CHANNELS = "channels"
    SPHERICAL = "spherical"
    TORCH = "torch"
    MEMORY = "memory"
    LINKS = "links"


@dataclass(frozen=True)
class Options:
    """Our profile and the straightforward product by turns; then recordings from file to covariance."""

    out: Path
    """Folder for metrics.json and speed.png."""
    data: Path | None = None
    """Folder of recordings in the WSR layout; without it no real links."""
    packets: tuple[int, ...] = (100, 300, 1000, 3000)
    """Packets a path."""
    repeats: int = 5
    """Turns; the medians count."""
    links_each: int = 1
    """Measure every so-many-th recording."""
    seed: int = 0
    """Of positions and noise."""
    part: Part = Part.ALL
    """Measure one part in this very process and print it."""


@dataclass(frozen=True)
class PathShape:
    """Axes of the loop an antenna makes; every packet is up to two millimetres off it."""

    width_m: float
    depth_m: float
    height_m: float

    def positions(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """[n, 3] along the loop."""
        turn = np.linspace(0, 1.8 * np.pi, n)
        loop = np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn)], 1)
        loop = loop * [self.width_m / 2, self.depth_m / 2, self.height_m / 2]
        level = [1.0, 1.0, 1.0 if self.height_m else 0.0]
        return loop + rng.uniform(-0.002, 0.002, loop.shape) * level


SHAPES = {
    "ground robot, 0.7 m": PathShape(0.6, 0.4, 0.0),
    "ground robot, 1.5 m": PathShape(1.2, 0.9, 0.0),
    "by hand, 0.7 m, 0.15 m high": PathShape(0.6, 0.4, 0.15),
    "by hand, 1.5 m, 0.15 m high": PathShape(1.2, 0.9, 0.15),
    "drone, 1.5 m, 0.5 m high": PathShape(1.2, 0.8, 0.5),
}


def source_channel(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Round-trip channel of one source with phase noise."""
    distance = np.linalg.norm(position.mean(0) + SOURCE_M - position, axis=1)
    phase = wavenumber_rad_m(WAVELENGTH_M) * distance + 0.4 * rng.normal(size=len(position))
    return np.exp(-1j * phase)


def naive_power(position: np.ndarray, channel: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """``|exp(-j k U Pᵀ) h|²`` in complex128 over all directions."""
    blocks = np.array_split(directions, 1 + len(directions) * len(position) // NAIVE_ELEMENTS)
    k, columns = wavenumber_rad_m(WAVELENGTH_M), channel.reshape(len(channel), -1)
    power = [(np.abs(np.exp(-1j * k * (u @ position.T)) @ columns) ** 2).sum(1) for u in blocks]
    return np.concatenate(power)


def time_ms(call: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    result = call()
    return 1e3 * (time.perf_counter() - began), result


def compared(
    position: np.ndarray, channel: np.ndarray, ours: Callable[[], Any], repeats: int, check: bool = True
) -> dict[str, Any]:
    """Medians [ms] of both taken by turns (ours three times a turn), their ratio, and our error."""
    directions = unit_direction(*np.meshgrid(*direction_grid(360, 181))).reshape(-1, 3)
    naive_ms, ours_ms, error = [], [], None
    power = ours()
    for _ in range(repeats):
        elapsed, expected = time_ms(lambda: naive_power(position, channel, directions))
        naive_ms.append(elapsed)
        for _ in range(3):
            elapsed, power = time_ms(ours)
            ours_ms.append(elapsed)
        if check:
            error = float(np.abs(np.asarray(power).ravel() - expected).max() / expected.max())
    naive, own = float(np.median(naive_ms)), float(np.median(ours_ms))
    measured = {"naive_ms": naive, "ours_ms": own, "ratio": naive / own}
    return measured if error is None else measured | {"error_of_peak": error}


def plane(options: Options) -> dict[str, Any]:
    rng = np.random.default_rng(options.seed)
    found: dict[str, Any] = {}
    for name, shape in SHAPES.items():
        for n in options.packets:
            position = shape.positions(n, rng)
            h = source_channel(position, rng)
            found.setdefault(name, {})[str(n)] = compared(
                position, h, lambda p=position, h=h: bartlett_power(p, h, WAVELENGTH_M), options.repeats
            )
    return found


def channels(options: Options) -> dict[str, Any]:
    """Thirty subcarriers: alike but for 20 dB of noise, and all different."""
    rng = np.random.default_rng(options.seed)
    found: dict[str, Any] = {}
    n = 300
    for name in ("ground robot, 0.7 m", "by hand, 0.7 m, 0.15 m high"):
        position = SHAPES[name].positions(n, rng)
        noise = (rng.normal(size=(n, 30)) + 1j * rng.normal(size=(n, 30))) / np.sqrt(2)
        alike = source_channel(position, rng)[:, None] * np.exp(2j * rng.normal(size=30)) + 0.1 * noise
        for kind, h in (("alike", alike), ("unlike", noise)):
            found[f"{name}, {kind}"] = compared(
                position, h, lambda p=position, h=h: bartlett_power(p, h, WAVELENGTH_M), options.repeats
            )
    return found


def spherical(options: Options) -> dict[str, Any]:
    """Against plane waves by the straightforward product, which is the cheaper task."""
    rng = np.random.default_rng(options.seed)
    found: dict[str, Any] = {}
    for name in ("ground robot, 0.7 m", "by hand, 1.5 m, 0.15 m high"):
        for n in options.packets:
            position = SHAPES[name].positions(n, rng)
            h = source_channel(position, rng)
            found.setdefault(name, {})[str(n)] = compared(
                position,
                h,
                lambda p=position, h=h: bartlett_power(p, h, WAVELENGTH_M, range_m=RANGE_M),
                options.repeats,
                check=False,
            )
    return found


def by_torch(options: Options) -> dict[str, Any]:
    import torch

    from mulan.wireless.profile_torch import bartlett_power_torch

    torch.set_num_threads(1)
    rng = np.random.default_rng(options.seed)
    found: dict[str, Any] = {}
    for name in ("ground robot, 0.7 m", "by hand, 0.7 m, 0.15 m high"):
        for n in options.packets:
            position = SHAPES[name].positions(n, rng)
            h = source_channel(position, rng)
            found.setdefault(name, {})[str(n)] = compared(
                position, h, lambda p=position, h=h: bartlett_power_torch(p, h, WAVELENGTH_M), options.repeats
            )
    return found


def memory(options: Options) -> dict[str, Any]:
    """The largest profiles; only this process's peak matters."""
    rng = np.random.default_rng(options.seed)
    position = SHAPES["drone, 1.5 m, 0.5 m high"].positions(3000, rng)
    h = rng.normal(size=(3000, 30)) + 1j * rng.normal(size=(3000, 30))
    bartlett_power(position[:1000], h[:1000], WAVELENGTH_M)
    bartlett_power(position, h[:, 0], WAVELENGTH_M)
    bartlett_power(position[:1000], h[:1000, 0], WAVELENGTH_M, range_m=RANGE_M)
    return {"profiles": "[1000, 30] and [3000] plane, [1000] spherical"}


def links(options: Options) -> dict[str, Any]:
    """Every link from its file to its bearing; the reading of the whole run counts for each of its links."""
    from mulan.wireless.bearing import BearingConfig
    from mulan.wireless.link_bearing import DisplacementSource, link_bearing
    from mulan.wireless.recordings.wsr import read_wsr_run

    assert options.data is not None
    files = sorted(options.data.glob("*/npz/*.npz"))[:: options.links_each]
    config = BearingConfig()
    found: dict[str, Any] = {}
    for source in (DisplacementSource.MOCAP, DisplacementSource.T265):
        read_ms, bearing_ms, whole_ms, packets = [], [], [], []
        warm = read_wsr_run(files[0])
        link_bearing(warm, warm.links[0], source, config)
        for file in files:
            reading, run = time_ms(lambda file=file: read_wsr_run(file))
            for link in run.links:
                elapsed, bearing = time_ms(
                    lambda run=run, link=link, source=source: link_bearing(run, link, source, config)
                )
                if bearing is None:
                    continue
                read_ms.append(reading)
                bearing_ms.append(elapsed)
                whole_ms.append(reading + elapsed)
                packets.append(bearing.packets)
        found[source.value] = {"links": len(whole_ms), "median_packets": float(np.median(packets))} | {
            f"{name}_ms": {"median": float(np.median(times)), "p95": float(np.quantile(times, 0.95))}
            for name, times in (("read", read_ms), ("bearing", bearing_ms), ("whole", whole_ms))
        }
    return found


MEASURE = {
    Part.PLANE: plane,
    Part.CHANNELS: channels,
    Part.SPHERICAL: spherical,
    Part.TORCH: by_torch,
    Part.MEMORY: memory,
    Part.LINKS: links,
}


def measured_here(options: Options) -> dict[str, Any]:
    result = MEASURE[options.part](options)
    return result | {"peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6}


def measured_alone(options: Options, part: Part) -> dict[str, Any]:
    """One part in a fresh process on one core."""
    arguments = ["--part", part.name]
    for field in fields(options):
        value = getattr(options, field.name)
        if field.name == "part" or value is None:
            continue
        values = value if isinstance(value, tuple) else (value,)
        arguments += [f"--{field.name.replace('_', '-')}", *map(str, values)]
    one_thread = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "VECLIB")}
    finished = subprocess.run(
        [sys.executable, __file__, *arguments],
        env=os.environ | one_thread,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return json.loads(finished.stdout.splitlines()[-1])


def draw(result: dict[str, Any], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (times, ratios) = plt.subplots(1, 2, figsize=(11, 4))
    naive: dict[int, list[float]] = {}
    for name, by_packets in result["plane"].items():
        if not isinstance(by_packets, dict):
            continue
        n = [int(key) for key in by_packets]
        ours = [m["ours_ms"] for m in by_packets.values()]
        times.plot(n, ours, "o-", label=name)
        ratios.plot(n, [m["ratio"] for m in by_packets.values()], "o-", label=name)
        for count, m in zip(n, by_packets.values(), strict=True):
            naive.setdefault(count, []).append(m["naive_ms"])
    times.plot(list(naive), [np.median(v) for v in naive.values()], "k--", label="complex128 product")
    times.set(xscale="log", yscale="log", xlabel="packets", ylabel="full 360×181 profile [ms]")
    ratios.plot(list(GOALS), list(GOALS.values()), "k_", markersize=16, label="goal")
    ratios.set(xscale="log", yscale="log", xlabel="packets", ylabel="times faster than the product")
    for panel in (times, ratios):
        panel.grid(alpha=0.3)
        panel.legend(fontsize=7)
    figure.savefig(path, dpi=120, bbox_inches="tight")


def main(options: Options) -> None:
    if options.part is not Part.ALL:
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        print(json.dumps(measured_here(options)))
        return
    options.out.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {
        "grid": "360 azimuths, 181 elevations, round trip",
        "provenance": provenance(options.seed),
        "repeats": options.repeats,
    }
    for part in MEASURE:
        if part is Part.LINKS and options.data is None:
            continue
        result[part.value] = measured_alone(options, part)
        print(part.value, json.dumps(result[part.value]), flush=True)
        write_json(options.out / "metrics.json", result)
    draw(result, options.out / "speed.png")


if __name__ == "__main__":
    main(tyro.cli(Options))
