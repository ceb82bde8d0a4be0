"""A hand felt live: what a state costs, and how long it takes from an event to the wire.

The hand is a thread that swings over the surface and says so every 8 to 16 ms, as a mouse under load does; the device a
program of its own on a pty, as in stream.py. An event is at the wire when the write returns that held the first sample
which it changed; it is played when all is played that the device still owed then.
"""

from __future__ import annotations

import tempfile
import threading
import time
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from math import ceil, cos, sin
from pathlib import Path

import numpy as np

from ..actuators.limits import Limits
from ..actuators.sink import Counts, Sink, SinkFormat, SinkStatus
from ..actuators.sinks.audio import AudioSink
from ..actuators.sinks.serial import SerialSink
from ..actuators.sources.live import EventTiming, LiveSource
from ..actuators.stream import Stream
from ..errors import DeviceError
from ..field.field import evaluate
from ..field.linear_contact import Condition
from ..field.live.emission import LiveEmission
from ..field.live.hand import STATE_S, HandEvent, HandTracker
from ..field.live.materials import create_live_synthesis
from ..field.live.state import LiveState
from ..field.live.synthesis import LiveSynthesis
from ..field.weights import load_field
from ..material.library import get_material
from .frame import BenchOptions, Row, Spread, Times
from .stream import BAUDRATE, LIMITS, QUIET_LIMITS, run_virtual_device

LIVE_NAME = "live"
LIVE_MATERIAL = "denim"
LIVE_S, QUICK_LIVE_S = 60.0, 1.0
STATE_COUNT, QUICK_STATE_COUNT = 12_000, 100
LIVE_RATE_HZ = 10_000
BLOCK_S = 0.005
WARM_UP_STATES = 50
"""Not counted: libraries find their plans."""


def measure_live(options: BenchOptions) -> list[Row]:
    """The field's quick way beside the plain one, a step, and latencies on a serial port and a sound output."""
    count, seconds = (QUICK_STATE_COUNT, QUICK_LIVE_S) if options.quick else (STATE_COUNT, LIVE_S)
    hand = simulate_states(count)
    options.watch(f"{LIVE_NAME}: F_Θ")
    found = _measure_field(hand[WARM_UP_STATES :: max(count // 500, 1)])
    options.watch(f"{LIVE_NAME}: {count} steps")
    found.append(_measure_steps(hand))
    options.watch(f"{LIVE_NAME}: serial, {seconds:g} s")
    found += _measure_serial(seconds)
    options.watch(f"{LIVE_NAME}: sound output, {seconds:g} s")
    return [*found, *_measure_latencies("sound output", AudioSink(), QUIET_LIMITS, seconds)]


def compute_position(time_s: float) -> tuple[float, float]:
    """Of the hand: figures of eight, 0.2 … 0.36 m/s."""
    return 0.06 * sin(5.0 * time_s), 0.02 * sin(10.0 * time_s)


def compute_force(time_s: float) -> float:
    return 1.0 + 0.5 * cos(7.0 * time_s)


def generate_gaps() -> Iterator[float]:
    """Seconds from event to event."""
    rng = np.random.default_rng(8)
    while True:
        yield float(rng.uniform(0.008, 0.016))


def simulate_states(count: int) -> list[LiveState]:
    """Of that hand."""
    hand, told, gap, found = HandTracker(), 0.0, generate_gaps(), []
    for index in range(count):
        while told <= index * STATE_S:
            hand.push(HandEvent(told, *compute_position(told), compute_force(told)))
            told += next(gap)
        found.append(hand.state(index * STATE_S))
    return found


def _measure_field(hand: list[LiveState]) -> list[Row]:
    """F_Θ state by state, both ways, and the largest difference of an amplitude."""
    field, material = load_field(), get_material(LIVE_MATERIAL)
    emission = LiveEmission(field, material.token.astype(np.float64), material.mechanics, "pen")
    quick, plain, error = Times(), Times(), 0.0
    for state in hand:
        direction, one = np.array(state.direction), np.ones(1)
        condition = Condition(
            material.token[None].astype(np.float64), (material.mechanics,), np.zeros(1, np.int32), direction[None],
            state.speed * one, state.force * one, one > 0.0, "pen",
        )  # fmt: skip
        wanted = plain.measure(lambda condition=condition: evaluate(field, condition)).alpha[0, 0]  # type: ignore[misc]
        found = quick.measure(
            lambda state=state, direction=direction: emission.evaluate(direction, state.speed, state.force, True)  # type: ignore[misc]
        )[0]
        loud = wanted > 1e-3 * max(float(wanted.max()), 1e-12)
        if loud.any():
            error = max(error, float(np.abs(20.0 * np.log10(found[loud] / wanted[loud])).max()))
    reference = Row(LIVE_NAME, "F_Θ of one state, as offline", plain.seconds, plain.cpu)
    ratio = quick.compute_ratio(plain)
    return [
        reference,
        Row(LIVE_NAME, "F_Θ of one state", quick.seconds, quick.cpu, ratio, reference.method, error, "dB"),
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
    """sink, and when it got what. writes: (time, frames that it had then, those of them not yet played)."""

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
    """Seconds of each event to the wire, and until it was played. per_frame: frames of the sink for one of the source.
    rate_hz: of the sink."""
    ends = [frames for _, frames, _ in writes]
    wire, played = [], []
    for each in outputs:
        first = ceil(each.frame * per_frame)
        index = bisect_right(ends, first)
        if index < len(writes):
            written_s, frames, owed_s = writes[index]
            wire.append(written_s - each.moved_s)
            played.append(wire[-1] + max(owed_s - (frames - first) / rate_hz, 0.0))
    return wire, played


@contextmanager
def _move_hand(live: LiveSource) -> Iterator[None]:
    """The hand, as long as it is wanted."""
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
