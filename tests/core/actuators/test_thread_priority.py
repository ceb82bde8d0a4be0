"""Real-time priority: where the system grants it, it is so; where it does not, all goes on as before. Both are said."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from stream_sink import ClockSink

from hnf_core.actuators import runtime
from hnf_core.actuators.limits import Limits
from hnf_core.actuators.signal_chain import Samples, render_counts
from hnf_core.actuators.sink import Sink
from hnf_core.actuators.sinks.file import FileSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream

ROOT = Path(__file__).resolve().parents[3]
LIMITS = Limits(30.0, slew_per_s=2.0 * np.pi * 1000.0, sustained=0.3)
SIGNAL = np.random.default_rng(7).normal(0.0, 5.0, (2000, 1)).astype(np.float32)

linux = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="no real-time threads here")

_CHILD = "import os; print(os.sched_getscheduler(0))"
_DENIED = """
import json, os, resource, sys
sys.path[:0] = sys.argv[1:]
from test_thread_priority import played
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
if os.getuid() == 0:
    os.setresuid(65534, 65534, 65534)
print(json.dumps(played()))
"""


class Watched(BufferSource):
    """SIGNAL; policies: what the thread that reads it is scheduled by."""

    def __init__(self) -> None:
        super().__init__(SIGNAL, 10000.0)
        self.policies: set[int] = set()

    def read(self, frames: int) -> Samples:
        self.policies.add(os.sched_getscheduler(0))
        return super().read(frames)


def streamed(sink: Sink) -> tuple[Stream, set[int]]:
    source = Watched()
    with Stream(source, sink, LIMITS) as stream:
        stream.start()
        assert stream.wait(60.0)
    return stream, source.policies


def played() -> dict[str, object]:
    """What comes of a stream in this process, with the rights that it has."""
    sink = ClockSink()
    stream, policies = streamed(sink)
    report = stream.report
    return {
        "counts": sink.counts.ravel().tolist(),
        "policies": sorted(policies),
        "realtime": report.realtime,
        "problem": report.problem,
    }


def in_a_thread_of_its_own(work: object) -> object:
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(work).result()  # type: ignore[arg-type]


@linux
def test_it_says_whether_it_was_granted() -> None:
    def asked() -> tuple[bool, int, int]:
        return runtime.request_realtime_priority(), os.sched_getscheduler(0), os.sched_getparam(0).sched_priority

    granted, policy, priority = in_a_thread_of_its_own(asked)  # type: ignore[misc]
    if granted:
        assert (policy, priority) == (os.SCHED_RR | os.SCHED_RESET_ON_FORK, runtime.REALTIME_PRIORITY)
    else:
        assert (policy, priority) == (os.SCHED_OTHER, 0)
    assert os.sched_getscheduler(0) == os.SCHED_OTHER, "the thread that asked, and no other"


@linux
def test_neither_its_threads_nor_its_children_inherit_it() -> None:
    def asked() -> list[int]:
        runtime.request_realtime_priority()
        found: list[int] = []
        thread = threading.Thread(target=lambda: found.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
        child = subprocess.run([sys.executable, "-c", _CHILD], capture_output=True, text=True, check=True, timeout=60)
        return [*found, int(child.stdout)]

    assert in_a_thread_of_its_own(asked) == [os.SCHED_OTHER, os.SCHED_OTHER]


@linux
def test_a_stream_says_whether_its_threads_got_it() -> None:
    told = played()
    wanted = os.SCHED_RR | os.SCHED_RESET_ON_FORK if told["realtime"] else os.SCHED_OTHER
    assert told["policies"] == [wanted]
    assert told["realtime"] == in_a_thread_of_its_own(runtime.request_realtime_priority)


@linux
def test_denied_it_plays_the_same_bytes_and_says_so() -> None:
    words = [sys.executable, "-c", _DENIED, str(ROOT), str(Path(__file__).parent)]
    child = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert child.returncode == 0, child.stderr
    told = json.loads(child.stdout)
    assert told["realtime"] is False
    assert told["policies"] == [os.SCHED_OTHER]
    assert told["problem"] == ""
    here = played()
    assert told["counts"] == here["counts"]
    assert here["counts"] == render_counts(BufferSource(SIGNAL, 10000.0), ClockSink().format, LIMITS).ravel().tolist()


@linux
def test_what_waits_for_no_clock_asks_for_none(tmp_path: Path) -> None:
    stream, policies = streamed(FileSink(tmp_path / "wire.wav", 10000.0))
    assert policies == {os.SCHED_OTHER}
    assert stream.report.realtime is False
