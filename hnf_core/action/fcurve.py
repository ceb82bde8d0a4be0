"""Keyframes as Blender interpolates them, in float64: Blender's own evaluation rounds time to float32, which at
frame 10,000 would shake a 100 mm/s stroke by half a per cent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

CONSTANT, LINEAR, BEZIER = "CONSTANT", "LINEAR", "BEZIER"


@dataclass(frozen=True)
class FCurve:
    """key, left, right: (k, 2) (frame, value) of keyframes and their handles, ascending in time. interpolation:
    CONSTANT, LINEAR or BEZIER from each key to the next. Before the first and after the last key the value holds."""

    key: Float
    left: Float
    right: Float
    interpolation: tuple[str, ...]

    def evaluate(self, frames: ArrayLike) -> Float:
        """Values (n,) at (fractional) frames (n,)."""
        frame = np.asarray(frames, dtype=np.float64)
        if len(self.key) == 1:
            return np.full(frame.shape, self.key[0, 1])
        i = np.clip(np.searchsorted(self.key[:, 0], frame, side="right") - 1, 0, len(self.key) - 2)
        start, end = self.key[i], self.key[i + 1]
        width = end[:, 0] - start[:, 0]
        share = np.clip(np.divide(frame - start[:, 0], width, out=np.ones_like(width), where=width > 0.0), 0.0, 1.0)
        value = start[:, 1] + share * (end[:, 1] - start[:, 1])
        kind = np.array(self.interpolation)[i]
        bezier = np.flatnonzero(kind == BEZIER)
        value[bezier] = _evaluate_bezier(
            start[bezier], self.right[i[bezier]], self.left[i[bezier] + 1], end[bezier], share[bezier]
        )
        constant = kind == CONSTANT
        value[constant] = start[constant, 1]
        value = np.where(frame <= self.key[0, 0], self.key[0, 1], value)
        return np.where(frame >= self.key[-1, 0], self.key[-1, 1], value)


def _evaluate_bezier(start: Float, right: Float, left: Float, end: Float, share: Float) -> Float:
    """Values of cubic Bézier pieces at a share (n,) of their time; handles (n, 2) that reach past the piece are
    shortened to it, as Blender does, so that time never runs backward."""
    width = (end - start)[:, :1]
    width = np.where(width > 0.0, width, 1.0)  # two keys on one frame: the later one counts
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
