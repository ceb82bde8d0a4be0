"""The report of a stream, and the coil heat that a device carries from one stream to the next."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stream_sink import ClockSink

from hnf_core.actuators.limiter import ThermalState
from hnf_core.actuators.limits import Limits
from hnf_core.actuators.sinks.file import FileSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import DurationHistogram, Stream, StreamReport

LIMITS = Limits(30.0, sustained=0.3, thermal_s=10.0)


@given(st.lists(st.floats(0.0, 0.2), min_size=1, max_size=300), st.floats(1.0, 100.0))
def test_a_percentile_is_at_most_a_bin_above_the_true_one(seconds: list[float], percent: float) -> None:
    durations = DurationHistogram()
    for value in seconds:
        durations.record(value)
    true = float(np.percentile(np.asarray(seconds) * 1e3, percent, method="inverted_cdf"))
    told = durations.percentile_ms(percent)
    assert told >= min(true, 100.0) - 1e-9
    assert told <= true + 0.01 + 1e-9 or true >= 100.0 - 1e-9
    assert durations.max_ms == pytest.approx(max(seconds) * 1e3)
    assert durations.count == len(seconds)


def test_of_nothing_there_is_no_percentile() -> None:
    assert DurationHistogram().percentile_ms(99.0) == 0.0


def test_a_report_is_json() -> None:
    record = json.loads(json.dumps(StreamReport(problem="gone").to_json()))
    assert record["problem"] == "gone"
    assert {"blocks", "underruns", "compute_p99_ms", "peak", "limited_samples"} <= set(record)


def test_coil_heat_decays_by_its_time_constant_across_streams() -> None:
    now = [100.0]
    warmth = ThermalState(lambda: now[0])
    assert warmth.get_heat("a", LIMITS, 2).tolist() == [0.0, 0.0]
    warmth.record("a", LIMITS, np.array([0.9, 0.1]))
    assert warmth.get_heat("a", LIMITS, 2) == pytest.approx([0.9, 0.1])
    assert warmth.get_heat("b", LIMITS, 2).tolist() == [0.0, 0.0]
    now[0] += 10.0
    assert warmth.get_heat("a", LIMITS, 2) == pytest.approx(np.array([0.9, 0.1]) * np.exp(-1.0))
    assert warmth.get_heat("a", LIMITS, 3) == pytest.approx([0.9 * np.exp(-1.0)] * 3)
    warmth.record("a", LIMITS, np.array([0.5, 0.0]))
    assert warmth.get_heat("a", LIMITS, 2) == pytest.approx([0.5, 0.1 * np.exp(-1.0)])


def test_of_two_devices_with_one_name_the_warmer_counts() -> None:
    warmth = ThermalState(lambda: 0.0)
    warmth.record("a", LIMITS, np.array([0.4, 0.2]))
    warmth.record("a", LIMITS, np.array([0.1, 0.3]))
    assert warmth.get_heat("a", LIMITS, 2) == pytest.approx([0.4, 0.3])


def test_heat_is_told_in_the_limits_it_is_asked_for() -> None:
    warmth = ThermalState(lambda: 0.0)
    warmth.record("a", LIMITS, np.array([0.4]))
    assert warmth.get_heat("a", Limits(30.0, sustained=0.6), 1) == pytest.approx([0.1])
    assert warmth.get_heat("a", Limits(60.0, sustained=0.15), 1) == pytest.approx([0.4])
    assert warmth.get_heat("a", Limits(30.0, sustained=0.1), 1) == pytest.approx([1.0])


def test_a_file_has_no_coil(tmp_path: Path) -> None:
    limits, played = Limits(30.0, sustained=0.05, thermal_s=20.0), []
    for _ in range(2):
        with Stream(
            BufferSource(np.full((700, 1), 30.0, np.float32), 8000.0), FileSink(tmp_path / "x.wav", 8000.0), limits
        ) as stream:
            stream.start()
            assert stream.wait(60.0)
        played.append((tmp_path / "x.wav").read_bytes())
    assert played[0] == played[1]


def test_a_new_stream_does_not_cool_the_coil() -> None:
    limits = Limits(30.0, sustained=0.05, thermal_s=20.0)
    sink, highest = ClockSink(), []
    for _ in range(2):
        with Stream(BufferSource(np.full((700, 1), 30.0, np.float32), 10000.0), sink, limits) as stream:
            stream.start()
            assert stream.wait(60.0)
        highest.append(int(np.abs(sink.counts.astype(np.int64)).max()))
        sink.written.clear()
    assert highest[0] == 32767
    assert highest[1] < 0.6 * highest[0]
