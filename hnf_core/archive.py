"""Archives of arrays (.npz) that may be damaged: which error that raises depends on the byte that was hit."""

from __future__ import annotations

import io
import struct
import tokenize
import zipfile
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

NPZ_ERRORS: tuple[type[Exception], ...] = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    SyntaxError,  # of an array's header, which is a literal of Python; or, where that is not even words,
    tokenize.TokenError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)


def read_npz(data: bytes) -> dict[str, NDArray[Any]]:
    """All arrays of an archive by name, without pickle. Raises one of DAMAGED.

    Its last record counts the entries: a damaged length in the list of them swallows the next one, and zipfile does
    not miss it.
    """
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        found = {name: arrays[name] for name in arrays.files}
    if len(found) != int.from_bytes(data[-12:-10], "little"):
        raise zipfile.BadZipFile(f"it lists {len(found)} arrays of {int.from_bytes(data[-12:-10], 'little')}")
    return found
