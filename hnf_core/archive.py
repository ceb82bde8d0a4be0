"""What numpy raises of an archive of arrays (.npz) that is damaged: which one depends on the byte that was hit."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib

DAMAGED: tuple[type[Exception], ...] = (
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
