"""Channel state of Intel 5300 cards from .dat files of the Linux 802.11n CSI Tool and the WSR toolbox.

A file is a chain of records: uint16 length L (big-endian), uint8 code, L - 1 bytes. Code 187 carries channel
state: a header of 38 bytes (WSR toolbox; 20 in the original tool, which records neither host time, sender nor
frame counter), then for each of 30 subcarriers 3 bits to skip and int8 pairs (real, imaginary), lowest bit
first. Sources: Halperin et al., "Tool Release: Gathering 802.11n Traces with Channel State Information",
2011; Jadhav et al., "A Wireless Signal-Based Sensing Framework for Robotics", IJRR 2022.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float, Int, UInt8, UInt32
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import CsiTrack
from mulan.wireless.recordings.intel5300_chain import RecordChain, walk_records

CHANNEL_108_HZ = 5.54e9
SUBCARRIER_SPACING_HZ = 312_500.0
SUBCARRIER_INDEX = np.array([*range(-28, 0, 2), -1, *range(1, 28, 2), 28])  # 802.11n, 20 MHz, grouping 2
MAX_FILE_BYTES = 2**30

_Channel = Complex[NDArray, "n antennas 30"]
_SUBCARRIERS = len(SUBCARRIER_INDEX)
_ORIGINAL_HEADER, _WSR_HEADER = 20, 38
_FIELDS = {
    "nic_us": ("<u4", 0),
    "count": ("<u2", 4),
    "nrx": ("u1", 8),
    "ntx": ("u1", 9),
    "rssi": ("(3,)u1", 10),
    "noise": ("i1", 13),
    "agc": ("u1", 14),
    "antenna_sel": ("u1", 15),
    "length": ("<u2", 16),
    "rate": ("<u2", 18),
    "tv_sec": ("<u4", 20),
    "tv_usec": ("<u4", 24),
    "mac": ("(6,)u1", 28),
    "frame_counter": ("<u4", 34),
}
_HEADER = np.dtype(
    {
        "names": list(_FIELDS),
        "formats": [kind for kind, _ in _FIELDS.values()],
        "offsets": [offset for _, offset in _FIELDS.values()],
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
        frame_counter: Shared by a packet and its reply; the driver's own count where the tool recorded none.
        rssi_db: RSSI of RF chains A, B, C as reported; zero where a chain was off.
        noise_dbm: As reported.
        agc_db: Gain of the receiver.
        channel: Card units (integers, not scaled to power), by antenna connector; the first spatial stream.
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


def read_intel5300(path: Path) -> Intel5300Packets:
    """All packets of one .dat file.

    A last record that was cut off, and zeros after the last record, are left out and counted; nothing else is
    forgiven.

    Raises:
        InputError: The file cannot be read, is another card's, holds no channel state, a record is malformed
            (impossible antenna numbers, a length that does not fit, unknown codes), or most packets are zero.
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
    chain = walk_records(path, data)
    header, original = _headers(chain)
    channel, unsorted = _channels(
        chain, header, chain.start + (_ORIGINAL_HEADER if original else _WSR_HEADER)
    )
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
        time_s=_card_time(header["nic_us"]) if original else header["tv_sec"] + header["tv_usec"] * 1e-6,
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


def _headers(chain: RecordChain) -> tuple[NDArray, bool]:
    """Header of every record, and whether they are the original tool's short ones."""
    chain.refuse(
        chain.length < _ORIGINAL_HEADER, "length", "leaves {} bytes, too few for a header", chain.length
    )
    buffer = np.frombuffer(chain.data + bytes(_WSR_HEADER), np.uint8)
    header = buffer[chain.start[:, None] + np.arange(_WSR_HEADER)].view(_HEADER)[:, 0]
    nrx, ntx, length = header["nrx"], header["ntx"], header["length"]
    bad = (nrx < 1) | (nrx > 3) | (ntx < 1) | (ntx > 3)
    chain.refuse(bad, "Nrx, Ntx", "are {}, {} instead of 1 to 3", nrx, ntx)
    streams = nrx.astype(int) * ntx
    wanted = (_SUBCARRIERS * (16 * streams + 3) + 7) // 8
    chain.refuse(
        length != wanted, "CSI length", "is {} instead of {} for {} streams", length, wanted, streams
    )
    left = chain.length - wanted
    original = bool(left[0] == _ORIGINAL_HEADER)
    expected = np.full(len(left), _ORIGINAL_HEADER if original else _WSR_HEADER)
    chain.refuse(left != expected, "length", "leaves {} bytes for the header instead of {}", left, expected)
    chain.refuse(nrx != nrx[0], "Nrx", "is {}, not that of the first record", nrx)
    if not original:
        late = header["tv_usec"] >= 1_000_000
        chain.refuse(late, "tv_usec", "is {}, more than a second", header["tv_usec"])
    return header, original


def _channels(chain: RecordChain, header: NDArray, first: Int[NDArray, "n"]) -> tuple[_Channel, int]:
    """Unpack the bits and put RF chains into the order of the antenna connectors."""
    buffer = np.frombuffer(chain.data, np.uint8)
    nrx = int(header["nrx"][0])
    # bits 0-1, 2-3, 4-5 of antenna_sel name the connector of chains A, B, C
    order = (header["antenna_sel"][:, None] >> np.array([0, 2, 4], np.uint8)[:nrx]) & 3
    valid = (np.sort(order, 1) == np.arange(nrx)).all(1)
    order[~valid] = np.arange(nrx)
    channel = np.empty((len(header), nrx, _SUBCARRIERS), np.complex64)
    for ntx in np.unique(header["ntx"]):
        rows = np.flatnonzero(header["ntx"] == ntx)
        payload = buffer[first[rows, None] + np.arange(int(header["length"][rows[0]]))]
        channel[rows[:, None], order[rows]] = _unpack(payload, nrx, int(ntx))
    return channel, int((~valid).sum())


def _unpack(payload: UInt8[NDArray, "n bytes"], nrx: int, ntx: int) -> _Channel:
    """First spatial stream at every RF chain."""
    k = np.arange(_SUBCARRIERS)[:, None]
    bit = 3 * (k + 1) + 16 * ntx * (nrx * k + np.arange(nrx))
    low, shift = bit.T >> 3, (bit.T & 7).astype(np.uint32)
    by_byte = np.vstack([payload.T, np.zeros((1, len(payload)), np.uint8)]).astype(np.uint32)
    three = by_byte[low] | (by_byte[low + 1] << 8) | (by_byte[low + 2] << 16)
    three >>= shift[..., None]
    real, imaginary = (part.astype(np.uint8).view(np.int8) for part in (three, three >> 8))
    return np.moveaxis(real + np.complex64(1j) * imaginary, -1, 0)


def _card_time(nic_us: UInt32[NDArray, "n"]) -> Float[NDArray, "n"]:
    """The card's clock in seconds, its wraps undone."""
    steps_us = np.diff(nic_us.astype(np.int64)) % 2**32
    return (int(nic_us[0]) + np.concatenate([[0], np.cumsum(steps_us)])) * 1e-6
