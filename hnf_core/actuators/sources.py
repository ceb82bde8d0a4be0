"""A recording as a source: what is known beforehand, played from any place, at any gain, without a click.

A source that ends sooner.

A WAV as what an actuator is to do: m/s², whatever unit the file has.
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
"""Of a seek, a swap, a change of gain, and of the seam of a loop."""


class BufferSource:
    """samples (n, channels) float32 m/s² at rate_hz. loop: from the end on to the start, for ever; start_s: where to
    begin. Every method may be called from any thread; of changes that come faster than they fade in, the latest
    counts. Raises UsageError where samples have another shape or rate_hz is no rate."""

    def __init__(self, samples: ArrayLike, rate_hz: float, *, loop: bool = False, start_s: float = 0.0) -> None:
        given = _check_frames(samples)
        if not 0.0 < rate_hz < 1e9:
            raise UsageError(f"a recording does not have {rate_hz:g} frames a second.")
        self._rate = float(rate_hz)
        self._fade = max(round(CROSSFADE_S * rate_hz), 1)
        self._loop = loop
        self._voice = _Voice(given, _find_frame(start_s, self._rate, len(given)), self._fade)
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
        """Of the next frame to be read."""
        with self._lock:
            voice = self._pending[0] if self._pending else self._voice
            return voice.at / self._rate

    @property
    def duration_s(self) -> float:
        with self._lock:
            return len(self._voice.samples) / self._rate

    def seek(self, position_s: float) -> None:
        """Go on from there, clamped to the recording; cross-fades with equal power, as both places have nothing to do
        with each other."""
        with self._lock:
            samples = (self._pending[0] if self._pending else self._voice).samples
            self._pending = (_Voice(samples, _find_frame(position_s, self._rate, len(samples)), self._fade), True)

    def swap(self, samples: ArrayLike) -> None:
        """Go on in samples, at the place where it is; cross-fades in a straight line, as they are mostly alike. Raises
        UsageError for another number of channels."""
        given = _check_frames(samples)
        with self._lock:
            if given.shape[1] != self.channels:
                raise UsageError(f"it has {given.shape[1]} channels and plays {self.channels}.")
            now, equal_power = self._pending or (self._voice, False)
            self._pending = (_Voice(given, now.at, self._fade, wrapped=now.wrapped), equal_power)

    def set_gain(self, gain: float) -> None:
        """A factor, 0 or more. Raises UsageError otherwise."""
        if not 0.0 <= gain < float("inf"):
            raise UsageError(f"a gain is 0 or more, not {gain:g}.")
        with self._lock:
            self._gain_from, self._gain_to, self._gain_at = self._gain, gain, 0

    def set_loop(self, loop: bool) -> None:
        with self._lock:
            self._loop = loop

    def read(self, frames: int) -> Samples:
        """Once it has given fewer than frames it has ended: nothing follows but after a seek."""
        with self._lock:
            pieces: list[Samples] = []
            left = frames
            while left > 0:
                if self._old is None and self._pending is not None:
                    self._start_crossfade()
                count = left if self._old is None else min(left, self._fade - self._faded)
                piece = self._render_crossfade(count)
                pieces.append(piece)
                left -= count
                if len(piece) < count:
                    break
            if not pieces:
                return np.zeros((0, self.channels), dtype=np.float32)
            return self._apply_gain(np.concatenate(pieces))

    def _start_crossfade(self) -> None:
        assert self._pending is not None
        voice, self._equal_power = self._pending
        self._old, self._voice, self._pending, self._faded = self._voice, voice, None, 0
        if self._old.samples is not voice.samples and not self._equal_power:
            voice.at, voice.wrapped = self._old.at, self._old.wrapped  # it has gone on since the swap was asked for

    def _render_crossfade(self, frames: int) -> Samples:
        new = self._voice.read(frames, self._loop)
        if self._old is None:
            return new
        # The new one may end within the fade: then the old one fades on over its last value.
        old = self._old.read_padded(frames, self._loop)
        self._faded += frames
        share = (np.arange(self._faded - frames + 1, self._faded + 1) / (self._fade + 1))[:, None]
        share = np.sin(0.5 * np.pi * share) if self._equal_power else share
        back = np.cos(np.arcsin(share)) if self._equal_power else 1.0 - share
        if self._faded >= self._fade:
            self._old = None
        mixed = new * share[: len(new)] + old[: len(new)] * back[: len(new)]
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
    """samples, being played from at on. wrapped: it has come over a loop's seam, whose jump it fades over."""

    def __init__(self, samples: Samples, at: int, fade: int, *, wrapped: bool = False) -> None:
        self.samples, self.at, self.wrapped = samples, min(at, len(samples)), wrapped
        self._fade = max(min(fade, len(samples)), 1)

    def read(self, frames: int, loop: bool) -> Samples:
        whole = len(self.samples)
        if not loop or whole == 0:
            found = self._crossfade_seam(np.arange(self.at, min(self.at + frames, whole)), self.wrapped)
            self.at += len(found)
            return found
        places = self.at + np.arange(frames)
        found = self._crossfade_seam(places % whole, (places >= whole) | self.wrapped)
        self.wrapped |= bool(self.at + frames >= whole)
        self.at = (self.at + frames) % whole
        return found

    def read_padded(self, frames: int, loop: bool) -> Samples:
        """As read(), but its last value goes on where it has ended."""
        found = self.read(frames, loop)
        last = self.samples[-1:] if len(self.samples) else np.zeros((1, self.samples.shape[1]), np.float32)
        return np.concatenate([found, np.repeat(last, frames - len(found), axis=0)])

    def _crossfade_seam(self, frames: NDArray[np.intp], wrapped: bool | NDArray[np.bool_]) -> Samples:
        """After the seam the recording's last value fades out beneath its first ones: no jump, and the period stays."""
        found = self.samples[frames]
        near = (frames < self._fade) & wrapped
        if near.any():
            share = ((frames[near] + 1) / (self._fade + 1))[:, None]
            found[near] = found[near] * share + self.samples[-1] * (1.0 - share)
        return found


def _check_frames(samples: ArrayLike) -> Samples:
    given = np.asarray(samples, dtype=np.float32)
    if given.ndim != 2 or given.shape[1] < 1:
        raise UsageError(f"a recording is (frames, channels), this one is {given.shape}.")
    return given


def _find_frame(position_s: float, rate_hz: float, frames: int) -> int:
    """The frame nearest to position_s; the start where it is no number."""
    return round(min(max(position_s * rate_hz, 0.0), frames)) if np.isfinite(position_s) else 0


class TruncatedSource:
    """The first frames of source. See Source."""

    def __init__(self, source: Source, frames: int) -> None:
        self._source, self._frames_left = source, frames

    @property
    def rate_hz(self) -> float:
        return self._source.rate_hz

    @property
    def channels(self) -> int:
        return self._source.channels

    def read(self, frames: int) -> Samples:
        """See Source."""
        found = self._source.read(min(frames, self._frames_left))
        self._frames_left -= len(found)
        return found


@dataclass(frozen=True, eq=False)
class Acceleration:
    """samples: (n, channels) float32 m/s². unit: what was read as what, in words."""

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
    """A file that states m/s² is taken at its word. One without a unit whose samples lie within −1 … 1, as sound files'
    do, plays with 1 as the actuator's full scale; one that goes beyond is taken as m/s². Raises FileError,
    also where there is no sample in it."""
    return to_acceleration(read_wav_channels(path), limits, str(path))


def to_acceleration(signals: Sequence[Signal], limits: Limits, where: str) -> Acceleration:
    """As read_acceleration, of the channels of a file that messages name as where."""
    first = signals[0]
    if len(first.samples) == 0:
        raise FileError("has no samples.", where=where, remedy="Export it again.")
    samples = np.ascontiguousarray(np.stack([each.samples for each in signals], axis=1), dtype=np.float32)
    if first.provenance.get("units") != "as stored":
        return Acceleration(samples, first.sample_rate, "in m/s²")
    if np.abs(samples).max(initial=0.0) > 1.0:
        return Acceleration(samples, first.sample_rate, "without a unit, taken as m/s² since it goes beyond 1")
    full = np.float32(limits.full_scale_m_s2)
    words = f"without a unit: its 1.0 is played as {limits.full_scale_m_s2:g} m/s², full scale"
    return Acceleration(samples * full, first.sample_rate, words)


def read_accelerations(paths: Sequence[Path], limits: Limits) -> Acceleration:
    """Files beside each other, the channels of the first one first; those that end earlier are silent from then on.

    Raises UsageError where they differ in their rates, and what read_acceleration raises.
    """
    found = [read_acceleration(path, limits) for path in paths]
    rates = sorted({each.rate_hz for each in found})
    if len(rates) > 1:
        raise UsageError(
            f"files of {' and '.join(f'{rate:g}' for rate in rates)} Hz cannot be played beside each other.",
            remedy="Export them at one rate: hnf export FILE --format wav8k --out COPY.wav",
        )
    longest = max(len(each.samples) for each in found)
    beside = [np.pad(each.samples, ((0, longest - len(each.samples)), (0, 0))) for each in found]
    return Acceleration(np.concatenate(beside, axis=1), rates[0], "; ".join(dict.fromkeys(each.unit for each in found)))


def db_to_gain(gain_db: float) -> float:
    """Raises UsageError beyond ±120 dB."""
    if not abs(gain_db) <= 120.0:
        raise UsageError(f"a gain of {gain_db:g} dB is none.", remedy="Give −120 to 120 dB.")
    return math.pow(10.0, gain_db / 20.0)
