"""Keyframes: cubic keys in closed form, their fit to sampled quantities, and F-curves as Blender evaluates them.

F-curves are evaluated in float64: Blender's own evaluation rounds time to float32, which at frame 10,000 would change
the speed of a 100 mm/s stroke by half a per cent.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Keyframes:
    """Cubic keyframes: rising times (k,) [s], values (k,) and slopes (k,) [1/s].

    Between keys the value is the cubic Hermite polynomial, which a Bézier F-curve draws exactly if its handles are a
    third of the way in time; outside, the end values continue.
    """

    time: Float
    value: Float
    slope: Float

    def sample(self, time: ArrayLike) -> tuple[Float, Float]:
        """Return value and rate of change per second, (n,) each, at times (n,) [s]."""
        t = np.asarray(time, dtype=np.float64)
        if len(self.time) == 1:
            return np.full(t.shape, self.value[0]), np.zeros(t.shape)
        i = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 2)
        width = self.time[i + 1] - self.time[i]
        u = np.clip((t - self.time[i]) / width, 0.0, 1.0)
        a, b = self.value[i], self.value[i + 1]
        m, n = self.slope[i] * width, self.slope[i + 1] * width
        value = a + u * (m + u * (3 * (b - a) - 2 * m - n + u * (m + n - 2 * (b - a))))
        rate = (m + u * (2 * (3 * (b - a) - 2 * m - n) + 3 * u * (m + n - 2 * (b - a)))) / width
        outside = (t < self.time[0]) | (t > self.time[-1])
        return value, np.where(outside, 0.0, rate)


def make_eased_travel(
    distance: float, speed: float, ramp_s: float, start_s: float = 0.0, *, end_speed: float | None = None
) -> Keyframes:
    """Make keyframes of a motion from 0 to `distance` at a speed, with S-shaped starts and stops of `ramp_s`.

    Between them the speed is constant, or changes evenly to `end_speed`. Acceleration is continuous there if it is
    constant. The travel takes distance / mean speed + ramp; a ramp longer than that first part is shortened to it, so
    that the speed is reached on any distance.
    """
    last = speed if end_speed is None else end_speed
    mean = speed if end_speed is None else 0.5 * (speed + end_speed)
    ramp = min(ramp_s, distance / mean)
    if ramp < 1e-6:
        duration = distance / mean + ramp
        return Keyframes(start_s + np.array([0.0, duration]), np.array([0.0, distance]), np.array([mean, mean]))
    cruise = distance / mean - ramp
    # In the first half of a ramp of duration r the speed is 2v·(t/r)², which covers v·r/12; the second mirrors it.
    half = np.array([0.0, ramp / 2, ramp])
    covered = np.array([0.0, ramp / 12, ramp / 2])
    rise = np.array([0.0, 0.5, 1.0])
    time = np.concatenate([half, ramp + cruise + half])
    if end_speed is None:
        value = speed * np.concatenate([covered, ramp + cruise - covered[::-1]])
    else:
        value = np.concatenate([speed * covered, distance - last * covered[::-1]])
    keys = Keyframes(start_s + time, value, np.concatenate([speed * rise, last * rise[::-1]]))
    distinct = np.concatenate([[True], np.diff(keys.time) > 1e-9])
    return Keyframes(keys.time[distinct], keys.value[distinct], keys.slope[distinct])


def fit_keyframes(time: ArrayLike, value: ArrayLike, tolerance: float, *, rising: bool = False) -> Keyframes:
    """Fit keyframes to a sampled quantity, fewer where it changes smoothly.

    Parameters
    ----------
    time : array_like, shape (n,)
        Rising times [s], n ≥ 2.
    value : array_like, shape (n,)
        Samples.
    tolerance : float
        Largest error at any sample; a quantity that stays within it gets two keys.
    rising : bool
        True if the value never falls; then the curve between keys does not either (slopes limited after Fritsch and
        Carlson 1980).

    Returns
    -------
    Keyframes
        The keys.
    """
    t, v = np.asarray(time, dtype=np.float64), np.asarray(value, dtype=np.float64)
    if np.ptp(v) <= tolerance and not rising:
        middle = float(v.max() + v.min()) / 2.0
        return Keyframes(t[[0, -1]], np.full(2, middle), np.zeros(2))
    slope = np.gradient(v, t)
    chosen = np.zeros(len(t), dtype=bool)
    chosen[[0, -1]] = True
    while True:
        keys = _make_keyframes(t, v, slope, chosen, rising)
        error = np.abs(keys.sample(t)[0] - v)
        if error.max() <= tolerance or chosen.all():
            return keys
        chosen_indices = np.flatnonzero(chosen)
        worst = [a + 1 + int(np.argmax(error[a + 1 : b])) for a, b in itertools.pairwise(chosen_indices) if b > a + 1]
        chosen[[k for k in worst if error[k] > tolerance]] = True


def _make_keyframes(t: Float, v: Float, slope: Float, chosen: NDArray[np.bool_], rising: bool) -> Keyframes:
    time, value, key_slope = t[chosen], v[chosen], slope[chosen]
    if rising:
        secant = np.diff(value) / np.diff(time)
        max_slope = 3.0 * np.minimum(np.r_[secant, secant[-1]], np.r_[secant[0], secant])
        key_slope = np.clip(key_slope, 0.0, max_slope)
    return Keyframes(time, value, key_slope)


CONSTANT, LINEAR, BEZIER = "CONSTANT", "LINEAR", "BEZIER"
"""Interpolations of an F-curve."""


@dataclass(frozen=True)
class FCurve:
    """A Blender F-curve; before the first and after the last key the value is constant.

    Attributes
    ----------
    key, left, right : ndarray, shape (k, 2)
        Frame and value of keyframes and their handles, ascending in time.
    interpolation : tuple of str
        Interpolation from each key to the next: `CONSTANT`, `LINEAR` or `BEZIER`.
    """

    key: Float
    left: Float
    right: Float
    interpolation: tuple[str, ...]

    def evaluate(self, frames: ArrayLike) -> Float:
        """Return values (n,) at (fractional) frames (n,)."""
        frame = np.asarray(frames, dtype=np.float64)
        if len(self.key) == 1:
            return np.full(frame.shape, self.key[0, 1])
        i = np.clip(np.searchsorted(self.key[:, 0], frame, side="right") - 1, 0, len(self.key) - 2)
        start, end = self.key[i], self.key[i + 1]
        width = end[:, 0] - start[:, 0]
        fraction = np.clip(np.divide(frame - start[:, 0], width, out=np.ones_like(width), where=width > 0.0), 0.0, 1.0)
        value = start[:, 1] + fraction * (end[:, 1] - start[:, 1])
        kind = np.array(self.interpolation)[i]
        bezier = np.flatnonzero(kind == BEZIER)
        value[bezier] = _evaluate_bezier(
            start[bezier], self.right[i[bezier]], self.left[i[bezier] + 1], end[bezier], fraction[bezier]
        )
        constant = kind == CONSTANT
        value[constant] = start[constant, 1]
        value = np.where(frame <= self.key[0, 0], self.key[0, 1], value)
        return np.where(frame >= self.key[-1, 0], self.key[-1, 1], value)


def _evaluate_bezier(start: Float, right: Float, left: Float, end: Float, share: Float) -> Float:
    """Evaluate cubic Bézier segments at a fraction (n,) of their time.

    Handles (n, 2) that reach beyond the segment are shortened to it, as in Blender, so that time never runs backward.
    """
    width = (end - start)[:, :1]
    width = np.where(width > 0.0, width, 1.0)  # of two keys on one frame the later one counts
    first, second = right - start, left - end
    first = first * _compute_shortening(first[:, :1], width)
    second = second * _compute_shortening(second[:, :1], width)
    a = first[:, 0] / width[:, 0]
    b = 1.0 + second[:, 0] / width[:, 0]
    low, high = np.zeros(len(share)), np.ones(len(share))
    u = share.copy()
    for _ in range(64):
        error = _evaluate_cubic(u, a, b) - share
        low, high = np.where(error < 0.0, u, low), np.where(error > 0.0, u, high)
        slope = 3.0 * ((1 - u) ** 2 * a + 2 * u * (1 - u) * (b - a) + u * u * (1 - b))
        step = u - np.divide(error, slope, out=np.full_like(u, np.inf), where=slope > 0.0)
        u = np.where((step >= low) & (step <= high), step, (low + high) / 2.0)
        if np.all(np.abs(error) < 1e-15):
            break
    v = 1.0 - u
    values = np.stack([start, start + first, end + second, end], axis=2)[:, 1]
    return np.asarray(
        v**3 * values[:, 0] + 3 * u * v * v * values[:, 1] + 3 * u * u * v * values[:, 2] + u**3 * values[:, 3]
    )


def _evaluate_cubic(u: Float, a: Float, b: Float) -> Float:
    return np.asarray(3 * u * (1 - u) ** 2 * a + 3 * u * u * (1 - u) * b + u**3)


def _compute_shortening(reach: Float, width: Float) -> Float:
    return np.asarray(width / np.maximum(np.abs(reach), width))
