"""Grey and colour PNG images, without a library of images (W3C, "Portable Network Graphics", 3rd edition)."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

GREY, TRUECOLOUR = 0, 2
"""Colour types of the header."""


def encode_grey_png(pixels: NDArray[np.uint8]) -> bytes:
    """The file of (H, W) uint8 values, row by row from the top; equal pixels give equal bytes with one zlib."""
    return _encode_png(pixels, GREY)


def encode_grey16_png(pixels: NDArray[np.uint16]) -> bytes:
    """The same of (H, W) uint16 values, all 16 bits kept."""
    return _encode_png(np.asarray(pixels, dtype=">u2"), GREY, 16)


def encode_colour_png(pixels: NDArray[np.uint8]) -> bytes:
    """The same of (H, W, 3) uint8 sRGB values."""
    return _encode_png(pixels, TRUECOLOUR)


def _encode_png(pixels: NDArray[np.unsignedinteger[Any]], colour_type: int, bits: int = 8) -> bytes:
    height, width = pixels.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in np.ascontiguousarray(pixels))  # filter 0: as they are
    head = struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(_encode_chunk(tag, body) for tag, body in chunks)


def _encode_chunk(tag: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + tag + body + struct.pack(">I", zlib.crc32(tag + body))
