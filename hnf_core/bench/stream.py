"""A stream for minutes: does every count arrive, in time?

The device is a program of its own on a pty, its line as slow as 3 Mbaud are. What it played is compared with what the
limiter makes of the same signal in one go.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..actuators.chain import render_counts
from ..actuators.limits import Limits
from ..actuators.report import DurationHistogram
from ..actuators.sink import Counts
from ..actuators.sinks.audio import AudioSink
from ..actuators.sinks.serial import SerialSink
from ..actuators.sources.limited import TruncatedSource
from ..actuators.sources.recorded import BufferSource
from ..actuators.stream import Stream
from ..errors import DeviceError
from .frame import BenchOptions, Row, Spread
from .memory import run_with_peak
from .standstill import watch_stalls

STREAM_NAME = "stream"
SECONDS_A_REPEAT, QUICK_STREAM_S = 120.0, 1.0
"""10 minutes with the 5 repeats there are by default."""
BAUDRATE = 3_000_000
LIMITS = Limits(30.0, slew_per_s=2.0 * np.pi * 1000.0, sustained=0.5)
QUIET_LIMITS = Limits(30.0, peak=0.01)
"""For an output that may be somebody's loudspeaker."""

QUIET_GAIN = 0.002

_PERIOD_S = 10.0
_MARGIN_S = 30.0
_MAX_EXIT_S = 10.0
_BUSY_CODE = "import os; parent = os.getppid()\nwhile os.getppid() == parent: pass"


@dataclass(frozen=True)
class StreamCase:
    """busy: another process keeps a core busy."""

    method: str
    rate_hz: int
    channels: int
    block_s: float
    busy: bool = False


STREAM_CASES = (
    StreamCase("serial, 10 kHz, 5 ms blocks", 10_000, 1, 0.005),
    StreamCase("serial, 10 kHz, 20 ms blocks, the other core busy", 10_000, 1, 0.02, busy=True),
    StreamCase("serial, 8 kHz, 16 channels at 3 Mbaud, 5 ms blocks", 8_000, 16, 0.005),
)


def measure_stream(options: BenchOptions, seconds: float | None = None) -> list[Row]:
    """seconds: of each stream; None: SECONDS_A_REPEAT for each repeat, or QUICK_SECONDS."""
    length = seconds or (QUICK_STREAM_S if options.quick else SECONDS_A_REPEAT * options.repeats)
    found = []
    for case in STREAM_CASES:
        options.watch(f"{STREAM_NAME}: {case.method}, {length:g} s")
        found.append(_add_memory(partial(_stream_serial, case, length)))
    options.watch(f"{STREAM_NAME}: sound output, {length:g} s")
    return [*found, _add_memory(partial(_stream_audio, length))]


def _add_memory(measure: Callable[[], Row]) -> Row:
    """peak_mb: of this process, the comparison of the bytes at the end included."""
    row, peak = run_with_peak(measure)
    return replace(row, peak_mb=peak)


def _stream_serial(case: StreamCase, seconds: float) -> Row:
    with tempfile.TemporaryDirectory(prefix="hnf-bench-") as folder, _load_core(case.busy):
        record = Path(folder) / "played.npy"
        with run_virtual_device(record) as actuator, watch_stalls() as still:
            try:
                sink = SerialSink(
                    actuator.port, BAUDRATE, case.rate_hz, case.channels,
                    peak=LIMITS.peak_counts, slew_per_s=LIMITS.slew_per_s,
                )  # fmt: skip
                stream = Stream(_make_source(case.rate_hz, case.channels, seconds), sink, LIMITS, block_s=case.block_s)
                with stream:
                    form = stream.start()
                    stream.wait(seconds + _MARGIN_S)
            except DeviceError as error:
                return Row(STREAM_NAME, case.method, note=str(error))
            actuator.finish()
        expected = trim_silence(render_counts(_make_source(case.rate_hz, case.channels, seconds), form, LIMITS))
        wrong = compute_difference_share(expected, np.load(record))
    return _make_stream_row(
        case.method, stream, wrong, f", the device's clock slipped by {actuator.slipped} frames, {still}"
    )


def _stream_audio(seconds: float) -> Row:
    method = "sound output, 5 ms blocks"
    try:
        with (
            watch_stalls() as still,
            Stream(_make_source(10_000, 1, seconds, QUIET_GAIN), AudioSink(), QUIET_LIMITS) as stream,
        ):
            form = stream.start()
            stream.wait(seconds + _MARGIN_S)
    except DeviceError as error:
        return Row(STREAM_NAME, method, note=str(error))
    return _make_stream_row(f"{method}, {form.rate_hz:g} Hz", stream, None, f", {still}")


def _make_stream_row(method: str, stream: Stream, wrong: float | None, more: str) -> Row:
    report = stream.report
    told = "" if wrong is None else f"bytes {'equal' if wrong == 0.0 else 'differ'}, "
    note = (
        f"{report.underruns} underruns, {told}{report.limited_samples} samples limited, source to wire 99 % "
        f"{report.latency_p99_ms:.1f} ms, {report.played_s:g} s played{more}, "
        f"{'' if report.realtime else 'no '}real-time priority"
    )
    return Row(
        STREAM_NAME,
        method,
        _to_spread(stream.compute),
        _to_spread(stream.compute_cpu),
        error=wrong,
        error_unit="" if wrong is None else "of the counts",
        note=f"{note}: {report.problem}" if report.problem else note,
    )


def _to_spread(durations: DurationHistogram) -> Spread | None:
    if durations.count == 0:
        return None
    median, lowest, p99 = (durations.percentile_ms(percent) * 1e-3 for percent in (50.0, 0.0, 99.0))
    return Spread(median, lowest, p99, durations.max_ms * 1e-3, durations.count)


def _make_source(rate_hz: int, channels: int, seconds: float, gain: float = 1.0) -> TruncatedSource:
    """Noise and now and then a shock that the limiter has to do with."""
    rng = np.random.default_rng(6)
    frames = int(min(_PERIOD_S, seconds) * rate_hz)
    samples = rng.normal(0.0, 4.0, (frames, channels)).astype(np.float32)
    samples[rng.random(frames) < 1e-3] *= 20.0
    return TruncatedSource(BufferSource(samples * np.float32(gain), rate_hz, loop=True), round(seconds * rate_hz))


def trim_silence(counts: Counts) -> Counts:
    """From the first frame that is no silence to the last."""
    loud = np.flatnonzero(counts.any(axis=1))
    return counts[loud[0] : loud[-1] + 1] if len(loud) else counts[:0]


def compute_difference_share(expected: Counts, played: Counts) -> float:
    """Share of the counts; all of them where as many frames as expected were not played."""
    if expected.shape != played.shape:
        return 1.0
    return float(np.count_nonzero(expected != played)) / max(expected.size, 1)


class _DeviceProcess:
    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.port = str(self._read_value("port"))
        self.slipped = 0

    def finish(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        self.slipped = int(str(self._read_value("slipped")))

    def _read_value(self, name: str) -> object:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise DeviceError("the virtual device does not run here.", remedy="Use Linux or macOS, which have ptys.")
        return json.loads(line)[name]


@contextmanager
def run_virtual_device(record: Path) -> Iterator[_DeviceProcess]:
    """A virtual device in a program of its own; record: where it writes down what it played, see stream_device."""
    words = [sys.executable, "-m", f"{__package__}.stream_device", str(BAUDRATE), str(record)]
    root = Path(__file__).resolve().parents[2]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=root)
    try:
        yield _DeviceProcess(process)
    finally:
        try:
            process.communicate(timeout=_MAX_EXIT_S)  # its input ends: it leaves, and nothing of it stays
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


@contextmanager
def _load_core(busy: bool) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", _BUSY_CODE]) if busy else None
    try:
        yield
    finally:
        if process is not None:
            process.kill()
            process.wait()
            process.wait()
