"""Strokes drawn with mouse or pen on a surface: from samples to a smooth path with keyframes of progress and force.

The path is few cubic Bézier segments, fitted to the many points: P. J. Schneider, "An algorithm for automatically
fitting digitized curves", Graphics Gems 1990; all segments of one round are fitted together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StrokeError
from .action import ACTION_RATE_HZ
from .curves import ArcCurve, build_arc_curve, make_bezier_curve
from .keyframes import Keyframes, fit_keyframes
from .motion_profile import MAX_DURATION_S, compute_travel_time, make_motion_at_speed, make_time_grid

Float = NDArray[np.float64]
Int = NDArray[np.intp]

_MAX_REPARAMETRISATIONS = 4
_SPLIT_TOLERANCES = 8.0
"""Error in tolerances above which a segment is split at once, since other parameters cannot correct that much."""
_MAX_HANDLE_SHARE = 1.5
"""Longest handle relative to the segment's length; a longer one is a bad least-squares solution."""
_INNER_PARAMETERS = np.array([0.25, 0.5, 0.75])
_THIRDS = np.array([0.0, 1 / 3, 2 / 3, 1.0])


@dataclass(frozen=True)
class FittedBezier:
    """A fitted Bézier spline, as Blender stores it.

    Control points and their two handles, (k, dim) each, and the index (k,) of each control point in the fitted points.
    """

    knot: Float
    left: Float
    right: Float
    index: Int


@dataclass(frozen=True)
class _Path:
    """A polyline to fit.

    Attributes
    ----------
    point : ndarray, shape (n, dim)
        Points.
    station : ndarray, shape (n,)
        Length up to each point.
    after, before : ndarray, shape (n, dim)
        Unit tangents into the segments after and before a point, opposite to each other unless the path turns back
        there.
    """

    point: Float
    station: Float
    after: Float
    before: Float


@dataclass(frozen=True)
class _Segments:
    """Division of a polyline into k segments, each to be fitted by a cubic, with their n points in one sequence.

    Attributes
    ----------
    first, last : ndarray of int, shape (k,)
        Indices of their end points in the polyline.
    at : ndarray of int, shape (n,)
        Index of each point in the polyline.
    segment : ndarray of int, shape (n,)
        Segment of each point.
    begin : ndarray of int, shape (k,)
        Index in the sequence at which each segment starts.
    """

    first: Int
    last: Int
    at: Int
    segment: Int
    begin: Int

    def max_per_segment(self, values: Float) -> Float:
        """Return the maximum (k,) of values (n,) in each segment."""
        return np.asarray(np.maximum.reduceat(values, self.begin))

    def sum_per_segment(self, values: Float) -> Float:
        """Return the sum (k, …) of values (n, …) in each segment."""
        return np.asarray(np.add.reduceat(values, self.begin, axis=0))


def fit_bezier(points: ArrayLike, tolerance: float) -> FittedBezier:
    """Fit a Bézier spline to a polyline, each within the tolerance of the other.

    Control points are input points, including the ends; segments join smoothly except where the path turns back on
    itself.

    Parameters
    ----------
    points : array_like, shape (n, dim)
        Points; consecutive ones must differ.
    tolerance : float
        Largest distance, in the points' unit.

    Returns
    -------
    FittedBezier
        The spline.

    Raises
    ------
    StrokeError
        For fewer than two points.
    """
    point = np.asarray(points, dtype=np.float64)
    if point.ndim != 2 or len(point) < 2:
        raise StrokeError("a path needs two points.", remedy="Drag further.")
    path = _measure_path(point)
    first, last = np.array([0], dtype=np.intp), np.array([len(point) - 1], dtype=np.intp)
    begins, controls = [], []
    while len(first):
        control, split = _fit_segments(path, _make_segments(first, last), tolerance)
        is_fitted = split < 0
        begins.append(first[is_fitted])
        controls.append(control[is_fitted])
        first, split, last = first[~is_fitted], split[~is_fitted], last[~is_fitted]
        first, last = np.concatenate([first, split]), np.concatenate([split, last])
    begin, control = np.concatenate(begins), np.concatenate(controls)
    order = np.argsort(begin)
    index, control = np.append(begin[order], len(point) - 1), control[order]
    left = np.concatenate([point[:1] - (control[0, 1] - point[0]), control[:, 2]])
    right = np.concatenate([control[:, 1], point[-1:] - (control[-1, 2] - point[-1])])
    return FittedBezier(point[index], left, right, index)


def _measure_path(point: Float) -> _Path:
    edges = np.diff(point, axis=0)
    length = np.linalg.norm(edges, axis=1)
    unit = edges / length[:, None]
    next_direction = np.concatenate([unit, np.zeros_like(unit[:1])])
    previous_direction = np.concatenate([np.zeros_like(unit[:1]), unit])
    smooth = (next_direction * previous_direction).sum(axis=1, keepdims=True) > 0.0
    smooth[[0, -1]] = True
    after, before = next_direction + smooth * previous_direction, -(previous_direction + smooth * next_direction)
    return _Path(
        point,
        np.concatenate([[0.0], np.cumsum(length)]),
        after / np.linalg.norm(after, axis=1, keepdims=True),
        before / np.linalg.norm(before, axis=1, keepdims=True),
    )


def _make_segments(first: Int, last: Int) -> _Segments:
    count = last - first + 1
    begin = np.cumsum(count) - count
    segment = np.repeat(np.arange(len(first)), count)
    return _Segments(first, last, np.arange(len(segment)) - begin[segment] + first[segment], segment, begin)


def _fit_segments(path: _Path, segments: _Segments, tolerance: float) -> tuple[Float, Int]:
    """Return the segments' cubics (k, 4, dim), and the point index at which each must be split.

    The index is −1 for a segment within the tolerance.
    """
    ends = path.point[segments.first], path.point[segments.last]
    control = ends[0][:, None] + _THIRDS[:, None] * (ends[1] - ends[0])[:, None]
    split = np.full(len(segments.first), -1, dtype=np.intp)
    u = _parametrise_by_length(path, segments)
    curved = segments.max_per_segment(_compute_distances(control, path.point, segments, u)) > 1e-3 * tolerance
    pending, u = np.flatnonzero(curved), u[curved[segments.segment]]
    short = segments.last == segments.first + 1
    for _ in range(_MAX_REPARAMETRISATIONS):
        if len(pending) == 0:
            break
        subset = _make_segments(segments.first[pending], segments.last[pending])
        candidate = _fit_with_tangents(path, subset, u)
        error = _compute_distances(candidate, path.point, subset, u)
        worst = subset.max_per_segment(error)
        is_fitted = worst <= tolerance
        control[pending[is_fitted]] = candidate[is_fitted]
        split[pending] = np.where(is_fitted | short[pending], -1, _find_split(subset, error, worst))
        retry = ~is_fitted & (worst <= _SPLIT_TOLERANCES * tolerance) & ~short[pending]
        u = _reparametrise(candidate, path.point, subset, u)[retry[subset.segment]]
        pending = pending[retry]
    return control, split


def _parametrise_by_length(path: _Path, segments: _Segments) -> Float:
    """Return curve parameters (n,), 0–1, in proportion to the polyline's length inside each segment."""
    begin, end = path.station[segments.first], path.station[segments.last]
    return np.asarray((path.station[segments.at] - begin[segments.segment]) / (end - begin)[segments.segment])


def _find_split(segments: _Segments, error: Float, worst: Float) -> Int:
    """Return the index (k,) of the inner point at or before the largest error of each segment.

    error: (n,) of each point. worst: (k,) largest of each segment.
    """
    at_worst = np.flatnonzero(error == worst[segments.segment])
    _, earliest = np.unique(segments.segment[at_worst], return_index=True)
    return np.asarray(np.clip(segments.at[at_worst[earliest]], segments.first + 1, segments.last - 1))


def _fit_with_tangents(path: _Path, segments: _Segments, u: Float) -> Float:
    """Fit least-squares cubics (k, 4, dim) to the points at parameters u (n,), with the polyline's end tangents."""
    start, end = path.after[segments.first], path.before[segments.last]
    begin, stop = path.point[segments.first], path.point[segments.last]
    b = _bernstein(u)
    start_weight, end_weight = b[:, 0] + b[:, 1], b[:, 2] + b[:, 3]
    segment = segments.segment
    residual = path.point[segments.at] - start_weight[:, None] * begin[segment] - end_weight[:, None] * stop[segment]
    aa, ac, cc = segments.sum_per_segment(np.stack([b[:, 1] ** 2, b[:, 1] * b[:, 2], b[:, 2] ** 2], axis=1)).T
    ac = ac * _dot(start, end)
    p, q = (_dot(segments.sum_per_segment(b[:, [k]] * residual), length) for k, length in ((1, start), (2, end)))
    det, length = aa * cc - ac * ac, path.station[segments.last] - path.station[segments.first]
    solvable = np.abs(det) > 1e-12 * np.maximum(aa * cc, 1e-300)
    solution = np.stack([cc * p - ac * q, aa * q - ac * p], axis=1) / np.where(solvable, det, 1.0)[:, None]
    is_valid = solvable & ((solution > 1e-6 * length[:, None]) & (solution < _MAX_HANDLE_SHARE * length[:, None])).all(
        axis=1
    )
    chord = np.linalg.norm(stop - begin, axis=1, keepdims=True) / 3.0
    handles = np.where(is_valid[:, None], solution, chord)
    return np.stack([begin, begin + handles[:, :1] * start, stop + handles[:, 1:] * end, stop], axis=1)


def _bernstein(u: Float) -> Float:
    v = 1.0 - u
    inner = 3.0 * u * v
    return np.stack([v * v * v, inner * v, inner * u, u * u * u], axis=1)


def _dot(a: Float, b: Float) -> Float:
    """Return dot products (…) of vectors (…, dim)."""
    return np.asarray(np.einsum("...x,...x->...", a, b))


def _evaluate_segments(control: Float, segment: Int, u: Float) -> Float:
    return np.asarray(np.einsum("nk,nkx->nx", _bernstein(u), control[segment]))


def _compute_distances(control: Float, path: Float, segments: _Segments, u: Float) -> Float:
    """Return the fit's error (n,) at each point, from its distance to the curve at its parameter u (n,).

    Or, if larger, the distance of the curve from the polyline on the way to the next point.
    """
    point = path[segments.at]
    gap = _evaluate_segments(control, segments.segment, u) - point
    error = _dot(gap, gap)
    inner = np.flatnonzero(segments.segment[:-1] == segments.segment[1:])
    line = (point[inner + 1] - point[inner])[:, None]
    between = u[inner, None] + _INNER_PARAMETERS * (u[inner + 1] - u[inner])[:, None]
    curve = _evaluate_segments(control, np.repeat(segments.segment[inner], len(_INNER_PARAMETERS)), between.ravel())
    offset = curve.reshape(*between.shape, -1) - point[inner, None]
    fraction = np.clip(_dot(offset, line) / np.maximum(_dot(line, line), 1e-300), 0.0, 1.0)
    perpendicular = offset - fraction[..., None] * line
    error[inner] = np.maximum(error[inner], _dot(perpendicular, perpendicular).max(axis=1))
    return np.sqrt(error)


def _reparametrise(control: Float, path: Float, segments: _Segments, u: Float) -> Float:
    """Move each parameter u (n,) by a Newton step towards the curve's nearest point, if parameters stay ascending."""
    v, segment = 1.0 - u, segments.segment
    first = 3.0 * np.diff(control, axis=1)
    second = 2.0 * np.diff(first, axis=1)
    slope = np.einsum("nk,nkx->nx", np.stack([v * v, 2 * u * v, u * u], axis=1), first[segment])
    curvature = np.einsum("nk,nkx->nx", np.stack([v, u], axis=1), second[segment])
    gap = _evaluate_segments(control, segment, u) - path[segments.at]
    denominator = _dot(slope, slope) + _dot(gap, curvature)
    step = np.divide(_dot(gap, slope), denominator, out=np.zeros_like(u), where=np.abs(denominator) > 1e-30)
    moved = np.clip(u - step, 0.0, 1.0)
    moved[segments.begin] = 0.0
    moved[segments.begin + segments.last - segments.first] = 1.0
    rising = np.append(np.diff(moved) > 0.0, True) | (np.append(np.diff(segment), 1) != 0)
    return np.where(np.logical_and.reduceat(rising, segments.begin)[segment], moved, u)


Bool = NDArray[np.bool_]

PATH_TOLERANCE_M = 0.2e-3
"""Largest distance between the fitted and the drawn path [m]."""
PROGRESS_TOLERANCE_M = 0.5e-3
"""Largest distance along the path between keys and hand at any time [m]."""
FORCE_TOLERANCE_N = 0.02
"""Largest error of the force keys [N]."""
MIN_LENGTH_M = 0.5e-3
"""Shortest stroke [m]."""
REST_S = 0.15
"""Pause between two events above which the hand rested instead of moving slowly [s]; a busy window may take as long to
report a motion."""
LANDING_S = 0.05
"""Time over which the force fades where the hand leaves the surface and lands again [s]."""


@dataclass(frozen=True)
class PenSamples:
    """Samples of a pen or mouse.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times, never falling [s].
    point : ndarray, shape (n, 3)
        Positions [m]; arbitrary off the surface.
    pressure : ndarray, shape (n,)
        Pressure, 0 to 1.
    touching : ndarray of bool, shape (n,)
        True on the surface.
    """

    time: Float
    point: Float
    pressure: Float
    touching: Bool


@dataclass(frozen=True)
class PenStyle:
    """Settings for turning pen or mouse input into a stroke.

    Attributes
    ----------
    force_n : tuple of float
        Force of the lightest and the hardest touch of a pen [N].
    mouse_n : float
        Force of a mouse, which has no pressure [N].
    smoothing_s : float
        Standard deviation of the Gaussian that removes the tremor of hand and pixels [s].
    speed_m_s : float or None
        Constant speed that replaces the hand's own timing [m/s]; None keeps it.
    """

    force_n: tuple[float, float] = (0.1, 3.0)
    mouse_n: float = 1.0
    smoothing_s: float = 0.02
    speed_m_s: float | None = None


@dataclass(frozen=True)
class PenStroke:
    """A drawn stroke, fitted by a Bézier path and keyframes.

    Attributes
    ----------
    path : FittedBezier
        Bézier spline [m].
    length_m : float
        Its length [m].
    duration_s : float
        Duration of the touch [s].
    progress : Keyframes or None
        Keyframes of the fraction 0–1 of the path's length; None if the speed is constant.
    force : Keyframes
        Keyframes of the force [N].
    lifted : bool
        True if the hand left the surface in between.
    """

    path: FittedBezier
    length_m: float
    duration_s: float
    progress: Keyframes | None
    force: Keyframes
    lifted: bool


def fit_pen_stroke(
    samples: PenSamples, style: PenStyle, *, project_to_surface: Callable[[Float], Float] | None = None
) -> PenStroke:
    """Fit a stroke to the samples of a pen or mouse.

    Samples are interpolated to the action rate, smoothed while the hand is down, and projected back to the surface.
    Where the hand was off the surface the path is straight and the force 0. A pressure of 1 throughout is a mouse.

    Parameters
    ----------
    samples : PenSamples
        The samples.
    style : PenStyle
        Settings.
    project_to_surface : callable, optional
        Function from points (m, 3) to the nearest ones on the surface (m, 3).

    Returns
    -------
    PenStroke
        The stroke, within `PATH_TOLERANCE_M`, `PROGRESS_TOLERANCE_M` and `FORCE_TOLERANCE_N` of the samples.

    Raises
    ------
    StrokeError
        For broken samples, or a path that is too short.
    """
    samples = _trim_to_touching(samples)
    time, point, force, touching = _resample_to_grid(samples, style)
    point = _smooth_runs(point, touching, style.smoothing_s)
    if project_to_surface is not None:
        point[touching] = project_to_surface(point[touching])
    force = _smooth_runs(force[:, None], touching, style.smoothing_s)[:, 0] * _compute_landing_envelope(touching)
    moved = np.concatenate([[True], np.linalg.norm(np.diff(point, axis=0), axis=1) > 1e-7])
    if np.linalg.norm(np.diff(point, axis=0), axis=1).sum() < MIN_LENGTH_M:
        raise StrokeError(
            f"it is shorter than {MIN_LENGTH_M * 1e3:g} mm.", where="the drawn stroke", remedy="Press and drag further."
        )
    path = fit_bezier(point[moved], PATH_TOLERANCE_M)
    curve = build_arc_curve(make_bezier_curve(path.knot, path.left, path.right))
    progress_samples = _compute_progress(point, moved, path, curve)
    lifted = not bool(touching.all())
    if style.speed_m_s is None:
        progress = fit_keyframes(time, progress_samples, PROGRESS_TOLERANCE_M / curve.length, rising=True)
        force_keys = fit_keyframes(time, force, FORCE_TOLERANCE_N)
        return PenStroke(path, curve.length, float(time[-1]), progress, force_keys, lifted)
    steady_time = make_time_grid(
        compute_travel_time(curve.length, style.speed_m_s), ACTION_RATE_HZ, where="the drawn stroke"
    )
    steady_progress = make_motion_at_speed(steady_time, curve.length, style.speed_m_s).position / curve.length
    force_keys = fit_keyframes(steady_time, np.interp(steady_progress, progress_samples, force), FORCE_TOLERANCE_N)
    return PenStroke(path, curve.length, float(steady_time[-1]), None, force_keys, lifted)


def spread_times_evenly(count: int, before: float, now: float) -> Float:
    """Return times (count,) between `before` and `now` for events that arrived together at `now`.

    The window system passes on several pointer samples with one time; the hand is taken to move evenly between.
    """
    return np.asarray(before + (now - before) * np.arange(1, count + 1) / count)


def _trim_to_touching(samples: PenSamples) -> PenSamples:
    """Cut samples from the first to the last touching one, with times from 0."""
    where, remedy = "the drawn stroke", "Draw it again."
    for name, values in (("time", samples.time), ("place", samples.point), ("pressure", samples.pressure)):
        if not np.isfinite(values).all():
            raise StrokeError(f"a {name} is not a number.", where=where, remedy=remedy)
    down = np.flatnonzero(samples.touching)
    if len(down) == 0:
        raise StrokeError("it touches no surface.", where=where, remedy="Draw on a visible mesh.")
    used = slice(down[0], down[-1] + 1)
    time = samples.time[used] - samples.time[down[0]]
    if (np.diff(time) < 0.0).any():
        raise StrokeError("its times run backward.", where=where, remedy=remedy)
    if time[-1] > MAX_DURATION_S:
        raise StrokeError(
            f"it lasts {time[-1]:.0f} s.", where=where, remedy=f"Draw for less than {MAX_DURATION_S:g} s."
        )
    return PenSamples(time, samples.point[used], samples.pressure[used], samples.touching[used])


def _resample_to_grid(samples: PenSamples, style: PenStyle) -> tuple[Float, Float, Float, Bool]:
    """Resample to 200 Hz: time [s], point [m], force [N] and touching; a resting hand stays at its position."""
    down = samples.touching
    if (samples.pressure[down] == 1.0).all():
        force_n = np.full(len(down), style.mouse_n)
    else:
        lightest, hardest = style.force_n
        force_n = lightest + (hardest - lightest) * np.clip(samples.pressure, 0.0, 1.0)
    time, point = samples.time[down], samples.point[down]
    consecutive = np.diff(np.flatnonzero(down)) == 1
    rests = np.flatnonzero((np.diff(time) > REST_S) & consecutive)
    knot_time = np.insert(time, rests + 1, time[rests + 1] - 1.0 / ACTION_RATE_HZ)
    knot_index = np.insert(np.arange(len(time)), rests + 1, rests)
    grid = np.arange(max(2, round(samples.time[-1] * ACTION_RATE_HZ) + 1)) / ACTION_RATE_HZ
    points = np.stack([np.interp(grid, knot_time, point[knot_index, axis]) for axis in range(3)], axis=1)
    force = np.interp(grid, knot_time, force_n[down][knot_index])
    before = np.clip(np.searchsorted(samples.time, grid, side="right") - 1, 0, len(down) - 1)
    after = np.clip(before + (samples.time[before] < grid), 0, len(down) - 1)
    touching = down[before] & down[after]
    touching[[0, -1]] = True
    return grid, points, force, touching


def _smooth_runs(values: Float, touching: Bool, width_s: float) -> Float:
    """Smooth values (n, d) by a Gaussian of standard deviation `width_s` in each run of touching; a run's ends stay."""
    smooth = values.copy()
    reach = int(np.ceil(3.0 * width_s * ACTION_RATE_HZ))
    if reach == 0:
        return smooth
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (width_s * ACTION_RATE_HZ)) ** 2)
    kernel /= kernel.sum()
    borders = np.flatnonzero(np.diff(np.r_[False, touching, False].astype(np.int8)))
    for first, end in zip(borders[::2], borders[1::2], strict=True):
        run = values[first:end]
        pad = min(reach, len(run) - 1)
        # The run is mirrored at its end points, so that these stay and a straight path stays straight.
        mirrored_start, mirrored_end = 2.0 * run[:1] - run[pad:0:-1], 2.0 * run[-1:] - run[-2 : -2 - pad : -1]
        start_padding = np.repeat(mirrored_start[:1] if pad else run[:1], reach - pad, axis=0)
        end_padding = np.repeat(mirrored_end[-1:] if pad else run[-1:], reach - pad, axis=0)
        padded = np.concatenate([start_padding, mirrored_start, run, mirrored_end, end_padding])
        for axis in range(values.shape[1]):
            smooth[first:end, axis] = np.convolve(padded[:, axis], kernel, mode="valid")
    return smooth


def _compute_landing_envelope(touching: Bool) -> Float:
    """Return a factor (n,) on the force: 0 off the surface, rising and falling within `LANDING_S` on it, else 1."""
    off = np.flatnonzero(~touching)
    if len(off) == 0:
        return np.ones(len(touching))
    at = np.arange(len(touching))
    next_off = np.searchsorted(off, at)
    gap = np.minimum(
        np.abs(off[np.minimum(next_off, len(off) - 1)] - at), np.abs(off[np.maximum(next_off - 1, 0)] - at)
    )
    fraction = np.clip(gap / (LANDING_S * ACTION_RATE_HZ), 0.0, 1.0)
    return np.asarray(fraction * fraction * (3.0 - 2.0 * fraction))


def _compute_progress(point: Float, moved: Bool, path: FittedBezier, curve: ArcCurve) -> Float:
    """Return each sample's fraction (n,) of the fitted length; inside a segment it follows the length drawn."""
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(point, axis=0), axis=1))])
    knots = np.flatnonzero(moved)[path.index]
    segments = np.arange(curve.curve.segment_count)
    ends = curve.station[np.searchsorted(curve.segment, segments, side="right")]
    progress = np.interp(station, station[knots], np.concatenate([[0.0], ends / curve.length]))
    return np.maximum.accumulate(progress)
