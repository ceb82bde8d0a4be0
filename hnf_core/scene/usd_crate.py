"""Check the table of contents of a binary USD file, whose numbers its library takes for how much memory to reserve."""

from __future__ import annotations

import struct
from pathlib import Path

from ..errors import make_damaged_error

MAGIC = b"PXR-USDC"
HEADER = struct.Struct("<8s8xq")
"""Magic, version and place of the table of contents."""
COUNT = struct.Struct("<Q")
SECTION = struct.Struct("<16sqq")
"""Name, start and size of a section."""
COUNTED = ("TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS")
"""Sections that begin with the number of their entries."""
MAX_ENTRIES_PER_BYTE = 1024
"""Entries take two bits at least, and their compression (LZ4) makes 255 bytes of one at most."""


def check_crate(path: Path) -> None:
    """Raise FileError if a binary USD file's table of contents promises more than the file has; others pass.

    A table of 300 million sections in a file of 6 kB costs 9 GB and half a minute before the library finds out.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(HEADER.size)
        if not head.startswith(MAGIC):
            return
        start = HEADER.unpack(head)[1] if len(head) == HEADER.size else -1
        if not HEADER.size <= start <= size - COUNT.size:
            raise make_damaged_error(path, "its table of contents lies outside of it")
        stream.seek(start)
        (count,) = COUNT.unpack(stream.read(COUNT.size))
        if count > (size - start - COUNT.size) // SECTION.size:
            raise make_damaged_error(path, f"its table of contents wants {count} sections, and has no place for them")
        for name, at, length in list(SECTION.iter_unpack(stream.read(count * SECTION.size))):
            section = name.rstrip(b"\0").decode("ascii", "replace")
            if min(at, length) < 0 or at + length > size:
                raise make_damaged_error(path, f"its section '{section}' lies outside of it")
            if section not in COUNTED:
                continue
            stream.seek(at)
            entries = int.from_bytes(stream.read(min(length, COUNT.size)), "little")
            if entries > MAX_ENTRIES_PER_BYTE * length:
                raise make_damaged_error(path, f"its section '{section}' of {length} bytes wants {entries} entries")
