"""Blender talks on standard output: importers, Cycles, Python tracebacks of add-ons. A tool that prints JSON cannot."""

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
    """Everything that C or Python code prints in this block to standard output or error is thrown away.

    Where the process has no standard streams (a windowed Windows program) there is nothing to hold back. Not for
    threads that print meanwhile.
    """
    sink = _open_null()
    try:
        kept = [os.dup(1), os.dup(2)]
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
        for descriptor, stream in zip(kept, (1, 2), strict=True):
            os.dup2(descriptor, stream)
            os.close(descriptor)


@cache
def _open_null() -> TextIO:
    """Never closed: the glTF importer's log handlers keep the stream that they found."""
    return open(os.devnull, "w", encoding="utf-8")


def _flush_streams() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            with suppress(OSError, ValueError):
                stream.flush()
    # C's own buffers: what printf holds back would otherwise appear after the block.
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)
