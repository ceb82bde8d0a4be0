"""Work on several cores with plain threads, and a lock of OpenBLAS to one thread.

The work releases the interpreter lock while it computes. OpenBLAS's own threads are switched off meanwhile, since in
small products they only wait for each other: synthesising ten seconds of noise carriers takes 0.21 s with them and 0.08
s without, on two cores.
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

from .progress import add_work


def available_cpus() -> int:
    """Return the number of CPU cores that this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def run_in_thread(work: Callable[[], None]) -> Callable[[], None]:
    """Start ``work()`` in a new thread; return a function that waits for its end and raises what it raised.

    `threading.Thread` is not used: its start and join cost 0.2 ms each.
    """
    add_work("threads")
    errors: list[BaseException] = []
    running = threading.Lock()
    running.acquire()

    def run() -> None:
        try:
            work()
        except BaseException as error:  # raised again by wait()
            errors.append(error)
        finally:
            running.release()

    def wait() -> None:
        running.acquire()
        if errors:
            raise errors[0]

    _thread.start_new_thread(run, ())
    return wait


def parallel_for(work: Callable[[int, int], None], count: int, min_size: int) -> None:
    """Call ``work(first, last)`` for consecutive ranges of 0 … count, in parallel.

    Parameters
    ----------
    work : callable
        Function of the first index of a range and the index after its last.
    count : int
        Number of items.
    min_size : int
        Least number of items in a range.

    Notes
    -----
    There are as many ranges as cores, or fewer if they would be shorter than `min_size`. If a range raises an
    exception, it is raised again when all ranges that were started have ended.
    """
    parts = max(min(count // min_size, available_cpus()), 1)
    edges = [part * count // parts for part in range(parts + 1)]
    with ExitStack() as waits:  # also waits if a thread cannot be started: earlier ones write into shared arrays
        for first, last in pairwise(edges[1:]):
            waits.callback(run_in_thread(partial(work, first, last)))
        work(0, edges[1])


SYMBOL_PREFIXES, SYMBOL_SUFFIXES = ("", "scipy_"), ("", "64_")
"""Prefixes and suffixes of OpenBLAS's function names in numpy's wheels, which changed over the years."""

_blas_lock = threading.Lock()
_blas_users = 0
_blas_threads_before = 1


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Limit the OpenBLAS of numpy's wheels to one thread, in the whole process, while the context lasts.

    The last context that ends restores the earlier number. Another BLAS (macOS's own, a distribution's) is left as it
    is.
    """
    global _blas_users, _blas_threads_before
    functions = find_openblas_threads()
    if functions is None:
        yield
        return
    get_count, set_count = functions
    with _blas_lock:
        if _blas_users == 0:
            _blas_threads_before = get_count()
            set_count(1)
        _blas_users += 1
    try:
        yield
    finally:
        with _blas_lock:
            _blas_users -= 1
            if _blas_users == 0:
                set_count(_blas_threads_before)


@lru_cache(maxsize=1)
def find_openblas_threads() -> tuple[Callable[[], int], Callable[[int], None]] | None:
    """Return the functions that get and set the thread count of numpy's OpenBLAS, or None if there is none."""
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
                    get_count, set_count = library[name.format("get")], library[name.format("set")]
                    get_count.restype, get_count.argtypes = ctypes.c_int, []
                    set_count.restype, set_count.argtypes = None, [ctypes.c_int]
                    return get_count, set_count
    return None
