"""Play a source on a sink with two threads, ahead of time and within the device's limits.

    producer: source → processors → resampler → limiter → ring buffer        pump: ring buffer → sink

The pump sends finished counts, so a slow source cannot delay a device that still has frames. If no more frames come,
the device's own queue acts as a watchdog: it fades to silence by itself.
"""

from __future__ import annotations

import atexit
import math
import os
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import asdict, dataclass
from types import TracebackType
from typing import Any

import numpy as np

from ..errors import DeviceError, HnfError, UsageError
from . import runtime
from .limiter import THERMAL_STATE
from .limits import FULL_SCALE_COUNTS, Limits
from .signal_chain import Processor, SignalChain, Source
from .sink import Counts, Sink, SinkFormat, SinkStatus

_BIN_MS = 0.01
_BINS = 10_000


class DurationHistogram:
    """Histogram of durations in bins of 10 µs up to 100 ms; its size does not grow."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS + 1, dtype=np.int64)
        self.count = 0
        self.max_ms = 0.0

    def record(self, seconds: float) -> None:
        milliseconds = max(seconds * 1e3, 0.0)
        self._counts[min(int(milliseconds / _BIN_MS), _BINS)] += 1
        self.count += 1
        self.max_ms = max(self.max_ms, milliseconds)

    def percentile_ms(self, percent: float) -> float:
        """Return a percentile [ms], rounded up to a bin's edge but at most the maximum; 0 if nothing was recorded.

        Percentiles from 100 ms on are the maximum.
        """
        if self.count == 0:
            return 0.0
        bin_index = int(np.searchsorted(np.cumsum(self._counts), self.count * percent / 100.0))
        return self.max_ms if bin_index >= _BINS else min((bin_index + 1) * _BIN_MS, self.max_ms)


@dataclass(frozen=True)
class StreamReport:
    """State and statistics of a stream.

    Attributes
    ----------
    state : str
        "ready", "playing", "paused" or "ended".
    device : str
        The device's own name.
    blocks : int
        Blocks rendered.
    frames : int
        Frames written to the sink.
    underruns : int
        Times that the device ran out of frames.
    errors : int
        Damaged or lost frames on the wire.
    compute_p99_ms, compute_highest_ms : float
        Time to render a block, from its source to finished counts [ms].
    compute_cpu_p99_ms : float
        CPU time of it on the producer's thread [ms].
    latency_p99_ms, latency_highest_ms : float
        Time from the request of a block until the sink has it [ms]. A resampler without low latency returns many blocks
        at once, of which the last wait until the first are played.
    peak : float
        Largest level sent, as a fraction of full scale.
    limited_samples, nonfinite_samples : int
        Samples changed by the limiter.
    device_limited_samples : int
        Samples changed by the device's own limits, after the limiter.
    played_s : float
        Time played by the device [s].
    level_m_s2 : float
        RMS of about the last 20 ms [m/s²].
    temperature_c : float or None
        Coil temperature [°C], if the device reports it.
    resampler : str
        Name of the rate converter.
    realtime : bool
        Whether the system granted both threads real-time priority; never requested for files.
    problem : str
        Why the stream ended, or "".
    """

    state: str = "ready"
    device: str = ""
    blocks: int = 0
    frames: int = 0
    underruns: int = 0
    errors: int = 0
    compute_p99_ms: float = 0.0
    compute_highest_ms: float = 0.0
    compute_cpu_p99_ms: float = 0.0
    latency_p99_ms: float = 0.0
    latency_highest_ms: float = 0.0
    peak: float = 0.0
    limited_samples: int = 0
    nonfinite_samples: int = 0
    device_limited_samples: int = 0
    played_s: float = 0.0
    level_m_s2: float = 0.0
    temperature_c: float | None = None
    resampler: str = ""
    realtime: bool = False
    problem: str = ""

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


class RingBuffer:
    """Bounded queue of frames between one writer thread and one reader thread; both sleep while they wait.

    Each `put` carries a time stamp from the writer's clock; `get` returns that of the oldest frame it gives.

    Parameters
    ----------
    capacity : int
        Size [frames].
    channels : int
        Number of channels.
    """

    def __init__(self, capacity: int, channels: int) -> None:
        self._frames = np.zeros((max(capacity, 1), channels), dtype=np.int16)
        self._written = 0
        self._read = 0
        self._stamps: deque[tuple[int, float]] = deque()
        self._finished = False
        self._closed = False
        self._condition = threading.Condition()

    def wait_for_space(self, frames: int, timeout_s: float) -> bool:
        """Wait up to `timeout_s` for room for `frames`, at most the ring's size; return whether there is room.

        A closed ring returns False at once.
        """
        wanted = min(frames, len(self._frames))
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._count_free_frames() >= wanted, timeout_s)
            return not self._closed and self._count_free_frames() >= wanted

    def put(self, counts: Counts, stamp: float = 0.0) -> bool:
        """Append (n, channels) counts, sleeping while the ring is full; return False if it was closed before."""
        start = 0
        while start < len(counts):
            with self._condition:
                self._condition.wait_for(lambda: self._closed or self._count_free_frames() > 0)
                if self._closed:
                    return False
                block = counts[start : start + self._count_free_frames()]
                slots = (self._written + np.arange(len(block))) % len(self._frames)
                self._frames[slots] = block
                self._written += len(block)
                self._stamps.append((self._written, stamp))
                self._condition.notify_all()
            start += len(block)
        return True

    def get(self, max_frames: int, timeout_s: float) -> tuple[Counts, float]:
        """Return up to `max_frames` frames in order, and the time stamp of the first.

        Sleeps while the ring is empty, for at most `timeout_s`; then it returns no frames, as it does after the end.
        """
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._finished or self._written > self._read, timeout_s)
            count = 0 if self._closed else min(max_frames, self._written - self._read)
            while self._stamps and self._stamps[0][0] <= self._read:
                self._stamps.popleft()
            stamp = self._stamps[0][1] if count else 0.0
            counts = self._frames[(self._read + np.arange(count)) % len(self._frames)]
            self._read += count
            self._condition.notify_all()
            return counts, stamp

    def finish(self) -> None:
        """Mark the end of the input; the frames in the ring can still be read."""
        with self._condition:
            self._finished = True
            self._condition.notify_all()

    def close(self) -> None:
        """Drop all frames and wake both threads."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()

    @property
    def ended(self) -> bool:
        """True if no more frames will come out."""
        with self._condition:
            return self._closed or (self._finished and self._written == self._read)

    def _count_free_frames(self) -> int:
        return len(self._frames) - (self._written - self._read)


_OPEN_TIMEOUT_S = 10.0
_JOIN_TIMEOUT_S = 2.0
_FINISH_TIMEOUT_S = 2.0
_POLL_S = 0.005
"""Longest time between the pump's checks for a stop and for the device's status [s]."""
_SPACE_TIMEOUT_S = 0.1
_LEVEL_WINDOW_S = 0.02


class Stream:
    """A source playing on a sink, once.

    As a context manager it stops when left. A fault of the device or of the source ends the stream in silence and is
    described in `report.problem`; another stream may follow at once.

    Parameters
    ----------
    source : Source
        Where the samples come from.
    sink : Sink
        Where the counts go; opened by `start`.
    limits : Limits
        Limits of the actuator.
    block_s : float
        Length of a block [s].
    ahead_blocks : int
        Number of blocks rendered in advance (1 for live touch).
    processors : sequence of Processor
        Filters applied before resampling.
    low_latency : bool
        Passed to `make_resampler`.

    Attributes
    ----------
    compute, compute_cpu, latency : DurationHistogram
        Times of each block; see `StreamReport`.
    prepared : DurationHistogram
        Time that the source computed ahead after each block.

    Raises
    ------
    UsageError
        If `block_s` is not within 0.5 ms–1 s, or `ahead_blocks` is below 1.
    """

    def __init__(
        self,
        source: Source,
        sink: Sink,
        limits: Limits,
        *,
        block_s: float = 0.005,
        ahead_blocks: int = 3,
        processors: Sequence[Processor] = (),
        low_latency: bool = True,
    ) -> None:
        if not (0.0005 <= block_s <= 1.0 and ahead_blocks >= 1):
            raise UsageError(
                f"a stream cannot be made of {ahead_blocks} blocks of {block_s * 1e3:g} ms ahead.",
                remedy="Give 0.5 to 1000 ms, and at least one block.",
            )
        self._source, self._sink, self._limits, self._processors = source, sink, limits, tuple(processors)
        self._block_s, self._ahead_blocks, self._low_latency = block_s, ahead_blocks, low_latency
        self._opened: Future[SinkFormat] = Future()
        self._threads: list[threading.Thread] = []
        self._started = threading.Event()
        self._stopping = threading.Event()
        self._ended = threading.Event()
        self._paused = False
        self._lock = threading.Lock()
        self.compute, self.compute_cpu, self.prepared, self.latency = (DurationHistogram() for _ in range(4))
        self._device: SinkFormat | None = None
        self._chain: SignalChain | None = None
        self._ring: RingBuffer | None = None
        self._status = SinkStatus()
        self._frames = self._peak = 0
        self._mean_square = 0.0
        self._rate = 1.0
        self._realtime = False
        self._problem = ""

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self, on_open: Callable[[SinkFormat], None] = lambda device: None) -> SinkFormat:
        """Open the sink and play.

        Parameters
        ----------
        on_open : callable
            Called with the open device before anything is sent; an exception from it stops the stream.

        Raises
        ------
        DeviceError
            If the sink cannot be opened.
        UsageError
            If signal, limits and device do not fit, or the stream was started before.
        """
        with self._lock:
            if self._threads or self._stopping.is_set():
                raise UsageError("a stream plays once.", remedy="Make another one.")
            self._threads.append(threading.Thread(target=self._pump, name="hnf-pump", daemon=True))
        _active_streams.add(self)
        self._threads[0].start()
        try:
            device = self._opened.result(_OPEN_TIMEOUT_S)
        except TimeoutError as error:
            self.stop()
            raise DeviceError(
                f"the device did not open within {_OPEN_TIMEOUT_S:g} s.", remedy="Unplug it, plug it in, and try again."
            ) from error
        try:
            on_open(device)
        except BaseException:
            self.stop()
            raise
        self._started.set()
        return device

    def stop(self) -> None:
        """Silence and release the device now, with its own soft stop.

        May be called from any thread, and repeatedly.
        """
        self._stopping.set()
        self._started.set()
        with self._lock:
            threads, device, ring = list(self._threads), self._device, self._ring
        if ring is not None and device is not None and device.live:
            ring.close()  # drops the finished frames; the device fades out by itself
        if not threads:
            self._ended.set()
        elif threading.current_thread() in threads:
            pass  # a source or sink stopped its own stream; waiting here for its own thread would never end
        elif not self._ended.wait(2.0 * _JOIN_TIMEOUT_S):
            self._set_problem(
                DeviceError("the device does not answer.", remedy="Unplug it, plug it in, and try again."), ""
            )

    def pause(self) -> None:
        """Fade out and halt the source; silence is sent to the device."""
        self._paused = True

    def resume(self) -> None:
        """Continue at the paused position with a fade-in."""
        self._paused = False

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait up to `timeout_s`; return whether the stream has ended (played out, stopped or failed)."""
        return self._ended.wait(timeout_s)

    @property
    def report(self) -> StreamReport:
        """Current state and statistics; may be read from any thread."""
        with self._lock:
            limiter = self._chain.limiter if self._chain else None
            if self._ended.is_set():
                state = "ended"
            elif self._device is None:
                state = "ready"
            else:
                state = "paused" if self._paused else "playing"
            return StreamReport(
                state=state,
                device=self._device.device if self._device else "",
                blocks=self.compute.count,
                frames=self._frames,
                underruns=self._status.underruns,
                errors=self._status.errors,
                compute_p99_ms=self.compute.percentile_ms(99.0),
                compute_highest_ms=self.compute.max_ms,
                compute_cpu_p99_ms=self.compute_cpu.percentile_ms(99.0),
                latency_p99_ms=self.latency.percentile_ms(99.0),
                latency_highest_ms=self.latency.max_ms,
                peak=self._peak / FULL_SCALE_COUNTS,
                limited_samples=limiter.limited if limiter else 0,
                nonfinite_samples=self._chain.nonfinite if self._chain else 0,
                device_limited_samples=self._status.limited,
                played_s=self._status.played / self._rate,
                level_m_s2=float(np.sqrt(self._mean_square)) * self._limits.full_scale_m_s2 / FULL_SCALE_COUNTS,
                temperature_c=self._status.temperature_c,
                resampler=self._chain.resampler_name if self._chain else "",
                realtime=self._realtime,
                problem=self._problem,
            )

    # ------------------------------------------------------------------ producer

    def _produce(self, chain: SignalChain, ring: RingBuffer, frames: int) -> None:
        try:
            if self._realtime and not runtime.request_realtime_priority():
                self._realtime = False
            try:
                self._fill_ring(chain, ring, frames)
            except Exception as error:
                self._set_problem(error, "the signal cannot be made any further")
            ring.put(chain.limiter.flush())
        finally:
            ring.finish()

    def _fill_ring(self, chain: SignalChain, ring: RingBuffer, frames: int) -> None:
        while not self._stopping.is_set() and not chain.ended:
            # Wait for room before reading the source, so that no block ages outside the ring.
            if not ring.wait_for_space(frames, _SPACE_TIMEOUT_S):
                continue
            stamp, cpu_s = time.perf_counter(), time.thread_time()
            counts = chain.limiter.soft_stop(frames) if self._paused else chain.render_block(frames)
            wall_s, cpu_s = time.perf_counter() - stamp, time.thread_time() - cpu_s
            with self._lock:
                self.compute.record(wall_s)
                self.compute_cpu.record(cpu_s)
            ring.put(counts, stamp)
            stamp = time.perf_counter()
            chain.prepare()
            with self._lock:
                self.prepared.record(time.perf_counter() - stamp)

    # ------------------------------------------------------------------ pump

    def _pump(self) -> None:
        producer: threading.Thread | None = None
        runtime.enter_low_latency()
        try:
            device = self._sink.open()
            _stop_first_at_exit()
            # A file sink never sleeps on a device's clock; with real-time priority it would block a core for others.
            self._realtime = device.live and runtime.request_realtime_priority()
            heat = THERMAL_STATE.get_heat(device.device, self._limits, device.channels)
            chain = SignalChain(
                self._source, device, self._limits, self._processors, low_latency=self._low_latency, initial_heat=heat
            )
            frames = max(round(self._block_s * device.rate_hz), 1)
            ring = RingBuffer(self._ahead_blocks * frames, device.channels)
            with self._lock:
                self._device, self._chain, self._ring, self._rate = device, chain, ring, device.rate_hz
                producer = threading.Thread(
                    target=self._produce, args=(chain, ring, frames), name="hnf-producer", daemon=True
                )
                self._threads.append(producer)
            self._opened.set_result(device)
            self._started.wait()
            producer.start()
            self._send(ring, device, frames)
        except Exception as error:
            if self._opened.done():
                self._set_problem(error, "the device failed")
            else:
                self._opened.set_exception(error)
        finally:
            self._close(producer)

    def _send(self, ring: RingBuffer, device: SinkFormat, frames: int) -> None:
        min_write = max(min(frames, device.queue_frames // 4), 1)
        while not self._stopping.is_set():
            free_frames = self._sink.wait(_POLL_S)
            if free_frames < min_write and not ring.ended:
                self._stopping.wait((min_write - free_frames) / device.rate_hz)  # avoids many tiny writes
                free_frames = self._sink.wait(_POLL_S)
            counts, stamp = ring.get(free_frames, _POLL_S) if free_frames > 0 else (_NO_COUNTS, 0.0)
            if len(counts):
                self._sink.write(counts)
            self._update_statistics(counts, stamp, self._sink.status())
            if ring.ended:
                if not self._stopping.is_set():
                    self._sink.finish(_FINISH_TIMEOUT_S)
                    self._update_statistics(_NO_COUNTS, 0.0, self._sink.status())
                return
        if not device.live:
            self._drain_ring(ring)

    def _drain_ring(self, ring: RingBuffer) -> None:
        """Write the frames left, and the limiter's fade-out, to a sink that has no soft stop of its own (a file)."""
        deadline = time.monotonic() + _JOIN_TIMEOUT_S
        while not ring.ended and time.monotonic() < deadline:
            counts, stamp = ring.get(self._sink.wait(_POLL_S), _POLL_S)
            if len(counts):
                self._sink.write(counts)
            self._update_statistics(counts, stamp, self._sink.status())

    def _update_statistics(self, counts: Counts, stamp: float, status: SinkStatus) -> None:
        now = time.perf_counter()
        with self._lock:
            self._status = status
            if len(counts) == 0:
                return
            self._frames += len(counts)
            levels = counts.astype(np.int64)
            self._peak = max(self._peak, int(np.abs(levels).max()))
            weight = 1.0 - math.exp(-len(counts) / (_LEVEL_WINDOW_S * self._rate))
            self._mean_square += weight * (float(np.square(levels).mean()) - self._mean_square)
            if stamp:
                self.latency.record(now - stamp)

    def _close(self, producer: threading.Thread | None) -> None:
        self._stopping.set()
        try:
            if self._ring is not None:
                self._ring.close()
            self._sink.close()
            with suppress(Exception):  # for example, if a file could not be written in the end
                self._set_problem(DeviceError(self._sink.status().problem), "")
            if producer is not None and producer.ident is not None:
                producer.join(_JOIN_TIMEOUT_S)
                if producer.is_alive():
                    self._set_problem(DeviceError("the signal's source does not answer.", remedy="Start it anew."), "")
        finally:
            with self._lock:
                self._mean_square = 0.0
                if self._chain is not None and self._device is not None and self._device.coil:
                    THERMAL_STATE.record(self._device.device, self._limits, self._chain.limiter.heat)
            _active_streams.discard(self)
            runtime.exit_low_latency()
            self._ended.set()

    def _set_problem(self, error: Exception, context: str) -> None:
        """Store the first problem; later ones are ignored."""
        unexpected = f"{context} ({type(error).__name__}: {error}). Start it anew; if that does not help, report it."
        text = str(error) if isinstance(error, HnfError) else unexpected
        with self._lock:
            self._problem = self._problem or text


_NO_COUNTS: Counts = np.zeros((0, 1), dtype=np.int16)
_active_streams: weakref.WeakSet[Stream] = weakref.WeakSet()


def _stop_all() -> None:
    """Stop every stream that still plays when the interpreter exits."""
    for stream in list(_active_streams):
        stream.stop()


if hasattr(os, "register_at_fork"):
    # The streams' threads exist only in the parent, so a child could never wait for them.
    os.register_at_fork(after_in_child=_active_streams.clear)


def _stop_first_at_exit() -> None:
    """Register `_stop_all` anew, so that it runs before the exit handlers of libraries that sinks have loaded.

    Handlers run in reverse order of registration; a library would otherwise end while a stream still uses it.
    """
    atexit.unregister(_stop_all)
    atexit.register(_stop_all)
