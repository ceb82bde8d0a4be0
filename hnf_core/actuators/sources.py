"""Recorded signals as stream sources, and WAV files as acceleration [m/s²].

`BufferSource` plays samples from any position, in a loop if wanted, and cross-fades every change so that none clicks.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import FileError, UsageError
from ..export.wav import read_wav_channels
from ..signal import Signal
from .limits import Limits
from .signal_chain import Samples, Source

CROSSFADE_S = 0.01
"""Length of the cross-fade at a seek, a swap, a change of gain and the seam of a loop [s]."""


class BufferSource:
    """Samples in memory as a source, with seek, swap, gain and loop.

    Every method may be called from any thread. If changes come faster than they fade in, the latest counts.

    Parameters
    ----------
    samples : (n, channels) array_like
        Acceleration [m/s²].
    rate_hz : float
        Sample rate [Hz].
    loop : bool
        Whether to continue at the start after the end, forever.
    start_s : float
        Position to begin at [s].

    Raises
    ------
    UsageError
        If `samples` has another shape or `rate_hz` is not a possible rate.
    """

    def __init__(self, samples: ArrayLike, rate_hz: float, *, loop: bool = False, start_s: float = 0.0) -> None:
        frames = _check_frames(samples)
        if not 0.0 < rate_hz < 1e9:
            raise UsageError(f"a recording does not have {rate_hz:g} frames a second.")
        self._rate = float(rate_hz)
        self._fade = max(round(CROSSFADE_S * rate_hz), 1)
        self._loop = loop
        self._voice = _Voice(frames, _find_frame(start_s, self._rate, len(frames)), self._fade)
        self._old: _Voice | None = None
        self._faded = 0
        self._equal_power = False
        self._pending: tuple[_Voice, bool] | None = None
        self._gain = self._gain_from = self._gain_to = 1.0
        self._gain_at = self._fade
        self._lock = threading.Lock()

    @property
    def rate_hz(self) -> float:
        return self._rate

    @property
    def channels(self) -> int:
        return int(self._voice.samples.shape[1])

    @property
    def position_s(self) -> float:
        """Position of the next frame to be read [s]."""
        with self._lock:
            voice = self._pending[0] if self._pending else self._voice
            return voice.at / self._rate

    @property
    def duration_s(self) -> float:
        with self._lock:
            return len(self._voice.samples) / self._rate

    def seek(self, position_s: float) -> None:
        """Continue at `position_s`, clamped to the recording.

        The cross-fade has equal power, since the two positions are uncorrelated.
        """
        with self._lock:
            samples = (self._pending[0] if self._pending else self._voice).samples
            self._pending = (_Voice(samples, _find_frame(position_s, self._rate, len(samples)), self._fade), True)

    def swap(self, samples: ArrayLike) -> None:
        """Continue in other samples at the present position.

        The cross-fade is linear, since the two signals are mostly alike.

        Raises
        ------
        UsageError
            If the number of channels differs.
        """
        frames = _check_frames(samples)
        with self._lock:
            if frames.shape[1] != self.channels:
                raise UsageError(f"it has {frames.shape[1]} channels and plays {self.channels}.")
            current, equal_power = self._pending or (self._voice, False)
            self._pending = (_Voice(frames, current.at, self._fade, wrapped=current.wrapped), equal_power)

    def set_gain(self, gain: float) -> None:
        """Set the linear gain; raise UsageError unless it is finite and 0 or more."""
        if not 0.0 <= gain < float("inf"):
            raise UsageError(f"a gain is 0 or more, not {gain:g}.")
        with self._lock:
            self._gain_from, self._gain_to, self._gain_at = self._gain, gain, 0

    def set_loop(self, loop: bool) -> None:
        with self._lock:
            self._loop = loop

    def read(self, frames: int) -> Samples:
        """Return the next frames; after fewer than `frames` the source has ended until a seek."""
        with self._lock:
            blocks: list[Samples] = []
            remaining = frames
            while remaining > 0:
                if self._old is None and self._pending is not None:
                    self._start_crossfade()
                count = remaining if self._old is None else min(remaining, self._fade - self._faded)
                block = self._render_crossfade(count)
                blocks.append(block)
                remaining -= count
                if len(block) < count:
                    break
            if not blocks:
                return np.zeros((0, self.channels), dtype=np.float32)
            return self._apply_gain(np.concatenate(blocks))

    def _start_crossfade(self) -> None:
        assert self._pending is not None
        voice, self._equal_power = self._pending
        self._old, self._voice, self._pending, self._faded = self._voice, voice, None, 0
        if self._old.samples is not voice.samples and not self._equal_power:
            voice.at, voice.wrapped = self._old.at, self._old.wrapped  # frames were read since the swap was requested

    def _render_crossfade(self, frames: int) -> Samples:
        new = self._voice.read(frames, self._loop)
        if self._old is None:
            return new
        # The new samples may end within the fade. Their last value is then held, so the fade completes.
        old = self._old.read_padded(frames, self._loop)
        self._faded += frames
        fade_in = (np.arange(self._faded - frames + 1, self._faded + 1) / (self._fade + 1))[:, None]
        fade_in = np.sin(0.5 * np.pi * fade_in) if self._equal_power else fade_in
        fade_out = np.cos(np.arcsin(fade_in)) if self._equal_power else 1.0 - fade_in
        if self._faded >= self._fade:
            self._old = None
        mixed = new * fade_in[: len(new)] + old[: len(new)] * fade_out[: len(new)]
        return np.asarray(mixed, dtype=np.float32)

    def _apply_gain(self, samples: Samples) -> Samples:
        if self._gain_at >= self._fade and self._gain == 1.0:
            return samples
        steps = np.minimum(self._gain_at + np.arange(1, len(samples) + 1), self._fade) / self._fade
        gain = self._gain_from + (self._gain_to - self._gain_from) * steps
        self._gain_at = min(self._gain_at + len(samples), self._fade)
        if len(gain):
            self._gain = float(gain[-1])
        return np.asarray(samples * gain[:, None], dtype=np.float32)


class _Voice:
    """Samples being played, and the read position `at` in them; `wrapped` means that it has passed a loop's end."""

    def __init__(self, samples: Samples, at: int, fade: int, *, wrapped: bool = False) -> None:
        self.samples, self.at, self.wrapped = samples, min(at, len(samples)), wrapped
        self._fade = max(min(fade, len(samples)), 1)

    def read(self, frames: int, loop: bool) -> Samples:
        length = len(self.samples)
        if not loop or length == 0:
            block = self._crossfade_seam(np.arange(self.at, min(self.at + frames, length)), self.wrapped)
            self.at += len(block)
            return block
        positions = self.at + np.arange(frames)
        block = self._crossfade_seam(positions % length, (positions >= length) | self.wrapped)
        self.wrapped |= bool(self.at + frames >= length)
        self.at = (self.at + frames) % length
        return block

    def read_padded(self, frames: int, loop: bool) -> Samples:
        """Return exactly `frames` frames, repeating the last value after the end."""
        block = self.read(frames, loop)
        last = self.samples[-1:] if len(self.samples) else np.zeros((1, self.samples.shape[1]), np.float32)
        return np.concatenate([block, np.repeat(last, frames - len(block), axis=0)])

    def _crossfade_seam(self, frames: NDArray[np.intp], wrapped: bool | NDArray[np.bool_]) -> Samples:
        """Return the frames at the given indices; `wrapped` tells which follow the jump from a loop's end to its start.

        There the recording's last value fades out beneath its first ones, which avoids a jump and keeps the period.
        """
        block = self.samples[frames]
        fading = (frames < self._fade) & wrapped
        if fading.any():
            weight = ((frames[fading] + 1) / (self._fade + 1))[:, None]
            block[fading] = block[fading] * weight + self.samples[-1] * (1.0 - weight)
        return block


def _check_frames(samples: ArrayLike) -> Samples:
    frames = np.asarray(samples, dtype=np.float32)
    if frames.ndim != 2 or frames.shape[1] < 1:
        raise UsageError(f"a recording is (frames, channels), this one is {frames.shape}.")
    return frames


def _find_frame(position_s: float, rate_hz: float, frames: int) -> int:
    """Return the index of the frame nearest to `position_s`; 0 if that is not finite."""
    return round(min(max(position_s * rate_hz, 0.0), frames)) if np.isfinite(position_s) else 0


class TruncatedSource:
    """The first frames of another source."""

    def __init__(self, source: Source, frames: int) -> None:
        self._source, self._frames_left = source, frames

    @property
    def rate_hz(self) -> float:
        return self._source.rate_hz

    @property
    def channels(self) -> int:
        return self._source.channels

    def read(self, frames: int) -> Samples:
        """Return the next frames, until the source is cut off."""
        block = self._source.read(min(frames, self._frames_left))
        self._frames_left -= len(block)
        return block


@dataclass(frozen=True, eq=False)
class Acceleration:
    """Samples (n, channels) float32 [m/s²]; `unit` describes how the file's numbers were interpreted."""

    samples: Samples
    rate_hz: float
    unit: str

    @property
    def duration_s(self) -> float:
        return len(self.samples) / self.rate_hz

    @property
    def peak_m_s2(self) -> float:
        return float(np.abs(self.samples).max(initial=0.0))


def read_acceleration(path: Path, limits: Limits) -> Acceleration:
    """Read a WAV file as acceleration.

    A file that states m/s² is taken as such. A file without a unit whose samples lie within ±1, as in sound files, is
    scaled so that 1 is the actuator's full scale; one that exceeds ±1 is taken as m/s².

    Raises
    ------
    FileError
        If the file cannot be read or has no samples.
    """
    return to_acceleration(read_wav_channels(path), limits, str(path))


def to_acceleration(signals: Sequence[Signal], limits: Limits, where: str) -> Acceleration:
    """Convert the channels of a file to acceleration; see `read_acceleration`. `where` names the file in messages."""
    first = signals[0]
    if len(first.samples) == 0:
        raise FileError("has no samples.", where=where, remedy="Export it again.")
    samples = np.ascontiguousarray(np.stack([signal.samples for signal in signals], axis=1), dtype=np.float32)
    if first.provenance.get("units") != "as stored":
        return Acceleration(samples, first.sample_rate, "in m/s²")
    if np.abs(samples).max(initial=0.0) > 1.0:
        return Acceleration(samples, first.sample_rate, "without a unit, taken as m/s² since it goes beyond 1")
    full = np.float32(limits.full_scale_m_s2)
    unit = f"without a unit: its 1.0 is played as {limits.full_scale_m_s2:g} m/s², full scale"
    return Acceleration(samples * full, first.sample_rate, unit)


def read_accelerations(paths: Sequence[Path], limits: Limits) -> Acceleration:
    """Read several WAV files as channels to be played in parallel, those of the first file first.

    Shorter files are padded with silence.

    Raises
    ------
    UsageError
        If their rates differ.
    FileError
        If a file cannot be read or has no samples.
    """
    recordings = [read_acceleration(path, limits) for path in paths]
    rates = sorted({recording.rate_hz for recording in recordings})
    if len(rates) > 1:
        raise UsageError(
            f"files of {' and '.join(f'{rate:g}' for rate in rates)} Hz cannot be played beside each other.",
            remedy="Export them at one rate: hnf export FILE --format wav8k --out COPY.wav",
        )
    longest = max(len(recording.samples) for recording in recordings)
    channels = [np.pad(recording.samples, ((0, longest - len(recording.samples)), (0, 0))) for recording in recordings]
    return Acceleration(
        np.concatenate(channels, axis=1), rates[0], "; ".join(dict.fromkeys(recording.unit for recording in recordings))
    )


def db_to_gain(gain_db: float) -> float:
    """Convert a gain in dB to a factor; raise UsageError beyond ±120 dB."""
    if not abs(gain_db) <= 120.0:
        raise UsageError(f"a gain of {gain_db:g} dB is none.", remedy="Give −120 to 120 dB.")
    return math.pow(10.0, gain_db / 20.0)
