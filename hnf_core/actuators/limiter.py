"""The limiter, last stage before the wire: acceleration [m/s²] in, int16 counts within a device's limits out.

Four bounds hold for every input, however it is cut into blocks:

* Peak: no count exceeds `peak`.
* Slew: consecutive frames never differ by more than `max_step` counts, across blocks, soft starts and soft stops too.
* Warming: the coil's mean square, a one-pole filter of y², never exceeds sustained². From `THERMAL_KNEE` of that
  bound on the gain falls linearly. Gain and level cap are updated once per period of `grid_frames` frames (a "grid of
  frames"), within which the gain changes linearly, so that it is inaudible. The level cap behind the gain holds for
  input that no gain anticipates: the largest level that stays within the bound if it lasts for one such period and is
  then brought to 0 at the slew limit. Level 0 always satisfies this, since the energy of the ramp down was reserved
  before; so cap and slew never contradict.
* Finite values: NaN and infinity become 0 and are counted.

Energies are sums of whole counts, and everything else is done per value in periods that start with the first frame, so
the bytes do not depend on the cut into blocks. `ThermalState` carries the coils' warmth from one stream to the next
within a process.
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
    """Streaming limiter of one device: (n, channels) m/s² → (n, channels) counts.

    Parameters
    ----------
    limits : Limits
        Limits of the device.
    rate_hz : float
        Frames per second of the device [Hz].
    channels : int
        Number of channels.
    initial_heat : array_like
        Warmth of the coils at the start as a fraction of their bound, 0–1; a scalar or (channels,).

    Attributes
    ----------
    limited : int
        Samples changed by the limits, apart from rounding and ramps.
    nonfinite : int
        Samples that were NaN or infinite.

    Raises
    ------
    UsageError
        If the limits leave nothing at `rate_hz`, or there is no channel.
    """

    def __init__(self, limits: Limits, rate_hz: float, channels: int, *, initial_heat: ArrayLike = 0.0) -> None:
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
        heat = np.clip(np.broadcast_to(np.asarray(initial_heat, dtype=np.float64), (channels,)), 0.0, 1.0)
        self._mean_square = (
            heat * self._params.max_mean_square if np.isfinite(self._params.max_mean_square) else np.zeros(channels)
        )
        self._gain = self._previous_gain = compute_gains(self._params, self._mean_square)
        self._is_damped = bool((self._gain < 1.0).any())
        self._cap = compute_level_caps(self._params, self._mean_square, self._last)

    @property
    def heat(self) -> FloatArray:
        """Warmth of the coils (channels,) as a fraction of their thermal bound, 0–1, at the last gain update."""
        return self._mean_square / self._params.max_mean_square

    @property
    def is_resting(self) -> bool:
        """True if it has stopped and nothing is left to fade out."""
        return not self._is_playing and self._fade_out_frames_left == 0 and not self._last.any()

    def process(self, block: ArrayLike) -> Counts:
        """Limit a block, (n, channels) m/s² → (n, channels) counts.

        The first block, and the first after a soft stop, fade in.

        Raises
        ------
        UsageError
            If the block has another shape.
        """
        samples = np.asarray(block, dtype=np.float64)
        if samples.ndim != 2 or samples.shape[1] != self._channels:
            raise UsageError(f"a block is (frames, {self._channels}), this one is {samples.shape}.")
        if len(samples) == 0:
            return np.zeros((0, self._channels), dtype=np.int16)
        self._is_playing = True
        finite = np.isfinite(samples)
        if not finite.all():
            self.nonfinite += int(samples.size - np.count_nonzero(finite))
            samples = np.where(finite, samples, 0.0)
        highest = 2.0 * self._params.full_scale_m_s2
        level = np.minimum(np.maximum(samples, -highest), highest)
        level /= self._params.full_scale_m_s2
        level *= FULL_SCALE_COUNTS
        return self._limit(level)

    def soft_stop(self, frames: int) -> Counts:
        """Return (frames, channels) counts that fade out in place of a block.

        They go from the last level to exactly 0 within the ramp, or as soon as the slew limit allows, and stay 0. May
        be called repeatedly, for example during a pause.
        """
        if self._is_playing and frames > 0:
            self._is_playing = False
            self._fade_in_frames = 0
            self._fade_out_start = self._last.astype(np.float64)
            self._fade_out_frames_left = len(self._params.ramp) - 1
        return self._limit(np.zeros((frames, self._channels)))

    def flush(self) -> Counts:
        """Return all counts of the soft stop, ending with one frame of 0; empty if the limiter rests. Call it last."""
        if self.is_resting or not (self._last.any() or self._fade_out_frames_left):
            return np.zeros((0, self._channels), dtype=np.int16)
        counts = self.soft_stop(len(self._params.ramp) + self._params.peak // self._params.max_step + 1)
        sounding = np.flatnonzero(counts.any(axis=1))
        return counts[: (int(sounding[-1]) if len(sounding) else 0) + 2]

    def _limit(self, level: FloatArray) -> Counts:
        """Limit requested levels, (n, channels) in fractional counts."""
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
        """Apply the fade-in to `level` (n, channels) in place.

        Returns the fade-out from before a stop (n, channels), which is to be added, or None.
        """
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
        """Limit `level` (n, channels) at once while the coils are so cool that only peak and slew matter.

        Writes to `counts` and returns the number of frames done. The result equals that of `_limit_grid` period by
        period, in a third of the time.
        """
        params = self._params
        if (
            len(level) == 0
            or not np.isfinite(params.max_mean_square)
            or self._is_damped
            or not _is_cool(params, self._mean_square)
        ):
            return 0
        requested = np.rint(level if tail is None else level + tail)
        counts_out = np.minimum(np.maximum(requested, -params.peak), params.peak).astype(np.int64)
        limit_slew(counts_out, self._last, params.max_step)
        starts = np.arange(-self._grid_position, len(counts_out), params.grid_frames)
        starts[0] = 0
        energies = np.add.reduceat(counts_out * counts_out, starts, axis=0)
        complete_grids = (self._grid_position + len(counts_out)) // params.grid_frames
        done = len(counts_out)
        for index in range(complete_grids):
            self._mean_square = params.grid_decay * self._mean_square + params.pole_weight * (
                self._grid_energy + energies[index]
            )
            self._grid_energy = np.zeros_like(self._grid_energy)
            if not _is_cool(params, self._mean_square):
                done = (index + 1) * params.grid_frames - self._grid_position
                break
        self.limited += int(np.count_nonzero(counts_out[:done] != requested[:done]))
        self._last = counts_out[done - 1].copy()
        self._grid_position = (self._grid_position + done) % params.grid_frames
        if self._grid_position:
            self._grid_energy = self._grid_energy + energies[-1]
        elif not _is_cool(params, self._mean_square):
            self._gain = compute_gains(params, self._mean_square)
            self._is_damped = bool((self._gain < 1.0).any())
            self._cap = compute_level_caps(params, self._mean_square, self._last)
        counts[:done] = counts_out[:done]
        return done

    def _limit_grid(self, level: FloatArray, tail: FloatArray | None) -> IntArray:
        """Limit levels (n, channels) that lie within one period between gain updates."""
        params, is_thermally_bounded = self._params, bool(np.isfinite(self._params.max_mean_square))
        target = requested = np.rint(level if tail is None else level + tail)
        if self._is_damped:
            fraction = (
                np.arange(self._grid_position + 1, self._grid_position + len(level) + 1)[:, None] / params.grid_frames
            )
            level = level * (self._previous_gain + (self._gain - self._previous_gain) * fraction)
            target = np.rint(level if tail is None else level + tail)
        counts = np.minimum(np.maximum(target, -self._cap), self._cap).astype(np.int64)
        limit_slew(counts, self._last, params.max_step)
        self.limited += int(np.count_nonzero(counts != requested))
        self._last = counts[-1].copy()
        if is_thermally_bounded:
            self._grid_energy += np.einsum("nc,nc->c", counts, counts)
            self._grid_position += len(counts)
            if self._grid_position == params.grid_frames:
                self._update_heat()
        return counts

    def _update_heat(self) -> None:
        params = self._params
        # Every frame counts in full although earlier ones have decayed a little, so the heat is never underestimated.
        self._mean_square = params.grid_decay * self._mean_square + params.pole_weight * self._grid_energy
        self._grid_energy[:] = 0
        self._grid_position = 0
        self._previous_gain, self._gain = self._gain, compute_gains(params, self._mean_square)
        self._is_damped = bool((self._previous_gain < 1.0).any() or (self._gain < 1.0).any())
        self._cap = compute_level_caps(params, self._mean_square, self._last)


def _is_cool(params: LimiterParams, square: FloatArray) -> bool:
    """Return True if gain and level cap leave even the warmest coil unrestricted.

    `square` (channels,) is the coils' mean square [counts²].
    """
    warmest = float(square.max())
    return (1.0 - warmest / params.max_mean_square) / (1.0 - THERMAL_KNEE) >= 1.0 and _is_far_from_bound(
        params, warmest
    )


def _is_far_from_bound(params: LimiterParams, warmest: float) -> bool:
    """Return True if the coil of mean square `warmest` [counts²] is far from its thermal bound.

    One period between gain updates at the peak, plus the ramp down, then uses less than half of the energy left.
    """
    most = params.peak * params.peak * (params.grid_frames + params.peak / params.max_step)
    return (params.max_mean_square - params.grid_decay * warmest) / params.pole_weight > 2.0 * most


def compute_gains(params: LimiterParams, square: FloatArray) -> FloatArray:
    """Return the gains (channels,) 0–1 that keep the coils from overheating, given their mean squares [counts²].

    They are 1 up to `THERMAL_KNEE` of the thermal bound, then fall linearly to 0 at the bound.
    """
    return np.asarray(np.clip((1.0 - square / params.max_mean_square) / (1.0 - THERMAL_KNEE), 0.0, 1.0))


def compute_level_caps(params: LimiterParams, square: FloatArray, last: IntArray) -> IntArray:
    """Return the largest levels, (channels,) [counts], that keep the coils' mean square within its bound.

    They may last for one period between gain updates, followed by the ramp down to 0.

    Parameters
    ----------
    params : LimiterParams
        Limits in counts and frames.
    square : (channels,) array
        Mean square now [counts²].
    last : (channels,) array
        Last counts sent.
    """
    highest = np.full(len(square), params.peak, dtype=np.int64)
    if not np.isfinite(params.max_mean_square):
        return highest
    energy_left = (params.max_mean_square - params.grid_decay * square) / params.pole_weight
    reserved = compute_ramp_down_energy(params, np.abs(last))
    lowest = np.zeros_like(highest)
    if _is_far_from_bound(params, float(square.max())):  # the search below would find the same
        return highest
    while (lowest < highest).any():
        middle = (lowest + highest + 1) // 2
        fits = (
            np.maximum(compute_ramp_down_energy(params, middle), reserved)
            + params.grid_frames * np.square(middle.astype(np.float64))
            <= energy_left
        )
        lowest, highest = np.where(fits, middle, lowest), np.where(fits, highest, middle - 1)
    return lowest


def compute_ramp_down_energy(params: LimiterParams, level: IntArray) -> FloatArray:
    """Return an upper bound of the energy of a ramp from `level` to 0 [counts²].

    Σ (level − k·step)² ≤ level³ / (3 step).
    """
    amplitude = level.astype(np.float64)
    return np.asarray(amplitude * amplitude * amplitude / (3.0 * params.max_step))


def limit_slew(target: IntArray, last: IntArray, step: int) -> None:
    """Limit the steps of `target`, (n, channels) with n ≥ 1, to `step` counts per frame, in place.

    `last` (channels,) precedes the first frame. Where `target` is steeper it is approached as fast as `step` allows.
    """
    steep = np.abs(target[0] - last) > step
    if len(target) > 1:
        steep |= np.abs(target[1:] - target[:-1]).max(axis=0) > step
    if not steep.any():
        return
    for channel in np.flatnonzero(steep):
        level, path = int(last[channel]), []
        for goal in target[:, channel].tolist():
            level = goal if -step <= goal - level <= step else level + step if goal > level else level - step
            path.append(level)
        target[:, channel] = path


HeatArray = NDArray[np.float64]


class ThermalState:
    """Warmth of the coils of named devices, kept for the lifetime of this process.

    `clock` returns monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._devices: dict[str, tuple[float, float, HeatArray]] = {}

    def record(self, device: str, limits: Limits, heat: HeatArray) -> None:
        """Store the warmth of a device at the end of a stream.

        Parameters
        ----------
        device : str
            Name of the device. Of two devices with one name the warmer counts.
        limits : Limits
            Limits that the warmth refers to.
        heat : (channels,) array
            Fraction of the bound, 0–1, as from `Limiter.heat`.
        """
        heat = np.maximum(heat, self.get_heat(device, limits, len(heat)))
        square = heat * (limits.sustained * limits.full_scale_m_s2) ** 2
        with self._lock:
            self._devices[device] = (self._clock(), limits.thermal_s, square)

    def get_heat(self, device: str, limits: Limits, channels: int) -> HeatArray:
        """Return the present warmth, (channels,) 0–1, for a new `Limiter`.

        If the number of channels has changed, all start as warm as the warmest.
        """
        with self._lock:
            recorded_s, thermal_s, square = self._devices.get(device, (0.0, 1.0, np.zeros(channels)))
            decay = float(np.exp(-(self._clock() - recorded_s) / thermal_s))
        if len(square) != channels:
            square = np.full(channels, square.max(initial=0.0))
        return np.asarray(np.clip(decay * square / (limits.sustained * limits.full_scale_m_s2) ** 2, 0.0, 1.0))


THERMAL_STATE = ThermalState()
"""Warmth of all devices that this process has played on."""
