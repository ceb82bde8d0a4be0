"""Measured series on any time grid → a(t) at 10 kHz and an action at 200 Hz.

What was measured of one stroke, quantity by quantity → a Recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import FileError
from ..field.resampling import resample
from ..simulation.dft321 import dft321
from .recording import Recording

Float = NDArray[np.float64]

SIGNAL_RATE_HZ = 10_000.0
HAND_BANDWIDTH_HZ = 20.0
"""A hand does not move faster; what a force or speed sensor shows above is the vibration itself, and an action that
carries the answer would be learned from instead of the material."""
REST_SPEED_M_S = 1e-3
"""Slower than this, the last direction is kept: below it a tracked position is mostly noise."""
MIN_DURATION_S = 0.1
MIN_SAMPLING_HZ = 2000.0
"""Slower than this, an accelerometer does not hold the touch band."""
LONG_GAP_S = 5e-3
RATE_ROUNDING = 1e-5
"""Of a rate: what rounded times make of a whole number."""
SMOOTHING_MARGIN_S = 0.2
"""What smoothing may look at beyond the part that is kept."""


def check_time_grid(time: Float, where: str) -> None:
    """Raises FileError unless time [s] (n ≥ 4,) rises from sample to sample, by a nanosecond or more."""
    if len(time) < 4:
        raise FileError(f"only {len(time)} samples.", where=where, remedy="Get the file again.")
    standing = np.diff(time) < 1e-9
    if standing.any():
        row = int(np.argmax(standing)) + 2
        raise FileError(f"time does not rise at sample {row}.", where=where, remedy="Get the file again.")


def measure_sampling_rate(time: Float, where: str) -> tuple[float, tuple[str, ...]]:
    """Mean rate [Hz] of a grid of accelerations, and a note of its longest gap where that is long. Raises FileError
    where it is too slow."""
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if rate < MIN_SAMPLING_HZ:
        raise FileError(
            f"sampled {rate:.0f} times a second only.",
            where=where,
            remedy=f"Its time column should be in seconds; {MIN_SAMPLING_HZ:g} Hz are the least.",
        )
    gap = float(np.diff(time).max())
    if abs(rate - round(rate)) < RATE_ROUNDING * rate:
        rate = float(round(rate))
    return rate, (f"a gap of {1e3 * gap:.0f} ms between samples is bridged",) if gap > LONG_GAP_S else ()


def interpolate_series(time: Float, values: Float, new_time: Float) -> Float:
    """values (n,) or (n, k) on a rising grid, at other times: cubic Hermite, slopes by parabolas through three samples.

    Beyond the ends the end values are kept.
    """
    step = np.diff(time)
    step = step.reshape(-1, *[1] * (values.ndim - 1))
    secant = np.diff(values, axis=0) / step
    slope = np.concatenate(
        [secant[:1], (secant[:-1] * step[1:] + secant[1:] * step[:-1]) / (step[:-1] + step[1:]), secant[-1:]]
    )
    new_time = np.clip(new_time, time[0], time[-1])
    low = np.clip(np.searchsorted(time, new_time, side="right") - 1, 0, len(time) - 2)
    width = step[low]
    t = ((new_time - time[low]).reshape(width.shape)) / width
    rise = values[low + 1] - values[low]
    bend = width * (slope[low] + slope[low + 1]) - 2.0 * rise
    return np.asarray(values[low] + t * (width * slope[low] + t * (rise - width * slope[low] - bend * (1.0 - t))))


def smooth_series(values: Float, rate: float, cutoff_hz: float = HAND_BANDWIDTH_HZ) -> Float:
    """(n,) or (n, k) without what is faster than cutoff_hz (Gaussian, −3 dB there, no delay; ends point-mirrored)."""
    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi * cutoff_hz)
    pad = min(len(values) - 1, int(np.ceil(6.0 * sigma * rate)))
    first, last = values[:1], values[-1:]
    longer = np.concatenate([2 * first - values[pad:0:-1], values, 2 * last - values[-2 : -pad - 2 : -1]])
    gain = np.exp(-0.5 * np.square(2.0 * np.pi * sigma * np.fft.rfftfreq(len(longer), 1.0 / rate)))
    spectrum = np.fft.rfft(longer, axis=0) * gain.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.fft.irfft(spectrum, len(longer), axis=0)[pad : pad + len(values)])


def resample_to_action_rate(time: Float, values: Float, start: float, count: int) -> Float:
    """A measured quantity at the action rate, count samples from start [s], without what is faster than a hand.

    Smoothed on a grid as fine as the measurement, so that its vibration does not alias.
    """
    rate = max(ACTION_RATE_HZ, (len(time) - 1) / float(time[-1] - time[0]))
    first = max(float(time[0]), start - SMOOTHING_MARGIN_S)
    last = min(float(time[-1]), start + count / ACTION_RATE_HZ + SMOOTHING_MARGIN_S)
    even = first + np.arange(int((last - first) * rate + 1e-6) + 1) / rate
    slow = smooth_series(interpolate_series(time, values, even), rate)
    return interpolate_series(even, slow, start + np.arange(count) / ACTION_RATE_HZ)


def count_action_samples(duration_s: float, where: str) -> int:
    """Action samples that fit into a duration. Raises FileError for less than SHORTEST_S."""
    if not duration_s >= MIN_DURATION_S:
        raise FileError(
            f"all its signals together last {max(duration_s, 0.0):.3f} s only.",
            where=where,
            remedy="The files of this stroke do not belong together, or are cut off.",
        )
    return int(duration_s * ACTION_RATE_HZ + 1e-6) + 1


def build_action(direction: Float, speed: Float, force: Float, probe: str = "pen") -> Action:
    """Series (n, 2), (n,) m/s, (n,) N at the action rate → Action; negative speed and force count as 0."""
    speed, force = np.maximum(speed, 0.0), np.maximum(force, 0.0)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / ACTION_RATE_HZ
    return Action(ACTION_RATE_HZ, direction, speed, force, position, force > 0.0, probe)


def derive_motion(position: Float) -> tuple[Float, Float]:
    """(n, 2) m at the action rate → direction (n, 2), speed (n,). Where the hand rests, the last direction is kept
    (before the first motion, the first; with no motion at all, +x)."""
    velocity = np.gradient(position, 1.0 / ACTION_RATE_HZ, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    moving = np.flatnonzero(speed > REST_SPEED_M_S)
    if len(moving) == 0:
        return constant_direction(len(position), 0.0), speed
    latest = moving[np.maximum(np.searchsorted(moving, np.arange(len(speed)), side="right") - 1, 0)]
    return velocity[latest] / speed[latest, None], speed


def constant_direction(count: int, angle_rad: float) -> Float:
    return np.tile([np.cos(angle_rad), np.sin(angle_rad)], (count, 1))


DURATION_TOLERANCE = 0.02


@dataclass(frozen=True)
class MeasuredSignal:
    """One quantity, (n, axes) in SI units, axes in the order x, y, z, or one."""

    quantity: str
    axes: tuple[str, ...]
    values: Float
    rate: float
    source: str
    notes: tuple[str, ...] = ()

    @property
    def time(self) -> Float:
        return np.arange(len(self.values)) / self.rate


def assemble_recording(signals: Sequence[MeasuredSignal], material: str, where: str) -> Recording:
    """The signals of one stroke → Recording. What is not there is assumed and said: direction +x, 0.1 m/s, 1 N.

    Raises FileError without acceleration, with a quantity twice, or where they do not last equally long (to 2 %).
    """
    by_name = {signal.quantity: signal for signal in signals}
    if len(by_name) != len(signals):
        raise FileError("a quantity stands in it twice.", where=where, remedy="Keep one file per quantity and stroke.")
    if "acceleration" not in by_name:
        raise FileError("there is no acceleration.", where=where, remedy="Give the Accel file of this stroke too.")
    lasting = {name: len(signal.values) / signal.rate for name, signal in by_name.items()}
    shortest, longest = min(lasting.values()), max(lasting.values())
    if longest - shortest > DURATION_TOLERANCE * longest:
        listed = ", ".join(f"{name} {seconds:.3f} s" for name, seconds in sorted(lasting.items()))
        raise FileError(f"its signals do not belong together: {listed}.", where=where, remedy="Get the file again.")
    count = count_action_samples(shortest, where)
    notes = [note for signal in signals for note in signal.notes]
    acceleration = by_name["acceleration"]
    samples = _resample_acceleration(acceleration, round((count - 1) * SIGNAL_RATE_HZ / ACTION_RATE_HZ), where)
    force, force_known = _resample_force(by_name.get("force"), count, notes, where)
    direction, speed, moving_known = _resample_motion(by_name, count, notes, where)
    return Recording(
        build_action(direction, speed, force), samples, SIGNAL_RATE_HZ, material, where,
        frozenset(force_known + moving_known), tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _resample_acceleration(acceleration: MeasuredSignal, count: int, where: str) -> Float:
    values = acceleration.values - acceleration.values.mean(axis=0)
    if values.shape[1] not in (1, 3):
        raise FileError(f"acceleration has {values.shape[1]} axes.", where=where, remedy="One or three are expected.")
    fused = dft321(values) if values.shape[1] == 3 else values[:, 0]
    if acceleration.rate > SIGNAL_RATE_HZ:  # what only the faster rate holds must not fold into the touch band
        fused = resample(fused, acceleration.rate, SIGNAL_RATE_HZ)[0]
    elif acceleration.rate < SIGNAL_RATE_HZ:
        fused = interpolate_series(acceleration.time, fused, np.arange(count) / SIGNAL_RATE_HZ)
    return fused[:count].copy()


def _resample_force(signal: MeasuredSignal | None, count: int, notes: list[str], where: str) -> tuple[Float, list[str]]:
    if signal is None:
        notes.append("no force was recorded: 1 N assumed")
        return np.ones(count), []
    normal = signal.values[:, -1]
    if signal.values.shape[1] > 1:
        notes.append("the last axis of force is taken as normal to the surface")
    if normal.mean() < 0.0:
        notes.append("force is negative on average: its sign is turned")
        normal = -normal
    return resample_to_action_rate(signal.time, normal, 0.0, count), ["force"]


def _resample_motion(
    signals: dict[str, MeasuredSignal], count: int, notes: list[str], where: str
) -> tuple[Float, Float, list[str]]:
    position, speed = signals.get("position"), signals.get("speed")
    direction, pace, known = constant_direction(count, 0.0), np.full(count, 0.1), []
    if position is not None and position.values.shape[1] >= 2:
        direction, pace = derive_motion(resample_to_action_rate(position.time, position.values[:, :2], 0.0, count))
        known = ["direction", "speed"]
    else:
        notes.append("no position in a plane was recorded: direction +x assumed")
    if speed is not None:
        along = speed.values[:, 0] if speed.values.shape[1] == 1 else np.linalg.norm(speed.values[:, :2], axis=1)
        pace = np.abs(resample_to_action_rate(speed.time, along, 0.0, count))
        known = [*known, "speed"]
    elif not known:
        notes.append("no speed was recorded: 0.1 m/s assumed")
    return direction, pace, known
