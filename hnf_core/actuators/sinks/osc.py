"""Sink that sends envelopes over OSC (Open Sound Control 1.0, UDP) to receivers that generate the vibration.

Every 10 ms, two messages with one float32 each are sent for each channel c = 1, 2, …:

    /hnf/c/amplitude    0–1 of full scale: amplitude of a sine with the slot's mean square; 0 in silence
    /hnf/c/frequency    Hz: centroid of the power spectrum of the last 20 ms; the last one in silence

Another ADDRESS replaces /hnf. VRChat listens on UDP port 9000 and writes what it receives at /avatar/parameters/NAME
into the avatar's parameter NAME (docs.vrchat.com, "OSC Overview", "OSC Avatar Parameters"): with the address
/avatar/parameters/hnf, a float parameter hnf/1/amplitude gets the amplitude.

UDP has no reply, so it is unknown whether a receiver exists, and one that holds its last value vibrates on if this
program is killed. An underrun or a stop ends in amplitudes of 0, sent `SILENCE_SLOTS` times.
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
from ..sink import RAMP_S, Counts, FadingQueue, SinkFormat, SinkStatus

RATE_HZ = 4000.0
"""Sample rate of the sink; tactile signals end at 1 kHz."""

SLOT_S = 0.01
"""Time between two messages, and length of signal that one describes [s]: a slot."""
QUEUE_S = 0.015
"""Longest queue [s]."""
SILENCE_SLOTS, REPEAT_PERIOD_S = 10, 1e-3
"""Number of times that silence is sent, and the time between repetitions on closing [s]."""
DEFAULT_ADDRESS = "/hnf"
"""First part of every message's address."""
_SLOT_FRAMES = round(SLOT_S * RATE_HZ)

Float = NDArray[np.float64]


def compute_amplitude(counts: ArrayLike) -> Float:
    """Compute the amplitude of a sine with the same mean square as counts (n, channels) → (channels,) 0–1."""
    square = np.square(np.asarray(counts, dtype=np.float64)).mean(axis=0)
    return np.asarray(np.minimum(np.sqrt(2.0 * square) / FULL_SCALE_COUNTS, 1.0))


def compute_centroid_hz(counts: ArrayLike, rate_hz: float) -> Float:
    """Compute the centroid [Hz] of the power spectrum of counts less their mean, (n, channels) → (channels,).

    A Hann window is applied. NaN for channels without any signal besides the mean.
    """
    samples = np.asarray(counts, dtype=np.float64)
    window = np.hanning(len(samples) + 2)[1:-1, None]
    windowed = window * (samples - (window * samples).sum(axis=0) / window.sum())
    power = np.square(np.abs(np.fft.rfft(windowed, axis=0)))
    total = power.sum(axis=0)
    frequency = np.fft.rfftfreq(len(samples), 1.0 / rate_hz)
    has_signal = total > 1e-6 * len(samples)
    return np.where(has_signal, frequency @ power / np.where(has_signal, total, 1.0), np.nan)


class OscSink:
    """Sink for an OSC receiver; a thread of its own sends, so that silence is sent even if no more calls come.

    Parameters
    ----------
    host : str
        Host name or IP address.
    port : int
        UDP port.
    address : str
        First part of every message's address.
    channels : int
        Number of channels.
    """

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
        """Send the envelopes in time, on the sender thread, whose pace is the clock of this sink."""
        recent: Counts = np.zeros((2 * _SLOT_FRAMES, self._channels), dtype=np.int16)
        centroid, silent_slots, due = np.zeros(self._channels), SILENCE_SLOTS, time.monotonic()
        level = np.zeros(self._channels)
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._dropped or self._closing, max(0.0, due - time.monotonic()))
                    # Messages need not be as regular as samples, so wait a little for a late writer.
                    self._changed.wait_for(
                        lambda: not self._queue.would_underrun(_SLOT_FRAMES) or self._dropped, RAMP_S
                    )
                    dropped, self._dropped = self._dropped, False
                    closing = self._closing
                    slot = self._queue.advance(_SLOT_FRAMES)
                    self._changed.notify_all()
                if dropped and level.any():  # the fade-out of a stop is a single step
                    self._send_levels(0.5 * level, centroid)
                    time.sleep(RAMP_S)
                level = compute_amplitude(slot) if not (dropped or closing) else np.zeros(self._channels)
                recent = np.concatenate([recent[_SLOT_FRAMES:], slot])
                new_centroid = compute_centroid_hz(recent, RATE_HZ)
                centroid = np.where(np.isfinite(new_centroid) & (level > 0.0), new_centroid, centroid)
                silent_slots = 0 if level.any() else silent_slots + 1
                if silent_slots <= SILENCE_SLOTS or closing:
                    self._send_levels(level, centroid)
                if closing:
                    for _ in range(SILENCE_SLOTS - silent_slots):  # no later slot repeats it
                        time.sleep(REPEAT_PERIOD_S)
                        self._send_levels(level, centroid)
                    return
                due = max(due + SLOT_S, time.monotonic() - SLOT_S)
        except Exception as error:  # any failure must wake a writer that waits for room
            with self._changed:
                self._problem = f"cannot be reached any more ({getattr(error, 'strerror', None) or error})"
                self._changed.notify_all()
        finally:
            self._client.close()

    def _send_levels(self, level: Float, pitch: Float) -> None:
        with suppress(BlockingIOError):  # the network is busy; the next slot repeats it
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
    """Resolve a host once, so that not every message does it; prefer IPv4, since most receivers listen on it only.

    Raises OSError if the host has no address.
    """
    addresses = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    return str(min(addresses, key=lambda info: info[0] != socket.AF_INET)[4][0])
