"""Work on both cores: what is called lets go of the interpreter while it computes."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable


def cores() -> int:
    """That this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def in_halves(work: Callable[[int, int], None], count: int, least: int) -> None:
    """work(first, last) for all of 0 … count, the later half in a thread of its own where there is another core and
    either half is `least` or more. Raises what either raises, when both have ended."""
    middle = (count + 1) // 2
    if count - middle < least or cores() < 2:
        work(0, count)
        return
    failed: list[BaseException] = []

    def rest() -> None:
        try:
            work(middle, count)
        except BaseException as error:  # told by the thread that asked
            failed.append(error)

    beside = threading.Thread(target=rest, name="hnf-half", daemon=True)
    beside.start()
    try:
        work(0, middle)
    finally:
        beside.join()
    if failed:
        raise failed[0]
