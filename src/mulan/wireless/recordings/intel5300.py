"""Channel state of Intel 5300 cards from .dat files of the Linux 802.11n CSI Tool and the WSR toolbox.

A file is a chain of records: uint16 length L (big-endian), uint8 code, L - 1 bytes. Code 187 carries channel state:
a header of 38 bytes (WSR toolbox; 20 in the original tool, which records neither host time, sender nor frame
counter), then for each of 30 subcarriers 3 bits to skip and int8 pairs (real, imaginary), least significant bit
first. Sources: Halperin et al., "Tool Release: Gathering 802.11n Traces with Channel State Information", 2011; Jadhav
et al., "A Wireless Signal-Based Sensing Framework for Robotics", IJRR 2022.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float, Int, UInt, UInt8, UInt32
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import CsiTrack
from mulan.wireless.recordings.chip import HEADER_BYTES, INTEL_CSI_CODE, describe_header

CHANNEL_108_HZ = 5.54e9
SUBCARRIER_SPACING_HZ = 312_500.0
SUBCARRIER_INDEX = np.array([*range(-28, 0, 2), -1, *range(1, 28, 2), 28])  # 802.11n, 20 MHz, grouping 2
MAX_FILE_BYTES = 2**30

_SUBCARRIERS = len(SUBCARRIER_INDEX)
_ORIGINAL_HEADER, _WSR_HEADER = 20, 38
# other messages of the driver's connector (iwl-connector.h); they carry no channel state
_OTHER_CODES = frozenset({0x1C, 0x1D, 0x1E, 0xC0, 0xC1, 0xC3, 0xD0})
_MOST_UNKNOWN = 0.01  # share of records with an unknown code before the chain counts as broken
_LONGEST_RECORD = 4096  # a received frame (code 193) with its headers
_REMEDY = "record again, or copy the file again if it was damaged"
_HEADER = np.dtype(
    {
        "names": ["nic_us", "count", "nrx", "ntx", "rssi", "noise", "agc", "antenna_sel", "length", "rate"]
        + ["tv_sec", "tv_usec", "mac", "frame_counter"],
        "formats": ["<u4", "<u2", "u1", "u1", "(3,)u1", "i1", "u1", "u1", "<u2", "<u2"]
        + ["<u4", "<u4", "(6,)u1", "<u4"],
        "offsets": [0, 4, 8, 9, 10, 13, 14, 15, 16, 18, 20, 24, 28, 34],
        "itemsize": _WSR_HEADER,
    }
)


def subcarriers_hz(carrier_hz: float = CHANNEL_108_HZ) -> Float[NDArray, "30"]:
    """Absolute frequencies of the 30 reported subcarriers of a 20 MHz channel."""
    return carrier_hz + SUBCARRIER_SPACING_HZ * SUBCARRIER_INDEX


@dataclass(frozen=True)
class Intel5300Packets:
    """Every packet of one file, in the order of recording.

    Attributes:
        path: The file.
        nic_time_us: The card's own microsecond clock; wraps after 71 minutes.
        time_s: Host time of reception; the card's clock, unwrapped, where the tool recorded none.
        source_mac: Sender; zero where the tool recorded none.
        frame_counter: Counter shared by a packet and its reply; the driver's own count where the tool recorded none.
        rssi_db: RSSI of RF chains A, B, C as reported; zero where a chain was off.
        noise_dbm: As reported.
        agc_db: Gain of the receiver.
        channel: In card units (integers), by antenna connector; of the first spatial stream. Not scaled to power.
        unsorted_packets: How many named no valid order of the RF chains; their order is the recorded one.
        zero_packets: How many are zero on every antenna and subcarrier.
        other_records: How many records carried something else than channel state.
        cut_bytes: Length of a last record that was cut off and left out.
        padding_bytes: Zeros after the last record.
    """

    path: Path
    nic_time_us: UInt32[NDArray, "n"]
    time_s: Float[NDArray, "n"]
    source_mac: UInt8[NDArray, "n 6"]
    frame_counter: UInt32[NDArray, "n"]
    rssi_db: UInt8[NDArray, "n 3"]
    noise_dbm: Int[NDArray, "n"]
    agc_db: UInt8[NDArray, "n"]
    channel: Complex[NDArray, "n antennas 30"]
    unsorted_packets: int
    zero_packets: int
    other_records: int
    cut_bytes: int
    padding_bytes: int

    @property
    def senders(self) -> tuple[str, ...]:
        """MAC addresses that occur, most packets first."""
        macs, counts = np.unique(self.source_mac, axis=0, return_counts=True)
        return tuple(macs[i].tobytes().hex(":") for i in np.argsort(-counts, kind="stable"))

    def rss_dbm(self) -> Float[NDArray, "n"]:
        """Power received over all chains that were on: the tool's 10 log10 Σ 10^(RSSI/10) - 44 - AGC."""
        on = np.where(self.rssi_db > 0, 10.0 ** (self.rssi_db / 10.0), 0.0).sum(1)
        level = 10 * np.log10(np.maximum(on, 1e-30))
        return np.asarray(np.where(on > 0, level - 44.0 - self.agc_db, -np.inf))

    def track(self, peer: str, mac: str, carrier_hz: float = CHANNEL_108_HZ) -> CsiTrack:
        """The packets of one sender.

        Args:
            peer: Name the track shall carry.
            mac: Address of the sender, e.g. "00:21:6A:3F:17:5A".
            carrier_hz: Centre of the 20 MHz channel, which the card does not record.

        Raises:
            InputError: The address is malformed or sent nothing, or all it sent is zero.
        """
        try:
            wanted = np.frombuffer(bytes.fromhex(mac.replace(":", "")), np.uint8)
        except ValueError:
            wanted = np.empty(0, np.uint8)
        if len(wanted) != 6:
            raise InputError(self.path, "MAC", f"{mac!r} is no address", "write six hexadecimal bytes")
        rows = np.flatnonzero((self.source_mac == wanted).all(1))
        if len(rows) == 0:
            raise InputError(
                self.path,
                "source MAC",
                f"{mac.lower()} ({peer}) sent no packet, only {', '.join(self.senders)} did",
                "check the address",
            )
        if not self.channel[rows].any():
            raise InputError(
                self.path, "CSI", f"every packet of {peer} is zero", "check the receiver's cable"
            )
        return CsiTrack(
            peer,
            self.time_s[rows],
            self.frame_counter[rows],
            self.channel[rows],
            subcarriers_hz(carrier_hz),
        )


@dataclass(frozen=True)
class _Chain:
    """Where the CSI records of a file begin (at their payload) and how long the payload is."""

    start: NDArray
    length: NDArray
    other_records: int
    cut_bytes: int
    padding_bytes: int


def read_intel5300(path: Path) -> Intel5300Packets:
    """All packets of one .dat file.

    A last record that was cut off, and zeros after the last record, are left out and counted; nothing else is
    forgiven.

    Raises:
        InputError: The file cannot be read, is another card's, holds no channel state, or a record is malformed:
            impossible antenna numbers, a length that does not fit them, unknown codes, or most packets zero.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_FILE_BYTES + 1)
    except OSError as fault:
        raise InputError(
            path, "file", f"cannot be read ({fault})", "check the path and permissions"
        ) from fault
    if len(data) > MAX_FILE_BYTES:
        raise InputError(path, "file", f"is larger than {MAX_FILE_BYTES} bytes", "split the recording")
    chain = _walk(path, data)
    header, original = _headers(path, data, chain)
    channel, unsorted = _channels(path, data, chain, header, original)
    zero = int((~channel.any((1, 2))).sum())
    if 2 * zero > len(channel):
        raise InputError(
            path,
            "CSI",
            f"{zero} of {len(channel)} packets are zero",
            "check the antenna cable and the driver",
        )
    return Intel5300Packets(
        path=path,
        nic_time_us=header["nic_us"].copy(),
        time_s=_host_time(path, header, original),
        source_mac=np.zeros((len(header), 6), np.uint8) if original else header["mac"].copy(),
        frame_counter=(header["count"] if original else header["frame_counter"]).astype(np.uint32),
        rssi_db=header["rssi"].copy(),
        noise_dbm=header["noise"].astype(np.int64),
        agc_db=header["agc"].copy(),
        channel=channel,
        unsorted_packets=unsorted,
        zero_packets=zero,
        other_records=chain.other_records,
        cut_bytes=chain.cut_bytes,
        padding_bytes=chain.padding_bytes,
    )


def _walk(path: Path, data: bytes) -> _Chain:
    """Follow the chain of records from the first byte to the last."""
    starts, lengths, other, unknown = [], [], 0, []
    position, size, cut, padding = 0, len(data), 0, 0
    while position < size:
        left = size - position
        length = struct.unpack_from(">H", data, position)[0] if left >= 2 else 0
        if length == 0:
            if data.count(0, position) != left:
                if left < 2:
                    cut = left
                    break
                raise _malformed(path, data, position, "length", "is zero although bytes follow")
            padding = left
            break
        if length > _LONGEST_RECORD:
            raise _malformed(path, data, position, "length", f"is {length}, longer than any record")
        code = data[position + 2] if left >= 3 else INTEL_CSI_CODE
        if length + 2 > left:
            cut = left
            break
        if code == INTEL_CSI_CODE:
            starts.append(position + 3)
            lengths.append(length - 1)
        else:
            other += 1
            if code not in _OTHER_CODES:
                unknown.append((position, code))
        position += 2 + length
    if len(unknown) > _MOST_UNKNOWN * (len(starts) + other):
        at, code = unknown[0]
        raise _malformed(path, data, at, "code", f"is {code}, unknown ({len(unknown)} such records)")
    if not starts:
        raise _malformed(path, data, 0, "records", f"none of {other} carries channel state (code 187)")
    return _Chain(np.array(starts), np.array(lengths), other, cut, padding)


def _headers(path: Path, data: bytes, chain: _Chain) -> tuple[NDArray, bool]:
    """Header of every CSI record, and whether they are the original tool's short ones."""
    if (short := np.flatnonzero(chain.length < _ORIGINAL_HEADER)).size:
        at = int(chain.start[short[0]])
        raise _malformed(
            path, data, at - 3, "length", f"leaves {chain.length[short[0]]} bytes, too few for a header"
        )
    buffer = np.frombuffer(data + bytes(_WSR_HEADER), np.uint8)
    header = buffer[chain.start[:, None] + np.arange(_WSR_HEADER)].view(_HEADER)[:, 0]
    bad = (header["nrx"] < 1) | (header["nrx"] > 3) | (header["ntx"] < 1) | (header["ntx"] > 3)
    _refuse(
        path, data, chain, bad, "Nrx, Ntx", lambda k: f"are {header['nrx'][k]}, {header['ntx'][k]}, not 1..3"
    )
    streams = header["nrx"].astype(int) * header["ntx"]
    wanted = (_SUBCARRIERS * (16 * streams + 3) + 7) // 8
    _refuse(
        path,
        data,
        chain,
        header["length"] != wanted,
        "CSI length",
        lambda k: f"is {header['length'][k]} instead of {wanted[k]} bytes for {streams[k]} streams",
    )
    own = chain.length - wanted
    original = bool(own[0] == _ORIGINAL_HEADER)
    expected = _ORIGINAL_HEADER if original else _WSR_HEADER
    _refuse(
        path,
        data,
        chain,
        own != expected,
        "length",
        lambda k: f"leaves {own[k]} bytes for the header instead of {expected}",
    )
    _refuse(
        path,
        data,
        chain,
        header["nrx"] != header["nrx"][0],
        "Nrx",
        lambda k: f"changes from {header['nrx'][0]} to {header['nrx'][k]} within the file",
    )
    return header, original


def _channels(
    path: Path, data: bytes, chain: _Chain, header: NDArray, original: bool
) -> tuple[Complex[NDArray, "n antennas 30"], int]:
    """Unpack the bits and put RF chains into the order of the antenna connectors."""
    buffer = np.frombuffer(data, np.uint8)
    nrx = int(header["nrx"][0])
    channel = np.empty((len(header), nrx, _SUBCARRIERS), np.complex64)
    first = chain.start + (_ORIGINAL_HEADER if original else _WSR_HEADER)
    for ntx in np.unique(header["ntx"]):
        rows = np.flatnonzero(header["ntx"] == ntx)
        payload = buffer[first[rows, None] + np.arange(header["length"][rows[0]])]
        channel[rows] = _unpack(payload, nrx, int(ntx))
    # bits 0-1, 2-3, 4-5 of antenna_sel name the connector of chains A, B, C
    order = (header["antenna_sel"][:, None] >> np.array([0, 2, 4], np.uint8)[:nrx]) & 3
    valid = (np.sort(order, 1) == np.arange(nrx)).all(1)
    sorted_rows = np.flatnonzero(valid)
    sorted_channel = channel.copy()
    sorted_channel[sorted_rows[:, None], order[sorted_rows]] = channel[sorted_rows]
    return sorted_channel, int((~valid).sum())


def _unpack(payload: UInt[NDArray, "n bytes"], nrx: int, ntx: int) -> Complex[NDArray, "n antennas 30"]:
    """First spatial stream at every antenna."""
    k, antenna = np.arange(_SUBCARRIERS), np.arange(nrx) * ntx
    bit = 3 * (k + 1) + 16 * nrx * ntx * k + 16 * antenna[:, None]
    bit = bit[..., None] + np.array([0, 8])
    low, shift = bit >> 3, (bit & 7).astype(np.uint16)
    high = np.minimum(low + 1, payload.shape[1] - 1)
    wide = payload[:, low].astype(np.uint16) | (payload[:, high].astype(np.uint16) << 8)
    parts = (wide >> shift).astype(np.uint8).view(np.int8).astype(np.float32)
    return np.ascontiguousarray(parts).view(np.complex64)[..., 0]


def _host_time(path: Path, header: NDArray, original: bool) -> Float[NDArray, "n"]:
    if original:
        step_us = np.diff(header["nic_us"].astype(np.int64)) % 2**32
        return np.concatenate([[0.0], np.cumsum(step_us)]) * 1e-6 + float(header["nic_us"][0]) * 1e-6
    bad = np.flatnonzero(header["tv_usec"] >= 1_000_000)
    if len(bad):
        raise InputError(
            path,
            "tv_usec",
            f"is {header['tv_usec'][bad[0]]} in packet {bad[0]}, more than a second",
            _REMEDY,
        )
    return header["tv_sec"].astype(float) + header["tv_usec"] * 1e-6


def _refuse(path: Path, data: bytes, chain: _Chain, bad: NDArray, field: str, words) -> None:  # noqa: ANN001
    if bad.any():
        k = int(np.argmax(bad))
        raise _malformed(path, data, int(chain.start[k]) - 3, field, words(k))


def _malformed(path: Path, data: bytes, position: int, field: str, problem: str) -> InputError:
    if position == 0:
        problem += f"; the file {describe_header(data[:HEADER_BYTES])}"
    return InputError(path, field, f"of the record at byte {position} {problem}", _REMEDY)
