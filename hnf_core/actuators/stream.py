"""A source played on a sink: ahead of time, on threads of its own, within the device's limits.

    producer: source → stages → resampler → limiter → ring        pump: ring → sink

What the pump sends is ready counts, so nothing a source does can hold up a device that still has frames; and when
nothing comes any more, the device's own queue is the watchdog: it fades to silence by itself.
"""

from __future__ import annotations

import atexit
import math
import os
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from types import TracebackType

import numpy as np

from ..errors import DeviceError, HnfError, UsageError
from . import calm, urgency
from .chain import Chain
from .limits import COUNTS, Limits
from .report import Durations, StreamReport
from .ring import Ring
from .sink import Counts, Sink, SinkFormat, SinkStatus
from .source import Source
from .stage import Stage
from .warmth import WARMTH

_OPEN_S = 10.0
_JOIN_S = 2.0
_FINISH_S = 2.0
_LOOK_S = 0.005
"""How often the pump looks whether it shall stop and how the device is, at the least."""
_ASLEEP_S = 0.1
_LEVEL_S = 0.02


class Stream:
    """source on sink, once. ahead_blocks: of block_s each, ready in advance (1 for what is touched live).
    prompt: see resampler(). compute, compute_cpu, latency: of each block; see StreamReport. prepared: what the source
    made ready after each, once it was on its way.

    A context manager: leaving it stops. A problem of the device or of the source ends the stream in silence and is
    told by report.problem; another Stream may follow at once.
    """

    def __init__(
        self,
        source: Source,
        sink: Sink,
        limits: Limits,
        *,
        block_s: float = 0.005,
        ahead_blocks: int = 3,
        stages: Sequence[Stage] = (),
        prompt: bool = True,
    ) -> None:
        """Raises UsageError where block_s is not within 0.5 ms … 1 s or nothing is made ahead."""
        if not (0.0005 <= block_s <= 1.0 and ahead_blocks >= 1):
            raise UsageError(
                f"a stream cannot be made of {ahead_blocks} blocks of {block_s * 1e3:g} ms ahead.",
                remedy="Give 0.5 to 1000 ms, and at least one block.",
            )
        self._source, self._sink, self._limits, self._stages = source, sink, limits, tuple(stages)
        self._block_s, self._ahead, self._prompt = block_s, ahead_blocks, prompt
        self._opened: Future[SinkFormat] = Future()
        self._threads: list[threading.Thread] = []
        self._go = threading.Event()
        self._stopping = threading.Event()
        self._ended = threading.Event()
        self._paused = False
        self._lock = threading.Lock()
        self.compute, self.compute_cpu, self.prepared, self.latency = (Durations() for _ in range(4))
        self._device: SinkFormat | None = None
        self._chain: Chain | None = None
        self._ring: Ring | None = None
        self._status = SinkStatus()
        self._frames = self._peak = 0
        self._square = 0.0
        self._rate = 1.0
        self._realtime = False
        self._problem = ""

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self, look: Callable[[SinkFormat], None] = lambda device: None) -> SinkFormat:
        """Open the sink and play. look: called when it is open, before anything leaves; what it raises stops.

        Raises DeviceError where it cannot be opened, UsageError where signal, limits and device do not fit or the
        stream was started before."""
        with self._lock:
            if self._threads or self._stopping.is_set():
                raise UsageError("a stream plays once.", remedy="Make another one.")
            self._threads.append(threading.Thread(target=self._pump, name="hnf-pump", daemon=True))
        _live.add(self)
        self._threads[0].start()
        try:
            device = self._opened.result(_OPEN_S)
        except TimeoutError as error:
            self.stop()
            raise DeviceError(
                f"the device did not open within {_OPEN_S:g} s.", remedy="Unplug it, plug it in, and try again."
            ) from error
        try:
            look(device)
        except BaseException:
            self.stop()
            raise
        self._go.set()
        return device

    def stop(self) -> None:
        """Silence now, by the device's own soft stop, and give the device back. From any thread; again is harmless."""
        self._stopping.set()
        self._go.set()
        with self._lock:
            threads, device, ring = list(self._threads), self._device, self._ring
        if ring is not None and device is not None and device.live:
            ring.close()  # what is ready is dropped: the device fades by itself
        if not threads:
            self._ended.set()
        elif threading.current_thread() in threads:
            pass  # a source or a sink that stops its own stream goes on first
        elif not self._ended.wait(2.0 * _JOIN_S):
            self._tell(DeviceError("the device does not answer.", remedy="Unplug it, plug it in, and try again."), "")

    def pause(self) -> None:
        """Fade out and hold the source where it is; the device goes on with silence."""
        self._paused = True

    def resume(self) -> None:
        """Fade in where it was paused."""
        self._paused = False

    def wait(self, timeout_s: float | None = None) -> bool:
        """Whether it has ended (played out, stopped or failed), after at most timeout_s."""
        return self._ended.wait(timeout_s)

    @property
    def report(self) -> StreamReport:
        """Now; from any thread."""
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
                compute_highest_ms=self.compute.highest_ms,
                compute_cpu_p99_ms=self.compute_cpu.percentile_ms(99.0),
                latency_p99_ms=self.latency.percentile_ms(99.0),
                latency_highest_ms=self.latency.highest_ms,
                peak=self._peak / COUNTS,
                limited_samples=limiter.limited if limiter else 0,
                nonfinite_samples=self._chain.nonfinite if self._chain else 0,
                device_limited_samples=self._status.limited,
                played_s=self._status.played / self._rate,
                level_m_s2=float(np.sqrt(self._square)) * self._limits.full_scale_m_s2 / COUNTS,
                temperature_c=self._status.temperature_c,
                resampler=self._chain.resampler if self._chain else "",
                realtime=self._realtime,
                problem=self._problem,
            )

    # ------------------------------------------------------------------ producer

    def _produce(self, chain: Chain, ring: Ring, frames: int) -> None:
        try:
            if self._realtime and not urgency.ask():
                self._realtime = False
            try:
                self._fill(chain, ring, frames)
            except Exception as error:
                self._tell(error, "the signal cannot be made any further")
            ring.put(chain.limiter.release())
        finally:
            ring.finish()

    def _fill(self, chain: Chain, ring: Ring, frames: int) -> None:
        while not self._stopping.is_set() and not chain.ended:
            # Room first, then the source: nothing it gives grows old before the ring.
            if not ring.wait_room(frames, _ASLEEP_S):
                continue
            stamp, computed = time.perf_counter(), time.thread_time()
            counts = chain.limiter.soft_stop(frames) if self._paused else chain.block(frames)
            taken, computed = time.perf_counter() - stamp, time.thread_time() - computed
            with self._lock:
                self.compute.note(taken)
                self.compute_cpu.note(computed)
            ring.put(counts, stamp)
            stamp = time.perf_counter()
            chain.prepare()
            with self._lock:
                self.prepared.note(time.perf_counter() - stamp)

    # ------------------------------------------------------------------ pump

    def _pump(self) -> None:
        producer: threading.Thread | None = None
        calm.hold()
        try:
            device = self._sink.open()
            _stop_first_at_exit()
            self._realtime = device.live and urgency.ask()  # as fast as it can, it would keep a core from all others
            heat = WARMTH.heat(device.device, self._limits, device.channels)
            chain = Chain(self._source, device, self._limits, self._stages, prompt=self._prompt, heat=heat)
            frames = max(round(self._block_s * device.rate_hz), 1)
            ring = Ring(self._ahead * frames, device.channels)
            with self._lock:
                self._device, self._chain, self._ring, self._rate = device, chain, ring, device.rate_hz
                producer = threading.Thread(
                    target=self._produce, args=(chain, ring, frames), name="hnf-producer", daemon=True
                )
                self._threads.append(producer)
            self._opened.set_result(device)
            self._go.wait()
            producer.start()
            self._send(ring, device, frames)
        except Exception as error:
            if self._opened.done():
                self._tell(error, "the device failed")
            else:
                self._opened.set_exception(error)
        finally:
            self._end(producer)

    def _send(self, ring: Ring, device: SinkFormat, frames: int) -> None:
        grain = max(min(frames, device.queue_frames // 4), 1)
        while not self._stopping.is_set():
            room = self._sink.wait(_LOOK_S)
            if room < grain and not ring.ended:
                self._stopping.wait((grain - room) / device.rate_hz)  # a few frames at a time would only keep us busy
                room = self._sink.wait(_LOOK_S)
            counts, stamp = ring.take(room, _LOOK_S) if room > 0 else (_NONE, 0.0)
            if len(counts):
                self._sink.write(counts)
            self._note(counts, stamp, self._sink.status())
            if ring.ended:
                if not self._stopping.is_set():
                    self._sink.finish(_FINISH_S)
                    self._note(_NONE, 0.0, self._sink.status())
                return
        if not device.live:
            self._let_end(ring)

    def _let_end(self, ring: Ring) -> None:
        """A file has no soft stop of its own: it gets what was made until then, and the limiter's."""
        until = time.monotonic() + _JOIN_S
        while not ring.ended and time.monotonic() < until:
            counts, stamp = ring.take(self._sink.wait(_LOOK_S), _LOOK_S)
            if len(counts):
                self._sink.write(counts)
            self._note(counts, stamp, self._sink.status())

    def _note(self, counts: Counts, stamp: float, status: SinkStatus) -> None:
        now = time.perf_counter()
        with self._lock:
            self._status = status
            if len(counts) == 0:
                return
            self._frames += len(counts)
            wide = counts.astype(np.int64)
            self._peak = max(self._peak, int(np.abs(wide).max()))
            forget = 1.0 - math.exp(-len(counts) / (_LEVEL_S * self._rate))
            self._square += forget * (float(np.square(wide).mean()) - self._square)
            if stamp:
                self.latency.note(now - stamp)

    def _end(self, producer: threading.Thread | None) -> None:
        self._stopping.set()
        try:
            if self._ring is not None:
                self._ring.close()
            self._sink.close()
            with suppress(Exception):  # a file, say, that could not be written after all
                self._tell(DeviceError(self._sink.status().problem), "")
            if producer is not None and producer.ident is not None:
                producer.join(_JOIN_S)
                if producer.is_alive():
                    self._tell(DeviceError("the signal's source does not answer.", remedy="Start it anew."), "")
        finally:
            with self._lock:
                self._square = 0.0
                if self._chain is not None and self._device is not None and self._device.coil:
                    WARMTH.note(self._device.device, self._limits, self._chain.limiter.heat)
            _live.discard(self)
            calm.release()
            self._ended.set()

    def _tell(self, error: Exception, what: str) -> None:
        """The first problem is the one that is told."""
        unforeseen = f"{what} ({type(error).__name__}: {error}). Start it anew; if that does not help, report it."
        text = str(error) if isinstance(error, HnfError) else unforeseen
        with self._lock:
            self._problem = self._problem or text


_NONE: Counts = np.zeros((0, 1), dtype=np.int16)
_live: weakref.WeakSet[Stream] = weakref.WeakSet()


def _stop_all() -> None:
    """The interpreter ends: so does all that still plays."""
    for stream in list(_live):
        stream.stop()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_live.clear)  # its threads are the parent's: nobody here could be waited for


def _stop_first_at_exit() -> None:
    """What was registered last runs first: a library that a sink has just loaded would end below what still plays."""
    atexit.unregister(_stop_all)
    atexit.register(_stop_all)
