"""A folder in the WSR layout from a small radio of the tests' own."""

import csv
from pathlib import Path

import numpy as np

from tests.wireless.signals import SUBCARRIER_HZ, csi_direction

SOURCES_M = {"tx2": (3.0, 4.0, 0.3), "tx3": (-5.0, 1.0, 0.2)}


def write_run(path: Path, start_m, rng, yaw_rad=0.0, seconds=7.0, rate_hz=30):
    """One run; the T265 track is the true path turned by ``yaw_rad``, from its own origin."""
    time_s = 100.0 + np.arange(0, seconds, 1 / 120)
    turn = 1.4 * np.pi * np.clip((time_s - 101.0) / (seconds - 1.5), 0.0, 1.0)
    local = 0.3 * np.stack([np.sin(turn), 1 - np.cos(turn), np.zeros_like(turn)], -1)
    position = local + start_m
    moved = np.flatnonzero(np.linalg.norm(local - local[0], axis=1) > 0.006)
    R = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])
    own = np.column_stack([local[:, :2] @ R.T, local[:, 2]])
    rest = np.zeros((len(time_s), 6))
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (len(time_s), 1))
    table = np.column_stack([time_s, own, attitude, rest])
    arrays = {
        "links": np.array(list(SOURCES_M)),
        "mocap": np.column_stack([time_s, position]),
        "t265": table,
        "odom": table,
        "start": position[moved[0]],
        "move_t0_t1": np.array([time_s[moved[0]], time_s[np.argmax(turn == turn.max())]]),
    }
    packets_s = np.sort(rng.uniform(100.2, 100.0 + seconds - 0.2, int(rate_hz * seconds)))
    antenna = np.stack([np.interp(packets_s, time_s, position[:, k]) for k in range(3)], -1)
    for name, source in SOURCES_M.items():
        distance = np.linalg.norm(antenna - source, axis=1)
        carrier = np.cumsum(rng.normal(size=len(packets_s)) * 2.0)
        for side, sign, clock in (("rx", 1, 0.0), ("tx", -1, 31.0)):
            h = csi_direction(distance, sign * carrier, rng)[:, 0]
            h = np.round(60 * h / np.abs(h).max())
            arrays[f"{name}_csi_{side}"] = np.stack([h.real, h.imag], -1).astype(np.int8)
            arrays[f"{name}_t_{side}"] = packets_s + clock
            arrays[f"{name}_rssi_agc_{side}"] = np.full((len(packets_s), 2), 30, np.uint8)
        arrays[f"{name}_frame"] = np.arange(len(packets_s), dtype=np.uint32)
        arrays[f"{name}_pos"] = np.array(source)
    assert len(SUBCARRIER_HZ) == arrays["tx2_csi_rx"].shape[1]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, allow_pickle=False, **arrays)
    return arrays["start"]


def write_folder(root: Path, places=3, yaw_rad=0.0) -> Path:
    """One set, one run a place; the reference reports every azimuth 5 degrees too large."""
    rng = np.random.default_rng(1)
    rows = []
    for place in range(1, places + 1):
        run = f"L{place}_2021-01-01_00000{place}"
        start = write_run(root / "Set_X" / "npz" / f"{run}.npz", rng.uniform(-0.5, 0.5, 3), rng, yaw_rad)
        for name, source in SOURCES_M.items():
            truth = np.degrees(np.arctan2(source[1] - start[1], source[0] - start[0]))
            row = {"run": run, "location": place, "tx": name, "true_azimuth_deg": truth}
            for prefix in ("ref_groundtruth", "ref_t265"):
                row |= {f"{prefix}_azimuth_deg": truth + 5, f"{prefix}_variance": 0.5 + 0.01 * place}
                row |= {f"{prefix}_packets": 200}
            rows.append(row)
    with (root / "Set_X" / "reference.csv").open("w", newline="") as lines:
        writer = csv.DictWriter(lines, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return root
