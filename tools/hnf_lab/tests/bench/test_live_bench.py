"""Latencies that `hnf bench live` computes."""

import itertools

import numpy as np
import pytest

from hnf_core.actuators.live_source import EventTiming
from hnf_core.actuators.sink import SinkFormat, SinkStatus
from hnf_lab.bench.harness import BenchOptions
from hnf_lab.bench.stream import TimedSink, compute_latencies, measure_live, simulate_states


class Device:
    """Takes all, and has played all but the last 30 frames."""

    def __init__(self) -> None:
        self.taken = 0

    def open(self) -> SinkFormat:
        return SinkFormat(10_000.0, 1, 150, "test")

    def write(self, counts) -> None:
        self.taken += len(counts)

    def status(self) -> SinkStatus:
        return SinkStatus(played=max(self.taken - 30, 0))


def test_event_latency_ends_at_the_write_of_its_first_sample():
    writes = [(10.0, 50, 0.005), (10.006, 100, 0.008), (10.02, 150, 0.01)]
    heard = [EventTiming(9.999, 0), EventTiming(10.001, 50), EventTiming(10.004, 99), EventTiming(10.01, 150)]
    wire, played = compute_latencies(heard, writes, 1.0, 10_000.0)
    assert wire == pytest.approx([0.001, 0.005, 0.002])
    # What is owed with its write counts, but for the frames behind its own.
    assert played == pytest.approx([0.001 + 0.005 - 0.005, 0.005 + 0.008 - 0.005, 0.002 + 0.008 - 0.0001])


def test_at_another_rate_it_is_the_frame_of_the_same_time():
    wire, _ = compute_latencies([EventTiming(0.0, 50)], [(1.0, 240, 0.0), (2.0, 241, 0.0)], 4.8, 48_000.0)
    assert wire == [2.0]


def test_a_timed_sink_is_the_sink():
    device = Device()
    timed = TimedSink(device)
    assert timed.open() == device.open()
    for frames in (50, 20):
        timed.write(np.zeros((frames, 1), np.int16))
    assert device.taken == 70
    assert [frames for _, frames, _ in timed.writes] == [50, 70]
    assert [owed for *_, owed in timed.writes] == pytest.approx([0.003, 0.003])


def test_its_hand_moves():
    hand = simulate_states(400)
    assert all(state.contact for state in hand)
    assert max(state.speed for state in hand) > 0.3
    assert all(later.position >= state.position for state, later in itertools.pairwise(hand))


def test_the_rows_come():
    found = {row.method: row for row in measure_live(BenchOptions(quick=True))}
    quick = found["F_Θ of one state"]
    assert quick.error is not None
    assert quick.error < 0.01
    assert "0 waited for" in found["a state of 5 ms → samples"].note
    assert any("serial" in method for method in found)
