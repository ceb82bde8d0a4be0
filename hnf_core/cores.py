"""Work on both cores: what is called lets go of the interpreter while it computes."""

from __future__ import annotations

import _thread
import os
import threading
from collections.abc import Callable


def cores() -> int:
    """That this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def beside(work: Callable[[], None]) -> Callable[[], None]:
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


def in_halves(work: Callable[[int, int], None], count: int, least: int) -> None:
    """work(first, last) for all of 0 … count, the later half beside the earlier one where there is another core and
    either half is `least` or more. Raises what either raises, when both have ended."""
    middle = (count + 1) // 2
    if count - middle < least or cores() < 2:
        work(0, count)
        return
    wait = beside(lambda: work(middle, count))
    try:
        work(0, middle)
    finally:
        wait()
