"""Curves by arc length: length, and the point and tangent at a distance s along the curve, in float64."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StrokeError
from .bezier import PiecewiseBezier

Float = NDArray[np.float64]
Int = NDArray[np.intp]

LENGTH_TOLERANCE = 1e-10
"""Relative to the whole curve, per panel; four orders below the 1e-6 that strokes promise."""
_MAX_DEPTH = 40


def _make_gauss_rule(count: int) -> tuple[Float, Float]:
    """Gauss-Legendre nodes and weights on [0, 1] (Golub and Welsch 1969)."""
    k = np.arange(1.0, count)
    off_diagonal = k / np.sqrt(4.0 * k * k - 1.0)
    nodes, vectors = np.linalg.eigh(np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1))
    return (nodes + 1.0) / 2.0, vectors[0] ** 2


_NODES, _WEIGHTS = _make_gauss_rule(12)


@dataclass(frozen=True)
class ArcCurve:
    """A piecewise curve with its arc-length table.

    Panels are pieces of segments short enough that one 12-point Gauss rule is exact to LENGTH_TOLERANCE.
    segment, start, end: (P,) segment number and parameter range of each panel. station: (P + 1,) arc length at the
    panels' borders; station[-1] is the length.
    """

    curve: PiecewiseBezier
    segment: Int
    start: Float
    end: Float
    station: Float

    @property
    def length(self) -> float:
        return float(self.station[-1])

    def point_at(self, s: ArrayLike) -> Float:
        """Points (n, dim) at arc lengths s (n,), clamped to [0, length]."""
        segment, u, _ = self._find_parameter(s)
        return self.curve.evaluate(segment, u)[0]

    def tangent_at(self, s: ArrayLike) -> Float:
        """Unit tangents (n, dim) at arc lengths s (n,); at a corner the direction of travel after it.

        Zero vectors where the curve has no length at all.
        """
        segment, u, panel = self._find_parameter(s)
        if self.length == 0.0:
            return np.zeros((len(u), self.curve.dimension))
        derivative = self.curve.evaluate(segment, u)[1]
        speed = np.linalg.norm(derivative, axis=1)
        # A zero handle makes dC/du vanish at its knot; the tangent is the limit from inside the panel.
        scale = (self.station[panel + 1] - self.station[panel]) / (self.end[panel] - self.start[panel])
        still = speed < 1e-6 * scale
        if np.any(still):
            middle = (self.start[panel] + self.end[panel]) / 2.0
            inside = u + 1e-4 * (middle - u)
            derivative[still] = self.curve.evaluate(segment, inside)[1][still]
            speed = np.linalg.norm(derivative, axis=1)
        return np.asarray(derivative / np.where(speed > 0.0, speed, 1.0)[:, None])

    def parameter_at(self, s: ArrayLike) -> tuple[Int, Float]:
        """Segment number and its parameter u (n,) at arc lengths s (n,): the same place on any affine image."""
        segment, u, _ = self._find_parameter(s)
        return segment, u

    def _find_parameter(self, s: ArrayLike) -> tuple[Int, Float, Int]:
        """Segment, parameter and panel of arc lengths: Newton on the panel's own quadrature, kept in a bracket."""
        target = np.clip(np.atleast_1d(np.asarray(s, dtype=np.float64)), 0.0, self.length)
        panel = np.clip(np.searchsorted(self.station, target, side="right") - 1, 0, len(self.segment) - 1)
        segment, base = self.segment[panel], self.start[panel]
        low, high = base.copy(), self.end[panel].copy()
        rest = target - self.station[panel]
        span = self.station[panel + 1] - self.station[panel]
        u = low + (high - low) * np.divide(rest, span, out=np.zeros_like(rest), where=span > 0.0)
        todo = np.arange(len(u))
        for _ in range(60):
            at = u[todo]
            error = _compute_arc_lengths(self.curve, segment[todo], base[todo], at) - rest[todo]
            open_ = np.abs(error) > 1e-12 * self.station[-1]
            todo, at, error = todo[open_], at[open_], error[open_]
            if len(todo) == 0:
                break
            low[todo], high[todo] = np.where(error < 0.0, at, low[todo]), np.where(error > 0.0, at, high[todo])
            speed = np.linalg.norm(self.curve.evaluate(segment[todo], at)[1], axis=1)
            step = at - np.divide(error, speed, out=np.full_like(at, np.inf), where=speed > 0.0)
            inside = (step > low[todo]) & (step < high[todo])
            u[todo] = np.where(inside, step, (low[todo] + high[todo]) / 2.0)
        return segment, u, panel


def _compute_arc_lengths(curve: PiecewiseBezier, segment: Int, start: Float, end: Float) -> Float:
    """∫ |dC/du| du over [start, end] of each segment, one Gauss rule each."""
    width = end - start
    u = start[:, None] + width[:, None] * _NODES
    derivative = curve.evaluate(np.repeat(segment, len(_NODES)), u.ravel())[1]
    return np.asarray(width * (np.linalg.norm(derivative, axis=1).reshape(u.shape) @ _WEIGHTS))


def build_arc_curve(curve: PiecewiseBezier) -> ArcCurve:
    """Table of a curve's arc length by adaptive bisection of its segments.

    Raises StrokeError for a curve that reaches farther than lengths can be computed (some 1e150 m).
    """
    segment = np.arange(curve.segment_count, dtype=np.intp)
    start, end = np.zeros(len(segment)), np.ones(len(segment))
    with np.errstate(over="ignore", invalid="ignore"):
        whole = _compute_arc_lengths(curve, segment, start, end)
    if not np.isfinite(whole.sum()):
        raise StrokeError(
            "the curve has no finite length.", remedy="Check its points, the object's scale and the scene's unit scale."
        )
    # Far from the origin the points themselves are rounded: no panel is better than that.
    rounding = 8.0 * float(np.finfo(np.float64).eps * np.abs(curve.control).max())
    tolerance = max(LENGTH_TOLERANCE * float(whole.sum()), rounding, sys.float_info.min)
    done: list[tuple[Int, Float, Float, Float]] = []
    for depth in range(_MAX_DEPTH + 1):
        middle = (start + end) / 2.0
        first = _compute_arc_lengths(curve, segment, start, middle)
        second = _compute_arc_lengths(curve, segment, middle, end)
        fine = (np.abs(first + second - whole) <= tolerance) | (depth == _MAX_DEPTH)
        # The halves are the panels: each is then as long as its own rule says, and no border is a step of the length.
        done.append((segment[fine], start[fine], middle[fine], first[fine]))
        done.append((segment[fine], middle[fine], end[fine], second[fine]))
        rough = ~fine
        segment = np.concatenate([segment[rough], segment[rough]])
        start, end = np.concatenate([start[rough], middle[rough]]), np.concatenate([middle[rough], end[rough]])
        whole = np.concatenate([first[rough], second[rough]])
        if len(segment) == 0:
            break
    segment, start, end, lengths = (np.concatenate(part) for part in zip(*done, strict=True))
    order = np.lexsort((start, segment))
    if np.any(lengths > 0.0):
        order = order[lengths[order] > 0.0]  # doubled points: a panel without length has no tangent
    station = np.concatenate([[0.0], np.cumsum(lengths[order])])
    return ArcCurve(curve, segment[order], start[order], end[order], station)


def require_single_spline(splines: Sequence[PiecewiseBezier], *, where: str) -> PiecewiseBezier:
    """The one spline of a stroke. Raises StrokeError for none, or for several: a stroke is one touch, and choosing
    the first silently would drop what the artist drew after it."""
    if not splines:
        raise StrokeError("the curve has no spline.", where=where, remedy="Draw a curve in Edit Mode.")
    if len(splines) > 1:
        raise StrokeError(
            f"the curve has {len(splines)} splines, and a stroke is one.",
            where=where,
            remedy="Separate them (Edit Mode, P, By Loose Parts) into one stroke object each.",
        )
    return splines[0]
