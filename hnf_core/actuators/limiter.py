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

What the coils of a device have warmed to, kept from one stream to the next of one process: starting anew cools
nothing. Another process knows nothing of it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from .limits import FULL_SCALE_COUNTS, THERMAL_KNEE, LimiterParams, Limits, compute_limiter_params
from .sink import Counts

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


class Limiter:
    """m/s² → counts. limited: samples that left other than they came, rounding and ramps aside. nonfinite: samples
    that were no number. heat: (channels,) or one for all, 0–1, how warm the coils are at the start."""

    def __init__(self, limits: Limits, rate_hz: float, channels: int, *, initial_heat: ArrayLike = 0.0) -> None:
        """Raises UsageError where limits leave nothing at rate_hz, or there is no channel."""
        if channels < 1:
            raise UsageError(f"a device has one channel or more, not {channels}.")
        self.limited = 0
        self.nonfinite = 0
        self._params = compute_limiter_params(limits, rate_hz)
        self._channels = channels
        self._last = np.zeros(channels, dtype=np.int64)
        self._is_playing = True
        self._fade_in_frames = 0
        self._fade_out_start = np.zeros(channels)
        self._fade_out_frames_left = 0
        self._grid_position = 0
        self._grid_energy = np.zeros(channels, dtype=np.int64)
        warm = np.clip(np.broadcast_to(np.asarray(initial_heat, dtype=np.float64), (channels,)), 0.0, 1.0)
        self._mean_square = (
            warm * self._params.max_mean_square if np.isfinite(self._params.max_mean_square) else np.zeros(channels)
        )
        self._gain = self._previous_gain = compute_gains(self._params, self._mean_square)
        self._is_damped = bool((self._gain < 1.0).any())
        self._cap = compute_level_caps(self._params, self._mean_square, self._last)

    @property
    def heat(self) -> FloatArray:
        """(channels,) of what the coils may warm to, 0–1; as of the last whole grid of frames."""
        return self._mean_square / self._params.max_mean_square

    @property
    def is_resting(self) -> bool:
        """Stopped, and nothing left to fade."""
        return not self._is_playing and self._fade_out_frames_left == 0 and not self._last.any()

    def process(self, block: ArrayLike) -> Counts:
        """(n, channels) m/s² → (n, channels) counts. The first block, and the first after a soft stop, start softly.
        Raises UsageError for another shape."""
        given = np.asarray(block, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != self._channels:
            raise UsageError(f"a block is (frames, {self._channels}), this one is {given.shape}.")
        if len(given) == 0:
            return np.zeros((0, self._channels), dtype=np.int16)
        self._is_playing = True
        finite = np.isfinite(given)
        if not finite.all():
            self.nonfinite += int(given.size - np.count_nonzero(finite))
            given = np.where(finite, given, 0.0)
        most = 2.0 * self._params.full_scale_m_s2
        level = np.minimum(np.maximum(given, -most), most)
        level /= self._params.full_scale_m_s2
        level *= FULL_SCALE_COUNTS
        return self._limit(level)

    def soft_stop(self, frames: int) -> Counts:
        """(frames, channels) counts in a block's place: what left last, faded to exactly 0 within the ramp (or as soon
        as the slew allows), and 0 from there on. May be called again and again, as for a pause."""
        if self._is_playing and frames > 0:
            self._is_playing = False
            self._fade_in_frames = 0
            self._fade_out_start = self._last.astype(np.float64)
            self._fade_out_frames_left = len(self._params.ramp) - 1
        return self._limit(np.zeros((frames, self._channels)))

    def flush(self) -> Counts:
        """All of a soft stop, ending with one frame of 0; nothing where it rests already. Nothing follows it."""
        if self.is_resting or not (self._last.any() or self._fade_out_frames_left):
            return np.zeros((0, self._channels), dtype=np.int16)
        counts = self.soft_stop(len(self._params.ramp) + self._params.peak // self._params.max_step + 1)
        sounding = np.flatnonzero(counts.any(axis=1))
        return counts[: (int(sounding[-1]) if len(sounding) else 0) + 2]

    def _limit(self, level: FloatArray) -> Counts:
        """level: counts wanted, not yet whole, (n, channels)."""
        tail = self._apply_ramps(level)
        grid = self._params.grid_frames if np.isfinite(self._params.max_mean_square) else max(len(level), 1)
        counts = np.empty(level.shape, dtype=np.int16)
        start = self._limit_while_cool(level, tail, counts)
        while start < len(level):
            end = min(start + grid - self._grid_position, len(level))
            counts[start:end] = self._limit_grid(level[start:end], tail if tail is None else tail[start:end])
            start = end
        return counts

    def _apply_ramps(self, level: FloatArray) -> FloatArray | None:
        """Fades level in, in place. Returns what fades out beneath it, if anything."""
        ramp = self._params.ramp
        if self._is_playing and self._fade_in_frames < len(ramp) - 1:
            steps = np.arange(1, len(level) + 1)
            level *= ramp[np.minimum(self._fade_in_frames + steps, len(ramp) - 1), None]
            self._fade_in_frames = min(self._fade_in_frames + len(level), len(ramp) - 1)
        if self._fade_out_frames_left == 0:
            return None
        steps = np.arange(1, len(level) + 1)
        tail = self._fade_out_start * ramp[np.maximum(self._fade_out_frames_left - steps, 0), None]
        self._fade_out_frames_left = max(self._fade_out_frames_left - len(level), 0)
        return np.asarray(tail)

    def _limit_while_cool(self, level: FloatArray, tail: FloatArray | None, counts: Counts) -> int:
        """All of level in one go, as far as the coils stay so cool that peak and slew alone bound it; how many frames
        that is. What _piece makes of them grid by grid, for a third of the time."""
        law = self._params
        if (
            len(level) == 0
            or not np.isfinite(law.max_mean_square)
            or self._is_damped
            or not _is_cool(law, self._mean_square)
        ):
            return 0
        wanted = np.rint(level if tail is None else level + tail)
        whole = np.minimum(np.maximum(wanted, -law.peak), law.peak).astype(np.int64)
        limit_slew(whole, self._last, law.max_step)
        starts = np.arange(-self._grid_position, len(whole), law.grid_frames)
        starts[0] = 0
        energies = np.add.reduceat(whole * whole, starts, axis=0)
        whole_grids = (self._grid_position + len(whole)) // law.grid_frames
        done = len(whole)
        for index in range(whole_grids):
            self._mean_square = law.grid_decay * self._mean_square + law.pole_weight * (
                self._grid_energy + energies[index]
            )
            self._grid_energy = np.zeros_like(self._grid_energy)
            if not _is_cool(law, self._mean_square):
                done = (index + 1) * law.grid_frames - self._grid_position
                break
        self.limited += int(np.count_nonzero(whole[:done] != wanted[:done]))
        self._last = whole[done - 1].copy()
        self._grid_position = (self._grid_position + done) % law.grid_frames
        if self._grid_position:
            self._grid_energy = self._grid_energy + energies[-1]
        elif not _is_cool(law, self._mean_square):
            self._gain = compute_gains(law, self._mean_square)
            self._is_damped = bool((self._gain < 1.0).any())
            self._cap = compute_level_caps(law, self._mean_square, self._last)
        counts[:done] = whole[:done]
        return done

    def _limit_grid(self, level: FloatArray, tail: FloatArray | None) -> IntArray:
        """Within one grid of frames."""
        law, heats = self._params, bool(np.isfinite(self._params.max_mean_square))
        aim = wanted = np.rint(level if tail is None else level + tail)
        if self._is_damped:
            share = np.arange(self._grid_position + 1, self._grid_position + len(level) + 1)[:, None] / law.grid_frames
            level = level * (self._previous_gain + (self._gain - self._previous_gain) * share)
            aim = np.rint(level if tail is None else level + tail)
        whole = np.minimum(np.maximum(aim, -self._cap), self._cap).astype(np.int64)
        limit_slew(whole, self._last, law.max_step)
        self.limited += int(np.count_nonzero(whole != wanted))
        self._last = whole[-1].copy()
        if heats:
            self._grid_energy += np.einsum("nc,nc->c", whole, whole)
            self._grid_position += len(whole)
            if self._grid_position == law.grid_frames:
                self._update_heat()
        return whole

    def _update_heat(self) -> None:
        law = self._params
        # Each frame counts in full, though the earlier ones have faded a little: never too little.
        self._mean_square = law.grid_decay * self._mean_square + law.pole_weight * self._grid_energy
        self._grid_energy[:] = 0
        self._grid_position = 0
        self._previous_gain, self._gain = self._gain, compute_gains(law, self._mean_square)
        self._is_damped = bool((self._previous_gain < 1.0).any() or (self._gain < 1.0).any())
        self._cap = compute_level_caps(law, self._mean_square, self._last)


def _is_cool(params: LimiterParams, square: FloatArray) -> bool:
    """Whether no gain falls and no cap is near, by what gains() and caps() make of the warmest coil."""
    warmest = float(square.max())
    return (1.0 - warmest / params.max_mean_square) / (1.0 - THERMAL_KNEE) >= 1.0 and _is_far_from_bound(
        params, warmest
    )


def _is_far_from_bound(params: LimiterParams, warmest: float) -> bool:
    """Whether a grid of frames at the peak, and the way down from it, is not half of what the bound leaves."""
    most = params.peak * params.peak * (params.grid_frames + params.peak / params.max_step)
    return (params.max_mean_square - params.grid_decay * warmest) / params.pole_weight > 2.0 * most


def compute_gains(params: LimiterParams, square: FloatArray) -> FloatArray:
    """(channels,) 0–1: 1 up to KNEE of the bound, from there in a straight line to 0 at the bound."""
    return np.asarray(np.clip((1.0 - square / params.max_mean_square) / (1.0 - THERMAL_KNEE), 0.0, 1.0))


def compute_level_caps(params: LimiterParams, square: FloatArray, last: IntArray) -> IntArray:
    """(channels,) counts: the largest level that keeps the mean square within the bound for a grid of frames and for
    the way down to 0 after it. square: now. last: counts that left last."""
    highest = np.full(len(square), params.peak, dtype=np.int64)
    if not np.isfinite(params.max_mean_square):
        return highest
    room = (params.max_mean_square - params.grid_decay * square) / params.pole_weight
    owed = compute_ramp_down_energy(params, np.abs(last))
    lowest = np.zeros_like(highest)
    if _is_far_from_bound(params, float(square.max())):  # what follows would find the same
        return highest
    while (lowest < highest).any():
        middle = (lowest + highest + 1) // 2
        fits = (
            np.maximum(compute_ramp_down_energy(params, middle), owed)
            + params.grid_frames * np.square(middle.astype(np.float64))
            <= room
        )
        lowest, highest = np.where(fits, middle, lowest), np.where(fits, highest, middle - 1)
    return lowest


def compute_ramp_down_energy(params: LimiterParams, level: IntArray) -> FloatArray:
    """Counts² summed over the frames from level to 0 at the steepest slew: Σ (level − k·step)² ≤ level³ / 3 step."""
    real = level.astype(np.float64)
    return np.asarray(real * real * real / (3.0 * params.max_step))


def limit_slew(target: IntArray, last: IntArray, step: int) -> None:
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


HeatArray = NDArray[np.float64]


class ThermalState:
    """Of devices, each known by its name, as long as this process lives. clock: s, monotonic."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._devices: dict[str, tuple[float, float, HeatArray]] = {}

    def record(self, device: str, limits: Limits, heat: HeatArray) -> None:
        """heat: (channels,) of what limits' coils may warm to, as Limiter.heat tells it. Of two devices with one name
        the warmer counts."""
        heat = np.maximum(heat, self.get_heat(device, limits, len(heat)))
        square = heat * (limits.sustained * limits.full_scale_m_s2) ** 2
        with self._lock:
            self._devices[device] = (self._clock(), limits.thermal_s, square)

    def get_heat(self, device: str, limits: Limits, channels: int) -> HeatArray:
        """(channels,) 0–1 for a Limiter that starts now; other channels than last time start as warm as its warmest."""
        with self._lock:
            then, thermal_s, square = self._devices.get(device, (0.0, 1.0, np.zeros(channels)))
            left = float(np.exp(-(self._clock() - then) / thermal_s))
        if len(square) != channels:
            square = np.full(channels, square.max(initial=0.0))
        return np.asarray(np.clip(left * square / (limits.sustained * limits.full_scale_m_s2) ** 2, 0.0, 1.0))


THERMAL_STATE = ThermalState()
