"""Strokes drawn with mouse or pen on a surface: from samples to a smooth path with keyframes of progress and force."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import StrokeError
from .action import ACTION_RATE_HZ
from .curves import ArcCurve, build_arc_curve, make_bezier_curve
from .fit_bezier import FittedBezier, fit_bezier
from .keyframes import Keyframes, fit_keyframes
from .motion_profile import MAX_DURATION_S, compute_travel_time, make_motion_at_speed, make_time_grid

Float = NDArray[np.float64]
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
