"""Benches of streaming: underruns and byte-exact playback over minutes, and latency of live synthesis.

`measure_stream` plays on a virtual device in its own process, over a pty as slow as 3 Mbaud, and compares the played
counts with the limiter's output for the complete signal.

`measure_live` moves a simulated hand whose thread reports events every 8 to 16 ms, as a mouse under load does. An event
is at the wire when the write returns that contained the first sample affected by it; it is played when the device has
played everything it still had queued then.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, cos, sin
from pathlib import Path

import numpy as np

from hnf_core.actuators.limits import Limits
from hnf_core.actuators.live_source import EventTiming, LiveSource
from hnf_core.actuators.signal_chain import render_counts
from hnf_core.actuators.sink import Counts, Sink, SinkFormat, SinkStatus
from hnf_core.actuators.sinks.audio import AudioSink
from hnf_core.actuators.sinks.serial import SerialSink
from hnf_core.actuators.sources import BufferSource, TruncatedSource
from hnf_core.actuators.stream import DurationHistogram, Stream
from hnf_core.errors import DeviceError
from hnf_core.field.field import evaluate
from hnf_core.field.linear_contact import Condition
from hnf_core.field.live.emission import LiveEmission
from hnf_core.field.live.hand_tracker import STATE_S, HandEvent, HandTracker, LiveState
from hnf_core.field.live.synthesis import LiveSynthesis, create_live_synthesis
from hnf_core.field.weights import load_field
from hnf_core.material.library import get_material
from hnf_lab import CHILD_PATH, ROOT

from .harness import BenchOptions, Row, Spread, Times, run_with_peak
from .scheduling_jitter import watch_stalls

STREAM_NAME = "stream"
SECONDS_A_REPEAT, QUICK_STREAM_S = 120.0, 1.0
"""Stream duration per repeat and in quick runs [s]; 10 minutes with the default of 5 repeats."""
BAUDRATE = 3_000_000
LIMITS = Limits(30.0, slew_per_s=2.0 * np.pi * 1000.0, sustained=0.5)
QUIET_LIMITS = Limits(30.0, peak=0.01)
"""Limits for an output that may be a loudspeaker in use."""

QUIET_GAIN = 0.002

_PERIOD_S = 10.0
_MARGIN_S = 30.0
_MAX_EXIT_S = 10.0
_BUSY_CODE = "import os; parent = os.getppid()\nwhile os.getppid() == parent: pass"


@dataclass(frozen=True)
class StreamCase:
    """A stream to measure. busy: another process loads a core."""

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
    """Measure all streams.

    seconds: duration of each stream; None = SECONDS_A_REPEAT per repeat, or QUICK_STREAM_S in quick runs.
    """
    length = seconds or (QUICK_STREAM_S if options.quick else SECONDS_A_REPEAT * options.repeats)
    rows = []
    for case in STREAM_CASES:
        options.watch(f"{STREAM_NAME}: {case.method}, {length:g} s")
        rows.append(_add_memory(partial(_stream_serial, case, length)))
    options.watch(f"{STREAM_NAME}: sound output, {length:g} s")
    return [*rows, _add_memory(partial(_stream_audio, length))]


def _add_memory(measure: Callable[[], Row]) -> Row:
    """Add peak_mb of this process, which includes the byte comparison at the end."""
    row, peak = run_with_peak(measure)
    return replace(row, peak_mb=peak)


def _stream_serial(case: StreamCase, seconds: float) -> Row:
    with tempfile.TemporaryDirectory(prefix="hnf-bench-") as folder, _load_core(case.busy):
        record = Path(folder) / "played.npy"
        with run_virtual_device(record) as actuator, watch_stalls() as stalls:
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
        case.method, stream, wrong, f", the device's clock slipped by {actuator.slipped} frames, {stalls}"
    )


def _stream_audio(seconds: float) -> Row:
    method = "sound output, 5 ms blocks"
    try:
        with (
            watch_stalls() as stalls,
            Stream(_make_source(10_000, 1, seconds, QUIET_GAIN), AudioSink(), QUIET_LIMITS) as stream,
        ):
            form = stream.start()
            stream.wait(seconds + _MARGIN_S)
    except DeviceError as error:
        return Row(STREAM_NAME, method, note=str(error))
    return _make_stream_row(f"{method}, {form.rate_hz:g} Hz", stream, None, f", {stalls}")


def _make_stream_row(method: str, stream: Stream, wrong: float | None, more: str) -> Row:
    report = stream.report
    equality = "" if wrong is None else f"bytes {'equal' if wrong == 0.0 else 'differ'}, "
    note = (
        f"{report.underruns} underruns, {equality}{report.limited_samples} samples limited, source to wire 99 % "
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
    """Make noise with occasional shocks for the limiter."""
    rng = np.random.default_rng(6)
    frames = int(min(_PERIOD_S, seconds) * rate_hz)
    samples = rng.normal(0.0, 4.0, (frames, channels)).astype(np.float32)
    samples[rng.random(frames) < 1e-3] *= 20.0
    return TruncatedSource(BufferSource(samples * np.float32(gain), rate_hz, loop=True), round(seconds * rate_hz))


def trim_silence(counts: Counts) -> Counts:
    """Return the counts from the first frame that is not silent to the last."""
    loud = np.flatnonzero(counts.any(axis=1))
    return counts[loud[0] : loud[-1] + 1] if len(loud) else counts[:0]


def compute_difference_share(expected: Counts, played: Counts) -> float:
    """Return the fraction of counts that differ; 1 if the number of frames differs."""
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
    """Run a virtual device in its own process. record: file for what it played, see virtual_device.py."""
    command = [sys.executable, "-m", f"{__package__}.virtual_device", str(BAUDRATE), str(record)]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
        env=os.environ | {"PYTHONPATH": CHILD_PATH},
    )  # fmt: skip
    try:
        yield _DeviceProcess(process)
    finally:
        try:
            process.communicate(timeout=_MAX_EXIT_S)  # closes its input: it exits
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


LIVE_NAME = "live"
LIVE_MATERIAL = "denim"
LIVE_S, QUICK_LIVE_S = 60.0, 1.0
STATE_COUNT, QUICK_STATE_COUNT = 12_000, 100
LIVE_RATE_HZ = 10_000
BLOCK_S = 0.005
WARM_UP_STATES = 50
"""States excluded from the measurement, during which libraries initialise."""


def measure_live(options: BenchOptions) -> list[Row]:
    """Measure the field's fast path against the offline one, a step, and latencies on serial and sound output."""
    count, seconds = (QUICK_STATE_COUNT, QUICK_LIVE_S) if options.quick else (STATE_COUNT, LIVE_S)
    hand = simulate_states(count)
    options.watch(f"{LIVE_NAME}: F_Θ")
    rows = _measure_field(hand[WARM_UP_STATES :: max(count // 500, 1)])
    options.watch(f"{LIVE_NAME}: {count} steps")
    rows.append(_measure_steps(hand))
    options.watch(f"{LIVE_NAME}: serial, {seconds:g} s")
    rows += _measure_serial(seconds)
    options.watch(f"{LIVE_NAME}: sound output, {seconds:g} s")
    return [*rows, *_measure_latencies("sound output", AudioSink(), QUIET_LIMITS, seconds)]


def compute_position(time_s: float) -> tuple[float, float]:
    """Return the hand's position [m]: figures of eight at 0.2 … 0.36 m/s."""
    return 0.06 * sin(5.0 * time_s), 0.02 * sin(10.0 * time_s)


def compute_force(time_s: float) -> float:
    return 1.0 + 0.5 * cos(7.0 * time_s)


def generate_gaps() -> Iterator[float]:
    """Yield the time between events [s]."""
    rng = np.random.default_rng(8)
    while True:
        yield float(rng.uniform(0.008, 0.016))


def simulate_states(count: int) -> list[LiveState]:
    """Return the live states of the simulated hand."""
    hand, event_s, gap, states = HandTracker(), 0.0, generate_gaps(), []
    for index in range(count):
        while event_s <= index * STATE_S:
            hand.push(HandEvent(event_s, *compute_position(event_s), compute_force(event_s)))
            event_s += next(gap)
        states.append(hand.state(index * STATE_S))
    return states


def _measure_field(hand: list[LiveState]) -> list[Row]:
    """Measure F_Θ state by state with both paths, and the largest difference of an amplitude."""
    field, material = load_field(), get_material(LIVE_MATERIAL)
    emission = LiveEmission(field, material.token.astype(np.float64), material.mechanics, "pen")
    live_times, offline_times, error = Times(), Times(), 0.0
    for state in hand:
        direction, unit = np.array(state.direction), np.ones(1)
        condition = Condition(
            material.token[None].astype(np.float64), (material.mechanics,), np.zeros(1, np.int32), direction[None],
            state.speed * unit, state.force * unit, unit > 0.0, "pen",
        )  # fmt: skip
        expected = offline_times.measure(lambda condition=condition: evaluate(field, condition)).alpha[0, 0]  # type: ignore[misc]
        amplitude = live_times.measure(
            lambda state=state, direction=direction: emission.evaluate(direction, state.speed, state.force, True)  # type: ignore[misc]
        )[0]
        loud = expected > 1e-3 * max(float(expected.max()), 1e-12)
        if loud.any():
            error = max(error, float(np.abs(20.0 * np.log10(amplitude[loud] / expected[loud])).max()))
    reference = Row(LIVE_NAME, "F_Θ of one state, as offline", offline_times.seconds, offline_times.cpu)
    ratio = live_times.compute_ratio(offline_times)
    return [
        reference,
        Row(LIVE_NAME, "F_Θ of one state", live_times.seconds, live_times.cpu, ratio, reference.method, error, "dB"),
    ]


def _measure_steps(hand: list[LiveState]) -> Row:
    synthesis, times = create_live_synthesis(LIVE_MATERIAL), Times()
    for state in hand[:WARM_UP_STATES]:
        synthesis.step(state)
    for state in hand[WARM_UP_STATES:]:
        times.measure(lambda state=state: synthesis.step(state))  # type: ignore[misc]
    return Row(LIVE_NAME, "a state of 5 ms → samples", times.seconds, times.cpu, note=_describe_memory(synthesis))


def _describe_memory(synthesis: LiveSynthesis) -> str:
    return f"{synthesis.cached_blocks} blocks of noise in memory, {synthesis.late_blocks} waited for"


def _measure_serial(seconds: float) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="hnf-bench-") as folder:
        try:
            with run_virtual_device(Path(folder) / "played.npy") as port:
                return _measure_latencies("serial", SerialSink(port.port, BAUDRATE, LIVE_RATE_HZ), LIMITS, seconds)
        except DeviceError as error:
            return [Row(LIVE_NAME, "serial", note=str(error))]


def _measure_latencies(where: str, sink: Sink, limits: Limits, seconds: float) -> list[Row]:
    timed, live = TimedSink(sink), LiveSource(create_live_synthesis(LIVE_MATERIAL))
    try:
        with Stream(live, timed, limits, block_s=BLOCK_S, ahead_blocks=1) as stream, _move_hand(live):
            form = stream.start()
            stream.wait(seconds)
            report = stream.report
    except DeviceError as error:
        return [Row(LIVE_NAME, where, note=str(error))]
    wire, played = compute_latencies(live.pop_event_timings(), timed.writes, form.rate_hz / live.rate_hz, form.rate_hz)
    if not wire:
        return [Row(LIVE_NAME, where, note=report.problem or "nothing was felt")]
    note = (
        f"{form.rate_hz:g} Hz, {report.underruns} underruns, a block computed in {report.compute_p99_ms:.2f} ms (99 %, "
        f"{report.compute_cpu_p99_ms:.2f} of CPU), then {stream.prepared.percentile_ms(99.0):.2f} ms for the next"
    )
    return [
        Row(
            LIVE_NAME,
            f"pen → wire, {where}",
            Spread.from_values(wire),
            note=f"{note}: {report.problem}" if report.problem else note,
        ),
        Row(
            LIVE_NAME,
            f"pen → played, {where}",
            Spread.from_values(played),
            note=f"the device holds {form.queue_frames} frames",
        ),
    ]


class TimedSink:
    """A sink that records its writes as (time, frames received so far, seconds of them not yet played)."""

    def __init__(self, sink: Sink) -> None:
        self._sink, self._rate_hz, self._frames = sink, 1.0, 0
        self.writes: list[tuple[float, int, float]] = []

    def open(self) -> SinkFormat:
        form = self._sink.open()
        self._rate_hz, self._frames = form.rate_hz, 0
        self.writes = []
        return form

    def wait(self, timeout_s: float) -> int:
        return self._sink.wait(timeout_s)

    def write(self, counts: Counts) -> None:
        self._sink.write(counts)
        self._frames += len(counts)
        owed = max(self._frames - self._sink.status().played, 0)
        self.writes.append((time.perf_counter(), self._frames, owed / self._rate_hz))

    def status(self) -> SinkStatus:
        return self._sink.status()

    def finish(self, timeout_s: float) -> None:
        self._sink.finish(timeout_s)

    def stop(self) -> None:
        self._sink.stop()

    def close(self) -> None:
        self._sink.close()


def compute_latencies(
    outputs: list[EventTiming], writes: list[tuple[float, int, float]], per_frame: float, rate_hz: float
) -> tuple[list[float], list[float]]:
    """Return the latencies of each event to the wire and to playback [s].

    per_frame: sink frames per source frame. rate_hz: rate of the sink.
    """
    ends = [frames for _, frames, _ in writes]
    wire, played = [], []
    for output in outputs:
        first = ceil(output.frame * per_frame)
        index = bisect_right(ends, first)
        if index < len(writes):
            written_s, frames, owed_s = writes[index]
            wire.append(written_s - output.moved_s)
            played.append(wire[-1] + max(owed_s - (frames - first) / rate_hz, 0.0))
    return wire, played


@contextmanager
def _move_hand(live: LiveSource) -> Iterator[None]:
    """Move the hand in a thread within the `with` block."""
    stop = threading.Event()

    def move() -> None:
        for gap in generate_gaps():
            now = time.perf_counter()
            live.move(now, compute_position(now), compute_force(now))
            if stop.wait(gap):
                return

    thread = threading.Thread(target=move, name="hnf-hand", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
