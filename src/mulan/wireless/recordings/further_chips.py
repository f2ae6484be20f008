"""Channel state of any supported card's file, its writer told by the header.

Intel 5300 files go to our own reader. Atheros and Broadcom (nexmon) files go to csiread (MIT), an extra:
``pip install mulan[csi]``. csiread trusts lengths in the file and would read past its buffers, so each is
checked before.
"""

import struct
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import CsiTrack
from mulan.wireless.recordings.chip import HEADER_BYTES, Chip, chip_of_header, describe_header
from mulan.wireless.recordings.intel5300 import (
    CHANNEL_108_HZ,
    MAX_FILE_BYTES,
    SUBCARRIER_SPACING_HZ,
    read_intel5300,
)

BroadcomChip = Literal["4339", "43455c0", "4358", "4366c0"]

_REMEDY = "record again, or copy the file again if it was damaged"
_ATHEROS_HEADER = 25
_ATHEROS_LONGEST_PAYLOAD = 4000
_PCAP_HEADER, _PACKET_HEADER, _ETHERNET_IP_UDP, _NEXMON_HEADER = 24, 16, 42, 18
_EDGE = {56: (1, 28), 114: (2, 58), 64: (1, 28), 128: (2, 58), 256: (2, 122)}  # used subcarriers, 802.11n/ac


@dataclass(frozen=True)
class CsiFileOptions:
    """What a file of channel state does not say of itself."""

    peer: str = "peer"
    """Name of the robot that sent the packets."""
    mac: str | None = None
    """Address of its card; needed if several cards sent."""
    carrier_hz: float | None = None
    """Centre of the channel; if not given, channel 108 for Intel, what is recorded for Atheros at 20 MHz."""
    broadcom_chip: BroadcomChip = "43455c0"
    """Chip that nexmon ran on; 43455c0 is the Raspberry Pi's."""


def read_csi_file(path: Path, options: CsiFileOptions) -> CsiTrack:
    """Packets of one sender from a file of any supported card.

    Atheros files carry neither sender nor counter: every packet is taken and the counter is zero, so that
    pairing goes by time. Of Broadcom files the first core and spatial stream are taken; the counter is the
    802.11 sequence field.

    Raises:
        InputError: The header is no known card's, the card is known but not supported, csiread is not
            installed, or the file is malformed.
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
    match chip_of_header(data[:HEADER_BYTES]):
        case Chip.INTEL5300:
            return _intel5300(path, options)
        case Chip.ATHEROS:
            return _atheros(path, data, options)
        case Chip.NEXMON:
            return _nexmon(path, data, options)
        case Chip.WSR_NPZ:
            raise InputError(path, "header", "is a decoded run with several links", "use read_wsr_run")
        case known:
            supported = "; ".join(c.value for c in (Chip.INTEL5300, Chip.ATHEROS, Chip.NEXMON))
            told = describe_header(data[:HEADER_BYTES]) + (", which is not supported" if known else "")
            raise InputError(path, "header", told, f"record with a supported card: {supported}")


def _csiread(path: Path) -> ModuleType:
    try:
        return import_module("csiread")
    except ImportError as fault:
        raise InputError(
            path, "header", "needs the package csiread", "install it: pip install 'mulan[csi]'"
        ) from fault


def _intel5300(path: Path, options: CsiFileOptions) -> CsiTrack:
    packets = read_intel5300(path)
    senders = list(packets.senders)
    if options.mac is None and len(senders) > 1:
        raise InputError(path, "source MAC", f"is {', '.join(senders)}", "choose one by the option mac")
    carrier_hz = CHANNEL_108_HZ if options.carrier_hz is None else options.carrier_hz
    return packets.track(options.peer, options.mac or senders[0], carrier_hz)


def _fault(path: Path, position: int, field: str, problem: str) -> InputError:
    return InputError(path, field, f"of the record at byte {position} {problem}", _REMEDY)


def _track(
    path: Path,
    options: CsiFileOptions,
    time_s: Float[NDArray, "n"],
    counter: NDArray,
    channel: Complex[NDArray, "n antennas tones"],
    carrier_hz: float | None,
) -> CsiTrack:
    tones = channel.shape[2]
    if carrier_hz is None:
        raise InputError(path, "carrier_hz", "is not in the file", "give the centre of the channel")
    inner, outer = _EDGE[tones]
    index = np.r_[-outer : -inner + 1, inner : outer + 1]
    if tones in (64, 128, 256):  # a whole FFT: leave out the guard bands and the middle
        channel = channel[:, :, index + tones // 2]
    zero = int((~channel.any((1, 2))).sum())
    if 2 * zero > len(channel) or not np.isfinite(channel).all():
        found = f"{zero} of {len(channel)} packets are zero" if zero else "some packets are not finite"
        raise InputError(path, "CSI", found, "check the antenna cable and the driver")
    hz = carrier_hz + SUBCARRIER_SPACING_HZ * index
    return CsiTrack(options.peer, time_s, counter.astype(np.uint32), channel.astype(np.complex64), hz)


def _atheros(path: Path, data: bytes, options: CsiFileOptions) -> CsiTrack:
    endian, count, tones, nrx, ntx, empty = _check_atheros(path, data)
    packets = _csiread(path).Atheros(
        str(path), nrxnum=nrx, ntxnum=ntx, tones=tones, if_report=False, bufsize=count
    )
    packets.seek(str(path), 0, count, endian)
    full = ~empty
    carrier_hz = options.carrier_hz
    if carrier_hz is None and tones == 56:
        carrier_hz = float(packets.tx_channel[full][0]) * 1e6
    channel = packets.csi[full][:, :, :, 0].transpose(0, 2, 1)
    time_s = packets.timestamp[full].astype(np.uint64) * 1e-6
    return _track(path, options, time_s, np.zeros(len(time_s)), channel, carrier_hz)


def _check_atheros(path: Path, data: bytes) -> tuple[str, int, int, int, int, NDArray]:
    """Byte order, records, tones, antennas, streams and which records hold no channel."""
    endian = "little" if struct.unpack_from("<H", data)[0] <= struct.unpack_from(">H", data)[0] else "big"
    order = "<" if endian == "little" else ">"
    position, empty, shape = 0, [], None
    while position + 2 <= len(data):
        (length,) = struct.unpack_from(f"{order}H", data, position)
        if length < _ATHEROS_HEADER:
            raise _fault(path, position, "length", f"is {length}, too short for a header")
        if position + 2 + length > len(data):
            break  # cut
        csi_bytes = struct.unpack_from(f"{order}H", data, position + 10)[0]
        tones, nrx, ntx = data[position + 18 : position + 21]
        payload = struct.unpack_from(f"{order}H", data, position + 25)[0]
        if length != _ATHEROS_HEADER + csi_bytes + payload or payload > _ATHEROS_LONGEST_PAYLOAD:
            raise _fault(
                path, position, "length", f"is {length} for {csi_bytes} bytes of CSI and {payload} of payload"
            )
        empty.append(csi_bytes == 0)
        if csi_bytes:
            if tones not in (56, 114) or not (1 <= nrx <= 3 and 1 <= ntx <= 3):
                raise _fault(path, position, "tones, nr, nc", f"are {tones}, {nrx}, {ntx}")
            if csi_bytes != (tones * nrx * ntx * 20 + 7) // 8:
                raise _fault(path, position, "CSI length", f"is {csi_bytes} for {tones} x {nrx} x {ntx}")
            if shape is not None and shape != (tones, nrx, ntx):
                raise _fault(path, position, "tones, nr, nc", f"are {tones}, {nrx}, {ntx}, before {shape}")
            shape = (tones, nrx, ntx)
        elif nrx > 3 or ntx > 3:
            raise _fault(path, position, "nr, nc", f"are {nrx}, {ntx}")
        position += 2 + length
    if shape is None:
        raise InputError(path, "CSI", f"none of {len(empty)} records holds a channel", _REMEDY)
    return endian, len(empty), *shape, np.array(empty)


def _nexmon(path: Path, data: bytes, options: CsiFileOptions) -> CsiTrack:
    count, tones = _check_nexmon(path, data)
    packets = _csiread(path).Nexmon(
        str(path), chip=options.broadcom_chip, bw=tones * 5 // 16, if_report=False, bufsize=count
    )
    packets.seek(str(path), _PCAP_HEADER, count)
    senders = [bytes(row.astype(np.uint8)).hex(":") for row in packets.src_addr]
    mac = options.mac.lower() if options.mac else senders[0]
    if options.mac is None and len(set(senders)) > 1:
        raise InputError(
            path, "source MAC", f"is {', '.join(sorted(set(senders)))}", "choose one by the option mac"
        )
    of_sender = np.array([sender == mac for sender in senders])
    if not of_sender.any():
        raise InputError(path, "source MAC", f"{mac} sent no packet", "check the address")
    rows = of_sender & (packets.core == packets.core[of_sender].min()) & (packets.spatial == 0)
    if not rows.any():
        raise InputError(path, "spatial", "stream 0 is missing", _REMEDY)
    time_s = packets.sec[rows] + packets.usec[rows] * (1e-9 if packets.nano else 1e-6)
    channel = np.fft.fftshift(packets.csi[rows], 1)[:, None, :]
    return _track(path, options, time_s, packets.seq[rows], channel, options.carrier_hz)


def _check_nexmon(path: Path, data: bytes) -> tuple[int, int]:
    """Packets of nexmon before a cut end, and points of their FFT."""
    if data[:4] == b"\x0a\x0d\x0d\x0a":
        raise InputError(path, "header", "is pcapng", "save it as pcap (editcap -F pcap)")
    order = "<" if data[:4] in (b"\xd4\xc3\xb2\xa1", b"\x4d\x3c\xb2\xa1") else ">"
    position, count, tones = _PCAP_HEADER, 0, None
    while position + _PACKET_HEADER <= len(data):
        (captured,) = struct.unpack_from(f"{order}I", data, position + 8)
        if captured < _ETHERNET_IP_UDP or captured > 2**18:
            raise _fault(path, position, "captured length", f"is {captured}")
        body = position + _PACKET_HEADER
        if body + captured > len(data):
            break  # cut
        if data[body + 6 : body + 12] == b"NEXMON":
            points = (captured - _ETHERNET_IP_UDP - _NEXMON_HEADER) / 4
            if points not in (64, 128, 256) or (tones is not None and points != tones):
                raise _fault(path, position, "captured length", f"is {captured}, or {points} subcarriers")
            tones, count = int(points), count + 1
        position = body + captured
    if tones is None:
        raise InputError(path, "packets", "none is nexmon's", "capture with nexmon_csi")
    return count, tones
