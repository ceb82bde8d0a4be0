"""Stream bench: its comparison, its pacing and its rows. No time is asserted."""

from __future__ import annotations

import math
import os
import signal
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_lab.bench.harness import BenchOptions, run_with_peak
from hnf_lab.bench.scheduling_jitter import StallLog, start_watcher, stop_watcher, watch_stalls
from hnf_lab.bench.stream import STREAM_CASES, compute_difference_share, measure_stream, trim_silence
from hnf_lab.bench.virtual_device import PacedLine


@given(st.lists(st.tuples(st.floats(0.0, 0.01), st.binary(max_size=500)), max_size=30))
def test_a_line_passes_on_every_byte_in_order_and_none_too_early(sent: list[tuple[float, bytes]]) -> None:
    now = [5.0]
    paced = PacedLine(100_000, lambda: now[0])
    through = b""
    for wait_s, data in sent:
        now[0] += wait_s
        through += paced(data)
        assert len(through) <= math.ceil((now[0] - 5.0) * 10_000.0 + 1e-6)
    now[0] += 100.0
    assert through + paced(b"") == b"".join(data for _, data in sent)


def test_what_was_played_is_compared_from_sound_to_sound() -> None:
    counts = np.array([[0, 0], [0, 3], [0, 0], [5, 0], [0, 0]], dtype=np.int16)
    assert trim_silence(counts).tolist() == [[0, 3], [0, 0], [5, 0]]
    assert trim_silence(counts[:1]).shape == (0, 2)
    assert compute_difference_share(counts, counts.copy()) == 0.0
    other = counts.copy()
    other[2, 0] = 1
    assert compute_difference_share(counts, other) == pytest.approx(0.1)
    assert compute_difference_share(counts, counts[:-1]) == 1.0


def test_its_rows_come() -> None:
    pytest.importorskip("serial", reason="pyserial is not installed")
    told: list[str] = []
    found = measure_stream(BenchOptions(quick=True, watch=told.append), seconds=0.2)
    assert [row.method for row in found][:-1] == [case.method for case in STREAM_CASES]
    assert len(told) == len(found) == len(STREAM_CASES) + 1
    for row in found[:-1]:
        assert "underruns" in row.note
        assert "the machine stood still" in row.note
        assert row.error is not None
        assert (row.peak_mb is None) == (run_with_peak(list)[1] is None)  # where the system does not tell


def test_a_core_that_stands_still_is_seen() -> None:
    with watch_stalls() as found:
        pass
    if not found.watched:
        pytest.skip("no real-time priority on a core of one's own choice is granted here")
    child = start_watcher(min(os.sched_getaffinity(0)))
    time.sleep(0.1)
    child.send_signal(signal.SIGSTOP)
    time.sleep(0.05)
    child.send_signal(signal.SIGCONT)
    time.sleep(0.1)  # so that it sees it before it is told to leave
    told = stop_watcher(child)
    assert told is not None
    assert max(told) >= 0.03


def test_standstills_are_told_as_they_were_seen() -> None:
    seen = StallLog()
    assert str(seen) == "whether the machine stood still is not known"
    seen.watched = True
    assert str(seen) == "the machine stood still 0 times for 4 ms or more"
    seen.lengths_s = [0.005, 0.0121]
    assert str(seen) == "the machine stood still 2 times for 4 ms or more, 12 ms at most"
