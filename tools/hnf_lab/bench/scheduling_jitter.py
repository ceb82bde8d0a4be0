"""Measure how often the machine itself stalls: a high-priority process per core that wakes every millisecond.

Such stalls are caused by the kernel or the host of a virtual machine, so no stream can avoid them. Report them with the
underruns of a stream.
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
"""Shortest counted stall [s]; a stream has more than that in its buffer."""
_SLEEP_S = 0.001
_MAX_EXIT_S = 10.0


class StallLog:
    """Stalls during a measurement.

    Attributes
    ----------
    lengths_s
        Duration of each stall on all cores, set at the end of the measurement [s].
    watched
        False if the system does not permit the high-priority processes.
    """

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
    """Record stalls within the `with` block, on every core that this process may use."""
    log = StallLog()
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    children = [start_watcher(core) for core in cores]
    try:
        yield log
    finally:
        reports = [stop_watcher(child) for child in children]
        log.watched = bool(reports) and all(report is not None for report in reports)
        log.lengths_s = [length for report in reports for length in report or ()]


def start_watcher(core: int) -> subprocess.Popen[str]:
    """Start a process that watches one core; pass it to stop_watcher()."""
    child = subprocess.Popen(
        [sys.executable, "-m", __spec__.name, str(core)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": CHILD_PATH},
        cwd=ROOT,
    )  # fmt: skip
    assert child.stdout is not None
    child.stdout.readline()  # wait until it has started, before any stream does
    return child


def stop_watcher(child: subprocess.Popen[str]) -> list[float] | None:
    """Stop a watcher and return the stall durations [s], or None if it could not watch."""
    try:
        output, _ = child.communicate(timeout=_MAX_EXIT_S)  # closes its input: it reports and exits
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()
        return None
    return [float(length) for length in json.loads(output)] if child.returncode == 0 else None


def _record_stalls(core: int) -> list[float] | None:
    try:
        os.sched_setaffinity(0, {core})
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(2 * REALTIME_PRIORITY))
    except OSError:
        return None
    lengths, finished = list[float](), False
    print("watching", flush=True)
    before = time.monotonic()
    while not finished:  # a second thread would delay this one, so input is polled here
        finished = bool(select.select([sys.stdin], [], [], _SLEEP_S)[0])
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
