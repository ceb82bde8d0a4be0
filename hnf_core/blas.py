"""One BLAS thread for a while: where views run in threads of our own, and in small products, OpenBLAS's threads only
wait for each other.

Measured on two cores: five views in 20 steps, 7.5 s of processor time with them, 1.9 s without; ten seconds of carriers
0.21 s and 0.08 s.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import numpy as np

SYMBOL_PREFIXES, SYMBOL_SUFFIXES = ("", "scipy_"), ("", "64_")
"""Of OpenBLAS's names in numpy's wheels, which changed over the years."""

_blas_lock = threading.Lock()
_blas_users = 0
_blas_threads_before = 1


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Hold the OpenBLAS of numpy's wheels to one thread, in the whole process; whoever leaves last gives the others
    back. Another BLAS (macOS's own, a distribution's) is left as it is."""
    global _blas_users, _blas_threads_before
    found = find_openblas_threads()
    if found is None:
        yield
        return
    count, choose = found
    with _blas_lock:
        if _blas_users == 0:
            _blas_threads_before = count()
            choose(1)
        _blas_users += 1
    try:
        yield
    finally:
        with _blas_lock:
            _blas_users -= 1
            if _blas_users == 0:
                choose(_blas_threads_before)


@lru_cache(maxsize=1)
def find_openblas_threads() -> tuple[Callable[[], int], Callable[[int], None]] | None:
    """(how many threads, choose how many) of the OpenBLAS that numpy's wheel brought; None where there is none."""
    package = Path(np.__file__).parent
    for folder in (package.parent / "numpy.libs", package / ".dylibs"):
        for path in sorted(folder.glob("*openblas*")):
            try:
                library = ctypes.CDLL(str(path))
            except OSError:
                continue
            for name in (
                f"{prefix}openblas_{{}}_num_threads{suffix}" for prefix in SYMBOL_PREFIXES for suffix in SYMBOL_SUFFIXES
            ):
                if hasattr(library, name.format("get")) and hasattr(library, name.format("set")):
                    count, choose = library[name.format("get")], library[name.format("set")]
                    count.restype, count.argtypes = ctypes.c_int, []
                    choose.restype, choose.argtypes = None, [ctypes.c_int]
                    return count, choose
    return None
