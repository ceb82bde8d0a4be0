"""The checksum of the wire: CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, most significant bit first, nothing
inverted; check value 0x29B1). Listed as CRC-16/IBM-3740 in G. Cook's catalogue of parametrised CRC algorithms."""

from __future__ import annotations

import binascii

CRC_START = 0xFFFF
CRC_POLYNOMIAL = 0x1021


def crc16(data: bytes) -> int:
    """0 … 0xFFFF. Python's own crc_hqx is this polynomial with a start of one's choice."""
    return binascii.crc_hqx(data, CRC_START)


def crc16_reference(data: bytes) -> int:
    """The same, bit by bit, as firmware without a table would do it."""
    crc = CRC_START
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ CRC_POLYNOMIAL if crc & 0x8000 else crc << 1
            crc &= 0xFFFF
    return crc
