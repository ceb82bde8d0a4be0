"""Faults of a source or a device end a stream in silence, with one message and no threads left."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
from stream_builders import LIMITS, LONG_S, Failing, at_rest, comes, noise, slope
from stream_sink import ClockSink

from hnf_core.actuators.signal_chain import render_counts
from hnf_core.actuators.sinks.file import FileSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream
from hnf_core.errors import DeviceError


@pytest.mark.parametrize("error", [DeviceError("gone.", remedy="Plug it in."), ValueError("odd"), MemoryError()])
def test_a_source_that_fails_ends_in_silence_and_one_message(error: Exception) -> None:
    def fail() -> None:
        raise error

    sink = ClockSink()
    stream = Stream(Failing(10, fail), sink, LIMITS)
    stream.start()
    assert stream.wait(60.0)
    report = stream.report
    assert (str(error) or type(error).__name__) in report.problem
    assert sink.counts[-1, 0] == 0
    assert abs(int(sink.counts[-60, 0])) > 5000
    assert slope(sink.counts) < 1200, "it fades"
    assert sink.calls[-2:] == ["stop", "close"]
    assert at_rest()


def test_a_hanging_source_blocks_neither_device_nor_stop() -> None:
    hang = threading.Event()
    sink = ClockSink()
    stream = Stream(Failing(10, lambda: hang.wait(30.0)), sink, LIMITS)
    stream.start()
    assert comes(lambda: len(sink.counts) == 500), "all that was ready leaves"
    stream.stop()
    assert stream.wait(0.0)
    assert "does not answer" in stream.report.problem
    hang.set()
    assert at_rest()


def test_a_device_failure_ends_the_stream_and_a_new_one_plays() -> None:
    samples = noise(0.2)
    broken = ClockSink(fails_after=700)
    first = Stream(BufferSource(samples, 10000.0), broken, LIMITS)
    first.start()
    assert first.wait(60.0)
    assert first.report.problem == "the clock has stopped. Wind it up."
    whole = ClockSink()
    with Stream(BufferSource(samples, 10000.0), whole, LIMITS) as second:
        second.start()
        assert second.wait(60.0)
    assert np.array_equal(whole.counts, render_counts(BufferSource(samples, 10000.0), whole.format, LIMITS))
    assert at_rest()


def test_a_device_that_does_not_open_is_told_where_it_is_started() -> None:
    sink = ClockSink()
    sink.open()
    with pytest.raises(DeviceError, match="taken"), Stream(BufferSource(noise(0.1), 10000.0), sink, LIMITS) as stream:
        stream.start()
    assert stream.wait(60.0)
    assert at_rest()


def test_any_fault_of_a_sink_is_told_too() -> None:
    sink = ClockSink()
    sink.status = lambda: 1 / 0  # type: ignore[assignment,method-assign]
    stream = Stream(BufferSource(noise(0.2), 10000.0), sink, LIMITS)
    stream.start()
    assert stream.wait(60.0)
    assert "ZeroDivisionError" in stream.report.problem
    assert at_rest()


def test_a_device_that_blocks_holds_up_nobody_who_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hnf_core.actuators.stream._JOIN_TIMEOUT_S", 0.05)
    asked, block, sink = threading.Event(), threading.Event(), ClockSink()
    sink.write = lambda counts: asked.set() or block.wait(30.0)  # type: ignore[assignment,method-assign,func-returns-value]
    stream = Stream(BufferSource(noise(LONG_S), 10000.0), sink, LIMITS)
    stream.start()
    assert asked.wait(60.0)
    stream.stop()
    assert not stream.wait(0.0)
    assert "does not answer" in stream.report.problem
    block.set()
    assert at_rest()
    assert stream.wait(0.0)
    assert sink.calls == ["open", "stop", "close"]


def test_a_file_that_cannot_be_written_is_told_after_a_stop_too(tmp_path: Path) -> None:
    stream = Stream(
        BufferSource(noise(LONG_S), 10000.0, loop=True), FileSink(tmp_path / "taken" / "x.wav", 10000), LIMITS
    )
    stream.start()
    assert comes(lambda: stream.report.frames > 0)  # without a frame there is no file to write, hence no problem
    (tmp_path / "taken").rmdir()
    (tmp_path / "taken").write_text("a file, no folder")
    stream.stop()
    assert str(tmp_path / "taken") in stream.report.problem
    assert at_rest()
