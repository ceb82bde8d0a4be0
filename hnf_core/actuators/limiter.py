"""The last stage before the wire: whatever comes in, no device gets more than its limits.

Four bounds, each kept for every input and every cut of it into blocks:

* peak: no count beyond peak_counts.
* slew: no two frames in a row differ by more than step counts, across blocks, soft starts and soft stops too.
* warming: the coil's mean square through one pole never exceeds sustained². From KNEE of it on the gain falls, in a
  straight line over each grid of frames, so nothing zips. Behind the gain a cap holds for what no gain foresees: the
  largest level that, were it kept for a grid of frames and then brought to 0 as slowly as the slew asks, stays within
  the bound. Level 0 always does, since the way down was paid for before; so cap and slew never contradict.
* no number that is not finite: it is 0, and counted.

Whatever is summed is whole counts, and everything else is done value by value on a grid that starts with the first
frame: equal bytes however the input is cut. limiter_reference.py is the same law, one value at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from .law import KNEE, Law, law_of
from .limits import COUNTS, Limits
from .sink import Counts

Whole = NDArray[np.int64]
Real = NDArray[np.float64]


class Limiter:
    """m/s² → counts. limited: samples that left other than they came, rounding and ramps aside. nonfinite: samples
    that were no number. heat: (channels,) or one for all, 0–1, how warm the coils are at the start."""

    def __init__(self, limits: Limits, rate_hz: float, channels: int, *, heat: ArrayLike = 0.0) -> None:
        """Raises UsageError where limits leave nothing at rate_hz, or there is no channel."""
        if channels < 1:
            raise UsageError(f"a device has one channel or more, not {channels}.")
        self.limited = 0
        self.nonfinite = 0
        self._law = law_of(limits, rate_hz)
        self._channels = channels
        self._last = np.zeros(channels, dtype=np.int64)
        self._playing = True
        self._risen = 0
        self._held = np.zeros(channels)
        self._falling = 0
        self._at = 0
        self._energy = np.zeros(channels, dtype=np.int64)
        warm = np.clip(np.broadcast_to(np.asarray(heat, dtype=np.float64), (channels,)), 0.0, 1.0)
        self._square = warm * self._law.bound if np.isfinite(self._law.bound) else np.zeros(channels)
        self._gain = self._earlier_gain = gains(self._law, self._square)
        self._damped = bool((self._gain < 1.0).any())
        self._cap = caps(self._law, self._square, self._last)

    @property
    def heat(self) -> Real:
        """(channels,) of what the coils may warm to, 0–1; as of the last whole grid of frames."""
        return self._square / self._law.bound

    @property
    def resting(self) -> bool:
        """Stopped, and nothing left to fade."""
        return not self._playing and self._falling == 0 and not self._last.any()

    def process(self, block: ArrayLike) -> Counts:
        """(n, channels) m/s² → (n, channels) counts. The first block, and the first after a soft stop, start softly.
        Raises UsageError for another shape."""
        given = np.asarray(block, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != self._channels:
            raise UsageError(f"a block is (frames, {self._channels}), this one is {given.shape}.")
        if len(given) == 0:
            return np.zeros((0, self._channels), dtype=np.int16)
        self._playing = True
        finite = np.isfinite(given)
        if not finite.all():
            self.nonfinite += int(given.size - np.count_nonzero(finite))
            given = np.where(finite, given, 0.0)
        most = 2.0 * self._law.full_scale_m_s2
        level = np.minimum(np.maximum(given, -most), most)
        level /= self._law.full_scale_m_s2
        level *= COUNTS
        return self._limited(level)

    def soft_stop(self, frames: int) -> Counts:
        """(frames, channels) counts in a block's place: what left last, faded to exactly 0 within the ramp (or as soon
        as the slew allows), and 0 from there on. May be called again and again, as for a pause."""
        if self._playing and frames > 0:
            self._playing = False
            self._risen = 0
            self._held = self._last.astype(np.float64)
            self._falling = len(self._law.ramp) - 1
        return self._limited(np.zeros((frames, self._channels)))

    def release(self) -> Counts:
        """All of a soft stop, ending with one frame of 0; nothing where it rests already. Nothing follows it."""
        if self.resting or not (self._last.any() or self._falling):
            return np.zeros((0, self._channels), dtype=np.int16)
        counts = self.soft_stop(len(self._law.ramp) + self._law.peak // self._law.step + 1)
        sounding = np.flatnonzero(counts.any(axis=1))
        return counts[: (int(sounding[-1]) if len(sounding) else 0) + 2]

    def _limited(self, level: Real) -> Counts:
        """level: counts wanted, not yet whole, (n, channels)."""
        tail = self._ramped(level)
        grid = self._law.grid if np.isfinite(self._law.bound) else max(len(level), 1)
        counts = np.empty(level.shape, dtype=np.int16)
        start = self._coolly(level, tail, counts)
        while start < len(level):
            end = min(start + grid - self._at, len(level))
            counts[start:end] = self._piece(level[start:end], tail if tail is None else tail[start:end])
            start = end
        return counts

    def _ramped(self, level: Real) -> Real | None:
        """Fades level in, in place. Returns what fades out beneath it, if anything."""
        ramp = self._law.ramp
        if self._playing and self._risen < len(ramp) - 1:
            steps = np.arange(1, len(level) + 1)
            level *= ramp[np.minimum(self._risen + steps, len(ramp) - 1), None]
            self._risen = min(self._risen + len(level), len(ramp) - 1)
        if self._falling == 0:
            return None
        steps = np.arange(1, len(level) + 1)
        tail = self._held * ramp[np.maximum(self._falling - steps, 0), None]
        self._falling = max(self._falling - len(level), 0)
        return np.asarray(tail)

    def _coolly(self, level: Real, tail: Real | None, counts: Counts) -> int:
        """All of level in one go, as far as the coils stay so cool that peak and slew alone bound it; how many frames
        that is. What _piece makes of them grid by grid, for a third of the time."""
        law = self._law
        if len(level) == 0 or not np.isfinite(law.bound) or self._damped or not _cool(law, self._square):
            return 0
        wanted = np.rint(level if tail is None else level + tail)
        whole = np.minimum(np.maximum(wanted, -law.peak), law.peak).astype(np.int64)
        follow(whole, self._last, law.step)
        starts = np.arange(-self._at, len(whole), law.grid)
        starts[0] = 0
        energies = np.add.reduceat(whole * whole, starts, axis=0)
        whole_grids = (self._at + len(whole)) // law.grid
        done = len(whole)
        for index in range(whole_grids):
            self._square = law.decay * self._square + law.weight * (self._energy + energies[index])
            self._energy = np.zeros_like(self._energy)
            if not _cool(law, self._square):
                done = (index + 1) * law.grid - self._at
                break
        self.limited += int(np.count_nonzero(whole[:done] != wanted[:done]))
        self._last = whole[done - 1].copy()
        self._at = (self._at + done) % law.grid
        if self._at:
            self._energy = self._energy + energies[-1]
        elif not _cool(law, self._square):
            self._gain = gains(law, self._square)
            self._damped = bool((self._gain < 1.0).any())
            self._cap = caps(law, self._square, self._last)
        counts[:done] = whole[:done]
        return done

    def _piece(self, level: Real, tail: Real | None) -> Whole:
        """Within one grid of frames."""
        law, heats = self._law, bool(np.isfinite(self._law.bound))
        aim = wanted = np.rint(level if tail is None else level + tail)
        if self._damped:
            share = np.arange(self._at + 1, self._at + len(level) + 1)[:, None] / law.grid
            level = level * (self._earlier_gain + (self._gain - self._earlier_gain) * share)
            aim = np.rint(level if tail is None else level + tail)
        whole = np.minimum(np.maximum(aim, -self._cap), self._cap).astype(np.int64)
        follow(whole, self._last, law.step)
        self.limited += int(np.count_nonzero(whole != wanted))
        self._last = whole[-1].copy()
        if heats:
            self._energy += np.einsum("nc,nc->c", whole, whole)
            self._at += len(whole)
            if self._at == law.grid:
                self._warm()
        return whole

    def _warm(self) -> None:
        law = self._law
        # Each frame counts in full, though the earlier ones have faded a little: never too little.
        self._square = law.decay * self._square + law.weight * self._energy
        self._energy[:] = 0
        self._at = 0
        self._earlier_gain, self._gain = self._gain, gains(law, self._square)
        self._damped = bool((self._earlier_gain < 1.0).any() or (self._gain < 1.0).any())
        self._cap = caps(law, self._square, self._last)


def _cool(law: Law, square: Real) -> bool:
    """Whether no gain falls and no cap is near, by what gains() and caps() make of the warmest coil."""
    warmest = float(square.max())
    return (1.0 - warmest / law.bound) / (1.0 - KNEE) >= 1.0 and _is_far(law, warmest)


def _is_far(law: Law, warmest: float) -> bool:
    """Whether a grid of frames at the peak, and the way down from it, is not half of what the bound leaves."""
    most = law.peak * law.peak * (law.grid + law.peak / law.step)
    return (law.bound - law.decay * warmest) / law.weight > 2.0 * most


def gains(law: Law, square: Real) -> Real:
    """(channels,) 0–1: 1 up to KNEE of the bound, from there in a straight line to 0 at the bound."""
    return np.asarray(np.clip((1.0 - square / law.bound) / (1.0 - KNEE), 0.0, 1.0))


def caps(law: Law, square: Real, last: Whole) -> Whole:
    """(channels,) counts: the largest level that keeps the mean square within the bound for a grid of frames and for
    the way down to 0 after it. square: now. last: counts that left last."""
    highest = np.full(len(square), law.peak, dtype=np.int64)
    if not np.isfinite(law.bound):
        return highest
    room = (law.bound - law.decay * square) / law.weight
    owed = way_down(law, np.abs(last))
    lowest = np.zeros_like(highest)
    if _is_far(law, float(square.max())):  # what follows would find the same
        return highest
    while (lowest < highest).any():
        middle = (lowest + highest + 1) // 2
        fits = np.maximum(way_down(law, middle), owed) + law.grid * np.square(middle.astype(np.float64)) <= room
        lowest, highest = np.where(fits, middle, lowest), np.where(fits, highest, middle - 1)
    return lowest


def way_down(law: Law, level: Whole) -> Real:
    """Counts² summed over the frames from level to 0 at the steepest slew: Σ (level − k·step)² ≤ level³ / 3 step."""
    real = level.astype(np.float64)
    return np.asarray(real * real * real / (3.0 * law.step))


def follow(target: Whole, last: Whole, step: int) -> None:
    """Changes target (n, channels), n ≥ 1, where it leaves its last frame (channels,) or itself by more than step
    counts a frame: there it is followed as fast as that allows."""
    steep = np.abs(target[0] - last) > step
    if len(target) > 1:
        steep |= np.abs(target[1:] - target[:-1]).max(axis=0) > step
    if not steep.any():
        return
    for channel in np.flatnonzero(steep):
        at, followed = int(last[channel]), []
        for aim in target[:, channel].tolist():
            at = aim if -step <= aim - at <= step else at + step if aim > at else at - step
            followed.append(at)
        target[:, channel] = followed
