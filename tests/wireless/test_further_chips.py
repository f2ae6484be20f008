import struct
import sys

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.wireless.pairing import pair_indices
from mulan.wireless.recordings.further_chips import CsiFileOptions, read_csi_file

from .cards import random_csi, record, recording

INDEX = np.r_[-28:0, 1:29]


@pytest.fixture
def csiread():
    return pytest.importorskip("csiread", reason="the extra csi is not installed")


def atheros_record(csi, time_us, order="<", payload=b"frame", **change):
    """``csi`` is [tones, nr, nc]; 10 bits imaginary, 10 bits real, lowest bit first."""
    tones, nr, nc = csi.shape
    number = 0
    for k, value in enumerate(csi.ravel()):
        for part, shift in ((value.imag, 0), (value.real, 10)):
            number |= (int(part) & 0x3FF) << (20 * k + shift)
    bits = number.to_bytes(csi.size * 20 // 8, "little")
    field = {
        "csi_bytes": len(bits),
        "tones": tones,
        "nr": nr,
        "nc": nc,
        "length": 25 + len(bits) + len(payload),
    } | change
    head = struct.pack(f"{order}QHHBBBB", time_us, field["csi_bytes"], 5540, 0, 0, 0x8B, 0)
    head += bytes([field["tones"], field["nr"], field["nc"], 40, 30, 31, 32])
    head += struct.pack(f"{order}H", len(payload))
    return struct.pack(f"{order}H", field["length"]) + head + bits + payload


def nexmon_file(packets, order="<", magic=0xA1B2C3D4):
    """``packets`` are (sender, sequence, core, int16 [points] complex or raw bytes)."""
    data = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, 1)
    for k, (sender, sequence, core, csi) in enumerate(packets):
        if isinstance(csi, bytes):
            frame = csi
        else:
            iq = np.stack([csi.real, csi.imag], -1).astype("<i2").tobytes()
            frame = bytes(6) + b"NEXMON" + bytes(30)
            frame += struct.pack("<I6sHHHH", 0x11111111, sender, sequence, core, 0x1001, 0x6A) + iq
        data += struct.pack(f"{order}IIII", 1000 + k, 250_000, len(frame), len(frame)) + frame
    return data


def read(tmp_path, data, **options):
    path = tmp_path / "card.dat"
    path.write_bytes(data)
    return read_csi_file(path, CsiFileOptions(**options))


def test_intel_files_need_no_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "csiread", None)
    track = read(tmp_path, recording(np.random.default_rng(0)), peer="tx2")
    assert (track.peer, track.channel.shape) == ("tx2", (20, 3, 30))
    two = recording(np.random.default_rng(0)) + record(random_csi(np.random.default_rng(1)), mac=b"abcdef")
    with pytest.raises(InputError, match="choose one by the option mac"):
        read(tmp_path, two)
    assert len(read(tmp_path, two, mac=b"abcdef".hex(":")).time_s) == 1


@pytest.mark.parametrize("order", ["<", ">"])
def test_atheros_channels_come_back(tmp_path, csiread, order):
    rng = np.random.default_rng(1)
    csi = rng.integers(-512, 512, (9, 56, 3, 2)) + 1j * rng.integers(-512, 512, (9, 56, 3, 2))
    data = b"".join(atheros_record(c, 10**12 + 2500 * k, order) for k, c in enumerate(csi))
    track = read(tmp_path, data)
    np.testing.assert_array_equal(track.channel, csi[..., 0].transpose(0, 2, 1))
    np.testing.assert_allclose(np.diff(track.time_s), 2.5e-3, atol=1e-9)
    np.testing.assert_allclose(track.subcarrier_hz, 5.54e9 + 312_500.0 * INDEX)
    np.testing.assert_array_equal(read(tmp_path, data[:-9]).channel, track.channel[:-1])


def test_atheros_records_without_a_channel_are_left_out(tmp_path, csiread):
    csi = np.full((56, 1, 1), 3 - 4j)
    empty = atheros_record(np.zeros((0, 1, 1)), 5)
    track = read(tmp_path, atheros_record(csi, 1) + empty + atheros_record(csi, 9))
    assert len(track.time_s) == 2
    assert (track.channel == 3 - 4j).all()
    wide = atheros_record(np.full((114, 1, 1), 1 + 1j), 1)
    with pytest.raises(InputError, match="carrier_hz"):
        read(tmp_path, wide)
    assert read(tmp_path, wide, carrier_hz=5.55e9).subcarrier_hz[0] == 5.55e9 - 58 * 312_500.0


def test_lengths_csiread_would_trust_are_refused_first(tmp_path, csiread):
    csi = np.full((56, 3, 1), 1 + 1j)
    good = atheros_record(csi, 1)
    for bad in (
        atheros_record(csi, 1, csi_bytes=400),
        atheros_record(csi, 1, tones=255),
        atheros_record(csi, 1, nr=200),
        atheros_record(csi, 1, length=30),
        atheros_record(csi, 1, length=10),
        atheros_record(csi[:, :2], 1),
        atheros_record(csi, 1, payload=bytes(5000)),
    ):
        with pytest.raises(InputError, match="of the record at byte 452"):
            read(tmp_path, good + bad + good)


@pytest.mark.parametrize(("order", "magic", "unit"), [("<", 0xA1B2C3D4, 1e-6), (">", 0xA1B23C4D, 1e-9)])
def test_nexmon_channels_come_back_in_order_of_frequency(tmp_path, csiread, order, magic, unit):
    rng = np.random.default_rng(2)
    csi = rng.integers(-2000, 2000, (6, 64)) + 1j * rng.integers(-2000, 2000, (6, 64))
    packets = [(b"abcdef", 16 * k, 0, c) for k, c in enumerate(csi)]
    packets.insert(3, (b"", 0, 0, bytes(60)))  # some other frame
    packets.insert(5, (b"abcdef", 48, 1, csi[0]))  # a second core
    track = read(tmp_path, nexmon_file(packets, order, magic), carrier_hz=5.2e9)
    expected = np.fft.fftshift(csi, 1)[:, 32 + INDEX]  # an FFT's order: 0, 1, ..., 31, -32, ..., -1
    np.testing.assert_array_equal(track.channel[:, 0], expected)
    np.testing.assert_allclose(track.subcarrier_hz, 5.2e9 + 312_500.0 * INDEX)
    assert track.frame_counter.tolist() == [0, 16, 32, 48, 64, 80]
    np.testing.assert_allclose(track.time_s[0], 1000 + 250_000 * unit)


def test_malformed_nexmon_files_are_refused(tmp_path, csiread):
    csi = np.ones(64) * (1 + 2j)
    good = [(b"abcdef", 1, 0, csi)]
    data = nexmon_file(good)
    with pytest.raises(InputError, match="carrier_hz"):
        read(tmp_path, data)
    for broken, match in (
        (nexmon_file([*good, (b"abcdef", 2, 0, np.ones(100))]), "100.0 subcarriers"),
        (nexmon_file([*good, (b"", 0, 0, bytes(20))]), "captured length"),
        (nexmon_file([(b"", 0, 0, bytes(80))]), "none is nexmon's"),
        (nexmon_file([(b"abcdef", 1, 0, 0 * csi)]), "1 of 1 packets are zero"),
        (nexmon_file([*good, (b"ghijkl", 2, 0, csi)]), "option mac"),
        (bytes.fromhex("0a0d0d0a") + bytes(60), "pcapng"),
    ):
        with pytest.raises(InputError, match=match):
            read(tmp_path, broken, carrier_hz=5.2e9)


def test_unknown_and_unsupported_headers_are_named(tmp_path):
    with pytest.raises(InputError, match="de ad be ef"):
        read(tmp_path, bytes.fromhex("deadbeef") + bytes(90))
    with pytest.raises(InputError, match=r"PicoScenes \(.csi\), which is not supported"):
        read(tmp_path, struct.pack("<II", 400, 0x20150315) + bytes(90))
    with pytest.raises(InputError, match="use read_wsr_run"):
        read(tmp_path, b"PK\x03\x04" + bytes(90))


def test_a_missing_extra_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "csiread", None)
    with pytest.raises(InputError, match=r"pip install 'mulan\[csi\]'"):
        read(tmp_path, nexmon_file([(b"abcdef", 1, 0, np.ones(64, complex))]), carrier_hz=5.2e9)


def test_tracks_without_a_counter_pair_by_time(tmp_path, csiread):
    rng = np.random.default_rng(3)
    sent_us = np.cumsum(8200 + rng.normal(0, 150, 200)).astype(int)
    csi = np.full((56, 1, 1), 3 - 4j)
    tracks = []
    for offset_us in (10**9, 5 * 10**10):
        stamps = sent_us + offset_us + rng.normal(0, 30, 200).astype(int)
        tracks.append(read(tmp_path, b"".join(atheros_record(csi, int(t)) for t in stamps)))
    i, j = pair_indices(*tracks)
    np.testing.assert_array_equal(i, j)
    assert len(i) > 195
