"""Which card or tool wrote a file of channel state, told by its first bytes."""

import struct
from enum import Enum

HEADER_BYTES = 64
INTEL_CSI_CODE = 187
_PCAP_MAGICS = tuple(bytes.fromhex(m) for m in ("d4c3b2a1", "a1b2c3d4", "4d3cb2a1", "a1b23c4d", "0a0d0d0a"))
_PICOSCENES_MAGIC = bytes.fromhex("15031520")  # 0x20150315, little-endian, after the frame's length
_ATHEROS_HEADER_BYTES = 25
_ATHEROS_TONES = (56, 114)  # 20 and 40 MHz of 802.11n


class Chip(Enum):
    """Cards and tools whose files are told apart; the value is the name people know."""

    INTEL5300 = "Intel 5300 (.dat of the Linux 802.11n CSI Tool or the WSR toolbox)"
    ATHEROS = "Atheros ath9k (.dat of the Atheros CSI Tool)"
    NEXMON = "Broadcom (.pcap of nexmon_csi)"
    ESP32 = "ESP32 (.csv of the ESP32 CSI Tool)"
    PICOSCENES = "PicoScenes (.csi)"
    WSR_NPZ = "decoded WSR run (.npz)"


def chip_of_header(head: bytes) -> Chip | None:
    """The writer of a file that starts with these bytes, or None if no known one does.

    Args:
        head: The first ``HEADER_BYTES`` bytes, fewer if the file is shorter.
    """
    if head[:4] in _PCAP_MAGICS:
        return Chip.NEXMON
    if head[:4] == b"PK\x03\x04":
        return Chip.WSR_NPZ
    if head[4:8] == _PICOSCENES_MAGIC:
        return Chip.PICOSCENES
    if head.startswith((b"CSI_DATA,", b"type,role,mac,")):
        return Chip.ESP32
    if _is_intel5300(head):
        return Chip.INTEL5300
    if _is_atheros(head):
        return Chip.ATHEROS
    return None


def describe_header(head: bytes) -> str:
    """The header in words, for an error message."""
    chip = chip_of_header(head)
    if chip is not None:
        return f"looks like {chip.value}"
    if not head:
        return "is empty"
    return f"starts with the bytes {head[:16].hex(' ')}, which no known card writes"


def _is_intel5300(head: bytes) -> bool:
    if len(head) < 23:
        return False
    length, code = struct.unpack_from(">HB", head)
    csi_bytes = struct.unpack_from("<H", head, 3 + 16)[0]
    return code == INTEL_CSI_CODE and length in (1 + 20 + csi_bytes, 1 + 38 + csi_bytes)


def _is_atheros(head: bytes) -> bool:
    if len(head) < 2 + _ATHEROS_HEADER_BYTES:
        return False
    (length,) = struct.unpack_from(">H", head)
    tones, receivers, streams = head[18:21]
    return (
        length >= _ATHEROS_HEADER_BYTES
        and tones in _ATHEROS_TONES
        and 1 <= receivers <= 3
        and 1 <= streams <= 3
    )
