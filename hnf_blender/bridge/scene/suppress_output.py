"""Silence standard output and error.

Importers, Cycles and add-ons print there, which would corrupt the JSON that a command-line tool prints.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import cache
from typing import TextIO


@contextmanager
def suppress_output() -> Iterator[None]:
    """Discard everything that C or Python code prints in the with block.

    Does nothing if the process has no standard streams (a windowed Windows program). Output of other threads is
    discarded too.
    """
    sink = _open_null()
    try:
        saved = [os.dup(1), os.dup(2)]
    except OSError:
        yield
        return
    _flush_streams()
    try:
        os.dup2(sink.fileno(), 1)
        os.dup2(sink.fileno(), 2)
        with redirect_stdout(sink), redirect_stderr(sink):
            yield
    finally:
        _flush_streams()
        for descriptor, stream in zip(saved, (1, 2), strict=True):
            os.dup2(descriptor, stream)
            os.close(descriptor)


@cache
def _open_null() -> TextIO:
    """Open the null device once and keep it open, as the glTF importer's log handlers keep the stream they found."""
    return open(os.devnull, "w", encoding="utf-8")


def _flush_streams() -> None:
    """Flush Python's and C's buffers of standard output and error."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            with suppress(OSError, ValueError):
                stream.flush()
    # Text in the buffers of C's printf would otherwise appear after the block.
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)
