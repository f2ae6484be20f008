"""Writes .dat files bit by bit, independently of the reader, and a decoded run like the published ones."""

import struct
import zipfile
from io import BytesIO

import numpy as np

MAC = bytes.fromhex("00216a3f175a")


def pack_bits(values):
    """CSI bits of [subcarriers, streams] complex integers: 3 bits to skip, then int8 pairs, lowest first."""
    number, at = 0, 0
    for row in values:
        at += 3
        for value in row:
            for part in (value.real, value.imag):
                number |= (int(part) & 0xFF) << at
                at += 8
    return number.to_bytes((at + 7) // 8, "little")


def record(
    csi, counter=0, time_s=(1_600_000_000, 0), mac=MAC, antenna_sel=0b100100, original=False, **change
):
    """One record of code 187; ``csi`` is [30, Nrx, Ntx] complex integers."""
    nrx, ntx = csi.shape[1:]
    bits = pack_bits(csi.reshape(len(csi), -1))
    field = {"nrx": nrx, "ntx": ntx, "length": len(bits), "usec": time_s[1]} | change
    head = struct.pack("<IHxxBB", (counter * 8000) % 2**32, counter % 2**16, field["nrx"], field["ntx"])
    head += struct.pack("<BBBbBBHH", 38, 13, 14, -90, 30, antenna_sel, field["length"], 0x101)
    if not original:
        head += struct.pack("<II", time_s[0], field["usec"]) + mac + struct.pack("<I", counter)
    payload = head + bits
    return struct.pack(">HB", len(payload) + 1, 187) + payload


def random_csi(rng, nrx=3, ntx=1):
    parts = rng.integers(-128, 128, (30, nrx, ntx, 2))
    return parts[..., 0] + 1j * parts[..., 1]


def recording(rng, packets=20, **more):
    return b"".join(record(random_csi(rng), k, (1_600_000_000, 8000 * k), **more) for k in range(packets))


def run_arrays(rng, packets=40, names=("tx2", "tx3")):
    """Members of a decoded run."""
    t = 1.6e9 + np.arange(packets) * 0.008
    arrays = {"links": np.array(names)}
    for name in names:
        for side in ("rx", "tx"):
            arrays[f"{name}_csi_{side}"] = rng.integers(-60, 60, (packets, 30, 2)).astype(np.int8)
            arrays[f"{name}_t_{side}"] = t + (40.0 if side == "tx" else 0.0)
        arrays[f"{name}_frame"] = np.arange(packets, dtype=np.uint32)
        arrays[f"{name}_pos"] = np.array([2.0, 1.0, 0.5])
    poses = np.zeros((packets, 14))
    poses[:, 0], poses[:, 1], poses[:, 7] = t, np.linspace(0, 0.5, packets), 1.0
    return arrays | {
        "mocap": poses[:, :4].copy(),
        "t265": poses.copy(),
        "odom": poses.copy(),
        "start": np.zeros(3),
        "move_t0_t1": np.array([t[3], t[-3]]),
    }


def npz(path, arrays):
    np.savez_compressed(path, **arrays)
    return path


def npz_of_bytes(path, members):
    """An archive whose members hold any bytes at all."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def npy(array, allow_pickle=False):
    stream = BytesIO()
    np.lib.format.write_array(stream, array, allow_pickle=allow_pickle)
    return stream.getvalue()
