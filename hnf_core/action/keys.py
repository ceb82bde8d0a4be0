"""Cubic keyframes: what a Blender F-curve with handles a third of the way computes, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Keyframes:
    """time (k,) s ascending, value (k,), slope (k,) per second. Between keys the cubic Hermite polynomial, which a
    Bézier F-curve draws exactly when its handles lie a third of the way in time; outside, the end values."""

    time: Float
    value: Float
    slope: Float

    def sample(self, time: ArrayLike) -> tuple[Float, Float]:
        """Value and its rate of change per second, (n,) each."""
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


def make_eased_travel(distance: float, speed: float, ramp_s: float, start_s: float = 0.0) -> Keyframes:
    """Travel 0 → distance at constant speed, with S-shaped ramps (acceleration continuous) at both ends.

    Takes distance / speed + ramp. A ramp longer than distance / speed is shortened to it, so that the speed is
    reached however short the way is.
    """
    ramp = min(ramp_s, distance / speed)
    if ramp < 1e-6:
        lasting = distance / speed + ramp
        return Keyframes(start_s + np.array([0.0, lasting]), np.array([0.0, distance]), np.array([speed, speed]))
    cruise = distance / speed - ramp
    # In half a ramp of duration r the speed goes 2v·(t/r)², which covers v·r/12; the second half mirrors it.
    half = np.array([0.0, ramp / 2, ramp])
    covered = np.array([0.0, ramp / 12, ramp / 2])
    rise = np.array([0.0, 0.5, 1.0])
    time = np.concatenate([half, ramp + cruise + half])
    value = np.concatenate([covered, ramp + cruise - covered[::-1]])
    keys = Keyframes(start_s + time, speed * value, speed * np.concatenate([rise, rise[::-1]]))
    distinct = np.concatenate([[True], np.diff(keys.time) > 1e-9])
    return Keyframes(keys.time[distinct], keys.value[distinct], keys.slope[distinct])
