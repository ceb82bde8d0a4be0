"""Parallel work on several cores completes, and an error on one core is raised."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from hnf_core import threads as both_cores


@pytest.mark.parametrize(
    ("cores", "count", "threads"), [(1, 9, 1), (2, 9, 2), (2, 5, 1), (2, 0, 1), (3, 9, 3), (4, 9, 3), (3, 6, 2)]
)
def test_parts_are_all_of_it_and_tell_what_went_wrong(monkeypatch, cores, count, threads):
    monkeypatch.setattr(both_cores, "available_cpus", lambda: cores)
    done, at_once = np.zeros(count), []
    meeting = threading.Barrier(threads)

    def work(low, high):
        at_once.append(high - low)
        done[low:high] += 1.0
        meeting.wait(30.0)
        if high == 9 and count == 9 and failing:
            raise ValueError("the last part")

    failing = False
    both_cores.parallel_for(work, count, 3)
    assert (done == 1.0).all()
    assert len(at_once) == threads
    assert threads == 1 or min(at_once) >= 3
    failing = True
    if count == 9:
        with pytest.raises(ValueError, match="last part"):
            both_cores.parallel_for(work, count, 3)


def test_started_parts_finish_if_another_thread_cannot_start(monkeypatch):
    """They write into memory that is given back then."""
    begin, begun, ended = both_cores.run_in_thread, [], []

    def only_once(work):
        if begun:
            raise RuntimeError("can't start new thread")
        begun.append(work)
        return begin(work)

    def slowly(low, high):
        time.sleep(0.1)
        ended.append((low, high))

    monkeypatch.setattr(both_cores, "available_cpus", lambda: 3)
    monkeypatch.setattr(both_cores, "run_in_thread", only_once)
    with pytest.raises(RuntimeError, match="can't start"):
        both_cores.parallel_for(slowly, 9, 3)
    assert ended == [(3, 6)]
