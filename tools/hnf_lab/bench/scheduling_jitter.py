"""How often the machine itself stood still: on each core a program wakes every millisecond, above all that streams.

What keeps it from waking is no program but the host of a virtual machine, or the kernel: no stream can do anything
about that, and its underruns should be read beside it.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from hnf_core.actuators.runtime import REALTIME_PRIORITY
from hnf_lab import CHILD_PATH, ROOT

MIN_STALL_S = 0.004
"""What is shorter counts for nothing: a stream has more than that in hand."""
_SLEEP_S = 0.001
_MAX_EXIT_S = 10.0


class StallLog:
    """lengths_s: of each, on all cores, once the watch has ended. watched: False where this system grants no such
    program (then there are none to tell of)."""

    def __init__(self) -> None:
        self.lengths_s: list[float] = []
        self.watched = False

    def __str__(self) -> str:
        if not self.watched:
            return "whether the machine stood still is not known"
        most = f", {1e3 * max(self.lengths_s):.0f} ms at most" if self.lengths_s else ""
        return f"the machine stood still {len(self.lengths_s)} times for {1e3 * MIN_STALL_S:.0f} ms or more{most}"


@contextmanager
def watch_stalls() -> Iterator[StallLog]:
    """Watched from here to the end of the block, on every core that this process may use."""
    found = StallLog()
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    children = [start_watcher(core) for core in cores]
    try:
        yield found
    finally:
        told = [stop_watcher(child) for child in children]
        found.watched = bool(told) and all(each is not None for each in told)
        found.lengths_s = [length for each in told for length in each or ()]


def start_watcher(core: int) -> subprocess.Popen[str]:
    """A program that watches one core from now on, to be given to ended()."""
    child = subprocess.Popen(
        [sys.executable, "-m", __spec__.name, str(core)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": CHILD_PATH},
        cwd=ROOT,
    )  # fmt: skip
    assert child.stdout is not None
    child.stdout.readline()  # so that its start is over before anything streams
    return child


def stop_watcher(child: subprocess.Popen[str]) -> list[float] | None:
    """The lengths [s] that a watcher saw, which leaves; None where it could not watch."""
    try:
        said, _ = child.communicate(timeout=_MAX_EXIT_S)  # its input ends: it tells and leaves
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()
        return None
    return [float(each) for each in json.loads(said)] if child.returncode == 0 else None


def _record_stalls(core: int) -> list[float] | None:
    try:
        os.sched_setaffinity(0, {core})
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(2 * REALTIME_PRIORITY))
    except OSError:
        return None
    lengths, over = list[float](), False
    print("watching", flush=True)
    before = time.monotonic()
    while not over:  # no second thread: this one would wait for it
        over = bool(select.select([sys.stdin], [], [], _SLEEP_S)[0])
        now = time.monotonic()
        if now - before - _SLEEP_S >= MIN_STALL_S:
            lengths.append(now - before - _SLEEP_S)
        before = now
    return lengths


if __name__ == "__main__":
    seen = _record_stalls(int(sys.argv[1]))
    if seen is None:
        sys.exit(1)
    print(json.dumps(seen))
