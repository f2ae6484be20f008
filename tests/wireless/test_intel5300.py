import struct

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.wireless.recordings.intel5300 import SUBCARRIER_INDEX, read_intel5300, subcarriers_hz

from .cards import MAC, random_csi, record, recording


def read(tmp_path, data):
    path = tmp_path / "card.dat"
    path.write_bytes(data)
    return read_intel5300(path)


@pytest.mark.parametrize(("nrx", "ntx"), [(1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (2, 3)])
def test_every_bit_of_the_first_stream_comes_back(tmp_path, nrx, ntx):
    rng = np.random.default_rng(nrx + 3 * ntx)
    csi = [random_csi(rng, nrx, ntx) for _ in range(12)]
    order = {1: 0b100100, 2: 0b100100, 3: 0b100100}[nrx]
    packets = read(tmp_path, b"".join(record(c, k, antenna_sel=order) for k, c in enumerate(csi)))
    np.testing.assert_array_equal(packets.channel, np.array(csi)[..., 0].transpose(0, 2, 1))
    assert packets.unsorted_packets == 0


def test_header_fields_come_back(tmp_path):
    rng = np.random.default_rng(0)
    data = record(random_csi(rng), 2**32 - 1, (1_624_839_923, 629_527)) + record(
        random_csi(rng), 0, mac=b"abcdef"
    )
    packets = read(tmp_path, data)
    assert packets.frame_counter.tolist() == [2**32 - 1, 0]
    assert packets.time_s[0] == 1_624_839_923.629527
    assert packets.source_mac[0].tobytes() == MAC
    assert packets.rssi_db[0].tolist() == [38, 13, 14]
    assert packets.noise_dbm.tolist() == [-90, -90]
    assert packets.agc_db.tolist() == [30, 30]
    expected = 10 * np.log10(10**3.8 + 10**1.3 + 10**1.4) - 44 - 30
    np.testing.assert_allclose(packets.rss_dbm(), expected)


def test_chains_are_put_in_the_order_of_the_connectors(tmp_path):
    rng = np.random.default_rng(1)
    csi = random_csi(rng)
    swapped = read(tmp_path, record(csi, antenna_sel=0b011000)).channel[
        0
    ]  # B on connector 2, C on connector 1
    np.testing.assert_array_equal(swapped, csi[..., 0].T[[0, 2, 1]])
    invalid = read(tmp_path, record(csi, antenna_sel=0b000000))
    np.testing.assert_array_equal(invalid.channel[0], csi[..., 0].T)
    assert invalid.unsorted_packets == 1


def test_the_original_tool_is_read_with_its_own_clock(tmp_path):
    rng = np.random.default_rng(2)
    wrap = 2**32 // 8000  # the card's microseconds pass 2^32 between these packets
    packets = read(
        tmp_path, b"".join(record(random_csi(rng), k, original=True) for k in range(wrap - 2, wrap + 3))
    )
    np.testing.assert_allclose(np.diff(packets.time_s), 0.008)
    assert not packets.source_mac.any()
    assert packets.frame_counter.tolist() == [k % 2**16 for k in range(wrap - 2, wrap + 3)]


def test_a_cut_or_padded_end_is_counted_and_nothing_lost(tmp_path):
    data = recording(np.random.default_rng(3))
    whole = read(tmp_path, data)
    assert (whole.cut_bytes, whole.padding_bytes) == (0, 0)
    padded = read(tmp_path, data + bytes(100))
    assert padded.padding_bytes == 100
    np.testing.assert_array_equal(padded.channel, whole.channel)
    for cut in (1, 50, 191, 230):
        short = read(tmp_path, data[:-cut])
        assert short.cut_bytes == 233 - cut
        np.testing.assert_array_equal(short.channel, whole.channel[:-1])


def test_other_messages_are_counted_and_floods_of_unknown_ones_refused(tmp_path):
    data = recording(np.random.default_rng(4))
    noise, unknown = struct.pack(">HB4x", 5, 0xD0), struct.pack(">HB4x", 5, 0x77)
    assert read(tmp_path, noise + data + noise).other_records == 2
    with pytest.raises(InputError, match=r"code: .* is 119, unknown"):
        read(tmp_path, data + unknown)
    with pytest.raises(InputError, match="none carries channel state"):
        read(tmp_path, noise * 30)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"nrx": 0}, "Nrx, Ntx"),
        ({"ntx": 7}, "Nrx, Ntx"),
        ({"length": 180}, "CSI length"),
        ({"nrx": 2}, "CSI length"),
        ({"usec": 1_000_000}, "tv_usec"),
    ],
)
def test_a_malformed_record_is_refused_by_field_and_place(tmp_path, change, field):
    rng = np.random.default_rng(5)
    bad = record(random_csi(rng), 99, **change)
    with pytest.raises(InputError, match="of the record at byte 4660") as caught:
        read(tmp_path, recording(rng) + bad + recording(rng))
    assert caught.value.field == field


def test_a_broken_chain_is_refused(tmp_path):
    rng = np.random.default_rng(6)
    data = recording(rng)
    for length, problem in ((0, "is zero although"), (60_000, "longer than any"), (3000, "bytes follow")):
        broken = data[:-466] + struct.pack(">H", length) + data[-464:]
        with pytest.raises(InputError, match=problem):
            read(tmp_path, broken)
    with pytest.raises(InputError, match="Nrx"):
        read(tmp_path, data + record(random_csi(rng, nrx=2)))
    with pytest.raises(InputError, match="bytes for the header"):
        read(tmp_path, data + record(random_csi(rng), original=True))


def test_zero_packets_are_counted_and_zero_recordings_refused(tmp_path):
    rng = np.random.default_rng(7)
    zero = record(np.zeros((30, 3, 1), complex))
    assert read(tmp_path, recording(rng) + zero).zero_packets == 1
    with pytest.raises(InputError, match="20 of 20 packets are zero"):
        read(tmp_path, zero * 20)


@pytest.mark.parametrize(
    ("head", "name"),
    [
        (bytes.fromhex("d4c3b2a1") + bytes(80), "nexmon"),
        (struct.pack("<II", 400, 0x20150315) + bytes(80), "PicoScenes"),
        (struct.pack(">HQHHBBBBBBB", 600, 1, 560, 5540, 0, 0, 0x8B, 0, 56, 3, 1) + bytes(80), "Atheros"),
        (b"type,role,mac,rssi,rate\n", "ESP32"),
        (b"PK\x03\x04" + bytes(80), "npz"),
        (b"\x7fELF" + bytes(80), "7f 45 4c 46"),
        (b"", "is empty"),
    ],
)
def test_another_file_is_named_for_what_it_is(tmp_path, head, name):
    with pytest.raises(InputError, match=name) as caught:
        read(tmp_path, head)
    assert "card.dat" in str(caught.value)


def test_the_track_of_one_sender_is_picked_by_address(tmp_path):
    rng = np.random.default_rng(8)
    data = b"".join(record(random_csi(rng), k, mac=MAC if k % 3 else b"abcdef") for k in range(30))
    packets = read(tmp_path, data)
    assert packets.senders == (MAC.hex(":"), b"abcdef".hex(":"))
    track = packets.track("tx2", "00:21:6A:3F:17:5A", 5.2e9)
    assert track.peer == "tx2"
    assert track.frame_counter.tolist() == [k for k in range(30) if k % 3]
    np.testing.assert_array_equal(track.subcarrier_hz, subcarriers_hz(5.2e9))
    assert (len(SUBCARRIER_INDEX), SUBCARRIER_INDEX[0], SUBCARRIER_INDEX[-1]) == (30, -28, 28)
    with pytest.raises(InputError, match="sent no packet"):
        packets.track("tx3", "00:21:6A:30:D2:3C")
    with pytest.raises(InputError, match="is no address"):
        packets.track("tx3", "tx3")


def test_a_missing_file_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_intel5300(tmp_path / "none.dat")
    with pytest.raises(InputError, match="cannot be read"):
        read_intel5300(tmp_path)
