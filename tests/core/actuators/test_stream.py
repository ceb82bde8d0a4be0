"""A stream sends exact bytes, and every fault ends it in silence with one message."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stream_builders import LIMITS, LONG_S, Failing, at_rest, comes, noise, slope
from stream_sink import ClockSink, check_sink

from hnf_core.actuators.limits import FULL_SCALE_COUNTS
from hnf_core.actuators.signal_chain import Samples, SignalChain, render_counts
from hnf_core.actuators.sink import SinkFormat
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream
from hnf_core.errors import UsageError


class Ahead:
    """Says in which order it was asked."""

    def __init__(self, blocks: int) -> None:
        self.rate_hz, self.channels, self.asked = 10000.0, 1, list[str]()
        self._blocks = blocks

    def read(self, frames: int) -> Samples:
        self.asked.append("read")
        return np.zeros((frames if self.asked.count("read") < self._blocks else 0, 1), np.float32)

    def prepare(self) -> None:
        self.asked.append("prepare")


def test_the_clock_keeps_the_contract_of_a_sink() -> None:
    check_sink(ClockSink(queue_frames=150))


@pytest.mark.parametrize(
    ("source_hz", "sink_hz", "channels", "block_s", "ahead", "prompt"),
    [
        (10000.0, 10000.0, 1, 0.005, 3, True),
        (2800.0, 10000.0, 1, 0.005, 1, True),
        (2800.0, 10000.0, 2, 0.005, 3, False),
        (8000.0, 8000.0, 16, 0.02, 3, True),
    ],
)
def test_what_the_sink_gets_is_what_the_chain_makes_at_once(
    source_hz: float, sink_hz: float, channels: int, block_s: float, ahead: int, prompt: bool
) -> None:
    samples = noise(0.4, source_hz, channels)
    sink = ClockSink(sink_hz, channels, round(0.015 * sink_hz))
    source = BufferSource(samples, source_hz)
    with Stream(source, sink, LIMITS, block_s=block_s, ahead_blocks=ahead, low_latency=prompt) as stream:
        assert stream.start() == sink.format
        assert stream.wait(60.0)
    assert stream.report.problem == ""
    expected = render_counts(BufferSource(samples, source_hz), sink.format, LIMITS, low_latency=prompt)
    assert np.array_equal(sink.counts, expected)
    report = stream.report
    assert report.state == "ended"
    assert report.frames == len(expected)
    assert report.peak == np.abs(expected.astype(np.int64)).max() / FULL_SCALE_COUNTS
    assert report.played_s == pytest.approx(len(expected) / sink_hz)
    assert report.compute_p99_ms > 0.0
    assert report.to_json()["underruns"] == report.underruns
    assert sink.calls == ["open", "finish", "stop", "close"]
    assert at_rest()


def test_mono_fills_all_channels_and_stereo_on_three_is_refused() -> None:
    one = render_counts(BufferSource(noise(0.05), 8000.0), SinkFormat(8000.0, 3, 100, "three"), LIMITS)
    assert np.array_equal(one[:, 0], one[:, 2])
    with pytest.raises(UsageError, match="2 channels"):
        SignalChain(BufferSource(noise(0.05, channels=2), 8000.0), SinkFormat(8000.0, 3, 100, "three"), LIMITS)
    sink = ClockSink(channels=3)
    with pytest.raises(UsageError, match="2 channels"):
        Stream(BufferSource(noise(0.05, channels=2), 8000.0), sink, LIMITS).start()
    assert not sink.is_open
    assert at_rest()


def test_the_limiter_respects_the_lower_peak_of_a_device() -> None:
    """It would do so hard, and nobody would be told; the limiter holds back softly, and counts."""
    samples = np.full((4000, 1), 25.0, np.float32) * np.sin(0.1 * np.arange(4000), dtype=np.float32)[:, None]
    sink = ClockSink()
    sink.format = replace(sink.format, peak=8000)
    with Stream(BufferSource(samples, 10000.0), sink, LIMITS) as stream:
        stream.start()
        assert stream.wait(60.0)
    assert np.abs(sink.counts.astype(np.int64)).max() == 8000
    assert stream.report.peak == 8000 / FULL_SCALE_COUNTS
    assert stream.report.limited_samples > 1000
    strong = replace(sink.format, peak=FULL_SCALE_COUNTS)
    assert np.array_equal(
        render_counts(BufferSource(samples, 10000.0), strong, replace(LIMITS, peak=8000 / FULL_SCALE_COUNTS)),
        sink.counts,
    ), "as if the profile had said so"


def test_stages_run_before_the_limiter_on_finite_samples_only() -> None:
    class Louder:
        def process(self, block: Samples) -> Samples:
            assert np.isfinite(block).all()
            return block * np.float32(1e6)

    samples = noise(0.1)
    samples[::7] = np.nan
    chain = SignalChain(BufferSource(samples, 2800.0), SinkFormat(10000.0, 1, 100, "x"), LIMITS, [Louder()])
    counts = np.concatenate([chain.render_block(50) for _ in range(100)])
    assert chain.nonfinite == len(samples[::7])
    assert np.abs(counts.astype(np.int64)).max() <= LIMITS.peak_counts
    assert chain.limiter.limited > 0


def test_stopping_is_soft_at_once_and_from_any_thread() -> None:
    sink = ClockSink()
    stream = Stream(BufferSource(noise(LONG_S), 10000.0), sink, LIMITS)
    stream.start()
    assert comes(lambda: len(sink.counts) > 0)
    threads = [threading.Thread(target=stream.stop) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(5.0)
    assert stream.wait(0.0)
    assert sink.calls == ["open", "stop", "close"]
    assert stream.report.problem == ""
    assert at_rest()
    with pytest.raises(UsageError, match="plays once"):
        stream.start()


def test_stopping_before_the_start_is_harmless() -> None:
    stream = Stream(BufferSource(noise(0.1), 10000.0), ClockSink(), LIMITS)
    stream.stop()
    assert stream.wait(0.0)
    assert stream.report.state == "ended"
    with pytest.raises(UsageError):
        stream.start()


def test_a_source_may_stop_its_own_stream() -> None:
    sink = ClockSink()
    stream = Stream(Failing(5, lambda: stream.stop()), sink, LIMITS)
    stream.start()
    assert stream.wait(60.0)
    assert stream.report.problem == ""
    assert at_rest()


def test_a_pause_fades_out_holds_and_fades_in_where_it_was() -> None:
    samples = np.full((3000, 1), 10.0, np.float32)
    sink, source = ClockSink(), BufferSource(samples, 10000.0)
    with Stream(source, sink, LIMITS) as stream:
        stream.start()
        assert comes(lambda: len(sink.counts) > 300)
        stream.pause()
        assert comes(lambda: len(sink.counts) > 500 and not sink.counts[-400:].any())
        held = source.position_s
        assert stream.report.state == "paused"
        count = len(sink.counts)
        assert comes(lambda: len(sink.counts) > count + 200)
        assert source.position_s == held < 0.3
        stream.resume()
        assert stream.wait(60.0)
    counts = sink.counts[:, 0]
    assert slope(sink.counts) < 450, "a fade of 40 frames from 10 m/s² to 0 is nowhere steeper"
    sounding = np.count_nonzero(counts)
    assert len(samples) - 2 <= sounding <= len(samples) + 80, "nothing is skipped; two fades come on top"


def test_what_changes_in_the_source_is_heard_without_a_stop() -> None:
    source, sink = BufferSource(np.full((100, 1), 10.0, np.float32), 10000.0, loop=True), ClockSink()
    with Stream(source, sink, LIMITS) as stream:
        stream.start()
        assert comes(lambda: stream.report.level_m_s2 == pytest.approx(10.0, rel=0.01))
        source.set_gain(0.5)
        assert comes(lambda: stream.report.level_m_s2 == pytest.approx(5.0, rel=0.01))
        source.swap(np.full((100, 1), 4.0, np.float32))
        assert comes(lambda: stream.report.level_m_s2 == pytest.approx(2.0, rel=0.01))
        position = len(sink.counts)
    assert int(sink.counts[position - 1, 0]) == round(2.0 / 30.0 * FULL_SCALE_COUNTS)
    assert int(np.abs(np.diff(sink.counts[:position, 0].astype(np.int64))).max()) < 450


def test_a_stream_that_nothing_stops_ends_with_the_interpreter(tmp_path: Path) -> None:
    told = tmp_path / "told"
    code = f"""
import sys; sys.path[:0] = {[str(Path(__file__).parent), str(Path(__file__).parents[3])]!r}
from pathlib import Path
import numpy as np
from stream_sink import ClockSink
from hnf_core.actuators.limits import Limits
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream
class Telling(ClockSink):
    def close(self):
        super().close()
        Path({str(told)!r}).write_text(" ".join(self.calls))
Stream(BufferSource(np.ones((500, 1)), 10000.0, loop=True), Telling(), Limits(30.0)).start()
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (run.returncode, run.stderr) == (0, "")
    assert told.read_text() == "open stop close"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_fork_of_what_plays_ends_at_once(tmp_path: Path) -> None:
    code = f"""
import sys; sys.path[:0] = {[str(Path(__file__).parent), str(Path(__file__).parents[3])]!r}
import os, time
import numpy as np
from stream_sink import ClockSink
from hnf_core.actuators import stream
from hnf_core.actuators.limits import Limits
from hnf_core.actuators.sources import BufferSource
stream._JOIN_TIMEOUT_S = 30.0
playing = stream.Stream(BufferSource(np.ones((500, 1)), 10000.0, loop=True), ClockSink(), Limits(30.0))
playing.start()
child = os.fork()
if child:
    assert os.waitpid(child, 0)[1] == 0
    assert playing.report.problem == ""
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (run.returncode, run.stderr) == (0, "")


def test_streams_set_and_restore_switch_interval_and_gc_freeze() -> None:
    before = sys.getswitchinterval()
    streams = [Stream(BufferSource(noise(LONG_S), 10000.0), ClockSink(), LIMITS) for _ in range(2)]
    for stream in streams:
        stream.start()
        assert sys.getswitchinterval() < 0.001
        assert gc.get_freeze_count() > 0
    streams[0].stop()
    assert sys.getswitchinterval() < 0.001
    streams[1].stop()
    assert at_rest()
    assert sys.getswitchinterval() == before


def test_a_stream_of_nothing_ahead_is_refused() -> None:
    for words in ({"block_s": 0.0}, {"block_s": 5.0}, {"ahead_blocks": 0}, {"block_s": float("nan")}):
        with pytest.raises(UsageError, match="cannot be made"):
            Stream(BufferSource(noise(0.1), 10000.0), ClockSink(), LIMITS, **words)  # type: ignore[arg-type]


def test_no_sample_is_sent_before_the_start_callback_returns() -> None:
    """Whoever computes something first does not make the device wait for samples: that would be underruns."""
    sink = ClockSink()
    seen = []

    def look(device: SinkFormat) -> None:
        time.sleep(0.05)
        seen.append((device, len(sink.counts), sink.status().underruns))

    with Stream(BufferSource(noise(0.1), 10000.0), sink, LIMITS) as stream:
        stream.start(look)
        assert stream.wait(60.0)
    assert seen == [(sink.format, 0, 0)]
    assert np.array_equal(sink.counts, render_counts(BufferSource(noise(0.1), 10000.0), sink.format, LIMITS))

    def fail(device: SinkFormat) -> None:
        raise KeyboardInterrupt

    sink = ClockSink()
    stream = Stream(BufferSource(noise(0.1), 10000.0), sink, LIMITS)
    with pytest.raises(KeyboardInterrupt):
        stream.start(fail)
    assert stream.wait(60.0), "it is given back"
    assert len(sink.counts) == 0
    assert at_rest()


def test_a_source_prepares_the_next_block_after_a_write() -> None:
    source = Ahead(4)
    with Stream(source, ClockSink(), LIMITS) as stream:
        stream.start()
        assert stream.wait(LONG_S)
    assert source.asked == ["read", "prepare"] * 3 + ["read"]
    assert stream.prepared.count == stream.compute.count == 4
