"""Work on both cores: what is called lets go of the interpreter while it computes.

One BLAS thread for a while: where views run in threads of our own, and in small products, OpenBLAS's threads only
wait for each other.

Measured on two cores: five views in 20 steps, 7.5 s of processor time with them, 1.9 s without; ten seconds of carriers
0.21 s and 0.08 s.
"""

from __future__ import annotations

import _thread
import ctypes
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np


def available_cpus() -> int:
    """That this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def run_in_thread(work: Callable[[], None]) -> Callable[[], None]:
    """Begin work() in a thread of its own. What is returned waits until it has ended, and raises what it raised.

    A threading.Thread would be waited for twice, until it has begun and until it is gone: 0.2 ms each time.
    """
    failed: list[BaseException] = []
    working = threading.Lock()
    working.acquire()

    def told() -> None:
        try:
            work()
        except BaseException as error:  # raised by who waits
            failed.append(error)
        finally:
            working.release()

    def wait() -> None:
        working.acquire()
        if failed:
            raise failed[0]

    _thread.start_new_thread(told, ())
    return wait


def parallel_for(work: Callable[[int, int], None], count: int, min_size: int) -> None:
    """work(first, last) for all of 0 … count, in as many parts of `least` or more as there are cores, side by side.
    Raises what one of them raises, when all that were begun have ended."""
    parts = max(min(count // min_size, available_cpus()), 1)
    edges = [part * count // parts for part in range(parts + 1)]
    with ExitStack() as ended:  # also where a thread cannot be begun: those before it write into what is ours
        for first, last in pairwise(edges[1:]):
            ended.callback(run_in_thread(partial(work, first, last)))
        work(0, edges[1])


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
