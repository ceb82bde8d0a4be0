"""Envelopes over OSC (Open Sound Control 1.0, UDP), for receivers that make the vibration themselves.

Every 10 ms, for each channel c = 1 … , two messages with one float32 each:

    /hnf/c/amplitude    0–1 of full scale: that of a sine with the slot's mean square; 0 where it is silent
    /hnf/c/frequency    Hz: the centroid of the last 20 ms' power spectrum; the last one where it is silent

Another ADDRESS takes the place of /hnf. VRChat listens on UDP port 9000 and writes what comes at
/avatar/parameters/NAME into the avatar's parameter NAME (docs.vrchat.com, "OSC Overview", "OSC Avatar Parameters"):
with /avatar/parameters/hnf as the address, a float parameter hnf/1/amplitude gets the amplitude.

UDP says nothing back: whether anybody listens is not known, and a receiver that keeps its last value vibrates on when
this program is killed. What is missing or stopped here ends in amplitudes of 0, said SILENCE_SLOTS times.
"""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import DeviceError
from ..limits import FULL_SCALE_COUNTS
from ..runtime import import_optional
from ..sink import Counts, SinkFormat, SinkStatus
from .fading_queue import RAMP_S, FadingQueue

RATE_HZ = 4000.0
"""Touch ends at 1 kHz."""

SLOT_S = 0.01
QUEUE_S = 0.015
SILENCE_SLOTS, REPEAT_PERIOD_S = 10, 1e-3
DEFAULT_ADDRESS = "/hnf"
_SLOT_FRAMES = round(SLOT_S * RATE_HZ)

Float = NDArray[np.float64]


def compute_amplitude(counts: ArrayLike) -> Float:
    """(n, channels) → (channels,): 0–1 of full scale, of the sine with the same mean square."""
    square = np.square(np.asarray(counts, dtype=np.float64)).mean(axis=0)
    return np.asarray(np.minimum(np.sqrt(2.0 * square) / FULL_SCALE_COUNTS, 1.0))


def compute_centroid_hz(counts: ArrayLike, rate_hz: float) -> Float:
    """(n, channels) → (channels,): centroid of the power spectrum without its mean (Hann window); NaN where there is
    nothing but a mean."""
    given = np.asarray(counts, dtype=np.float64)
    window = np.hanning(len(given) + 2)[1:-1, None]
    heard = window * (given - (window * given).sum(axis=0) / window.sum())
    power = np.square(np.abs(np.fft.rfft(heard, axis=0)))
    whole = power.sum(axis=0)
    frequency = np.fft.rfftfreq(len(given), 1.0 / rate_hz)
    some = whole > 1e-6 * len(given)
    return np.where(some, frequency @ power / np.where(some, whole, 1.0), np.nan)


class OscSink:
    """host, port: where to. address: what every message's begins with. A thread of its own sends, so that silence is
    said also when nobody calls any more."""

    def __init__(self, host: str, port: int, address: str = DEFAULT_ADDRESS, channels: int = 1) -> None:
        self._host, self._port, self._address, self._channels = host, port, address.rstrip("/"), channels
        self._client: Any = None
        self._thread: threading.Thread | None = None
        self._changed = threading.Condition()
        self._queue = self._make_queue()
        self._dropped = self._closing = False
        self._problem = ""

    def open(self) -> SinkFormat:
        udp = import_optional("pythonosc.udp_client")
        self.close()
        try:
            self._client = udp.SimpleUDPClient(_resolve_host(self._host, self._port), self._port)
        except (OSError, OverflowError, UnicodeError) as error:
            raise self._make_device_error(
                f"cannot be reached ({getattr(error, 'strerror', None) or error})",
                "Check the host's name and the port.",
            ) from error
        self._queue, self._dropped, self._closing, self._problem = self._make_queue(), False, False, ""
        self._thread = threading.Thread(target=self._send_loop, name="hnf-osc", daemon=True)
        self._thread.start()
        where = f"OSC {self._host}:{self._port}{self._address}"
        return SinkFormat(RATE_HZ, self._channels, self._queue.size, where)

    def wait(self, timeout_s: float) -> int:
        with self._changed:
            self._check()
            self._changed.wait_for(lambda: self._problem or self._queue.queued < self._queue.size, timeout_s)
            self._check()
            return self._queue.size - self._queue.queued

    def write(self, counts: Counts) -> None:
        with self._changed:
            self._check()
            self._queue.push(np.array(counts, dtype=np.int16))
            self._changed.notify_all()

    def status(self) -> SinkStatus:
        return SinkStatus(self._queue.played, self._queue.underruns, problem=self._problem)

    def finish(self, timeout_s: float) -> None:
        with self._changed:
            self._check()
            self._queue.finish()
            self._changed.wait_for(lambda: self._problem or self._queue.is_silent, timeout_s)
            self._check()

    def stop(self) -> None:
        with self._changed:
            self._queue.stop()
            self._dropped = True
            self._changed.notify_all()

    def close(self) -> None:
        self.stop()
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(1.0)

    def _send_loop(self) -> None:
        """The sender's thread: its clock is the device's."""
        heard: Counts = np.zeros((2 * _SLOT_FRAMES, self._channels), dtype=np.int16)
        pitch, silent, due = np.zeros(self._channels), SILENCE_SLOTS, time.monotonic()
        level = np.zeros(self._channels)
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._dropped or self._closing, max(0.0, due - time.monotonic()))
                    # Messages need not be as even as samples: who is a little late is waited for.
                    self._changed.wait_for(
                        lambda: not self._queue.would_underrun(_SLOT_FRAMES) or self._dropped, RAMP_S
                    )
                    dropped, self._dropped = self._dropped, False
                    closing = self._closing
                    slot = self._queue.advance(_SLOT_FRAMES)
                    self._changed.notify_all()
                if dropped and level.any():  # the fade of what was stopped is one step here
                    self._send_levels(0.5 * level, pitch)
                    time.sleep(RAMP_S)
                level = compute_amplitude(slot) if not (dropped or closing) else np.zeros(self._channels)
                heard = np.concatenate([heard[_SLOT_FRAMES:], slot])
                now = compute_centroid_hz(heard, RATE_HZ)
                pitch = np.where(np.isfinite(now) & (level > 0.0), now, pitch)
                silent = 0 if level.any() else silent + 1
                if silent <= SILENCE_SLOTS or closing:
                    self._send_levels(level, pitch)
                if closing:
                    for _ in range(SILENCE_SLOTS - silent):  # no later slot would say it again
                        time.sleep(REPEAT_PERIOD_S)
                        self._send_levels(level, pitch)
                    return
                due = max(due + SLOT_S, time.monotonic() - SLOT_S)
        except Exception as error:  # whatever it was, who waits for room must hear of it
            with self._changed:
                self._problem = f"cannot be reached any more ({getattr(error, 'strerror', None) or error})"
                self._changed.notify_all()
        finally:
            self._client.close()

    def _send_levels(self, level: Float, pitch: Float) -> None:
        with suppress(BlockingIOError):  # the network is busy; the next slot says it again
            for channel in range(self._channels):
                self._client.send_message(f"{self._address}/{channel + 1}/amplitude", float(level[channel]))
                self._client.send_message(f"{self._address}/{channel + 1}/frequency", float(pitch[channel]))

    def _make_queue(self) -> FadingQueue:
        return FadingQueue(int(QUEUE_S * RATE_HZ), self._channels, int(RAMP_S * RATE_HZ))

    def _check(self) -> None:
        if self._problem:
            raise self._make_device_error(self._problem, "Check the network, then start again.")
        if self._thread is None:
            raise self._make_device_error("is closed", "Start again.")

    def _make_device_error(self, what: str, remedy: str) -> DeviceError:
        return DeviceError(f"{what}.", where=f"OSC receiver {self._host}:{self._port}", remedy=remedy)


def _resolve_host(host: str, port: int) -> str:
    """Its address, looked up once and not for every message; IPv4 where it has one, since most receivers hear no other.
    Raises OSError where it has none."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    return str(min(found, key=lambda each: each[0] != socket.AF_INET)[4][0])
