"""What a mouse or pen drew on a surface → a smooth path, and few keys of progress and force at the time it took."""

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
"""Between the fitted and the drawn path, anywhere."""
PROGRESS_TOLERANCE_M = 0.5e-3
"""Along the path, between where the keys and where the hand was at any time."""
FORCE_TOLERANCE_N = 0.02
MIN_LENGTH_M = 0.5e-3
REST_S = 0.15
"""A pause longer than this between two events is a hand that rests and then goes on, not one that creeps; a busy
window may take as long to tell of a move."""
LANDING_S = 0.05
"""How long the force takes to come and go where the hand leaves the surface on its way and lands again."""


@dataclass(frozen=True)
class PenSamples:
    """time: (n,) s, never falling. point: (n, 3) m; where the hand is off the surface, anything. pressure: (n,) 0–1.
    touching: (n,) bool, on the surface."""

    time: Float
    point: Float
    pressure: Float
    touching: Bool


@dataclass(frozen=True)
class PenStyle:
    """force_n: lightest and hardest touch of a pen [N]. mouse_n: without pressure. smoothing_s: width (standard
    deviation) of the Gaussian that takes the tremble of hand and pixels away. speed_m_s: constant speed that replaces
    the hand's own timing; None keeps it."""

    force_n: tuple[float, float] = (0.1, 3.0)
    mouse_n: float = 1.0
    smoothing_s: float = 0.02
    speed_m_s: float | None = None


@dataclass(frozen=True)
class PenStroke:
    """path: Bézier spline [m]. length_m: of it. duration_s: of the touch. progress: 0–1 keys, None where the speed is
    constant. force: keys [N]. lifted: whether the hand left the surface on its way."""

    path: FittedBezier
    length_m: float
    duration_s: float
    progress: Keyframes | None
    force: Keyframes
    lifted: bool


def fit_pen_stroke(
    samples: PenSamples, style: PenStyle, *, project_to_surface: Callable[[Float], Float] | None = None
) -> PenStroke:
    """The stroke that a hand drew.

    The samples are laid on an even grid at the action rate, smoothed while the hand is down, and put back on the
    surface by to_surface ((m, 3) → (m, 3)); the path through them is fitted within PATH_TOLERANCE_M, progress within
    PROGRESS_TOLERANCE_M along it, force within FORCE_TOLERANCE_N. Where the hand was off the surface the path runs
    straight and the force is 0. A pressure of 1 throughout is a mouse. Raises StrokeError for broken samples, and for
    a path too short to be a stroke.
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
    place = _compute_progress(point, moved, path, curve)
    lifted = not bool(touching.all())
    if style.speed_m_s is None:
        progress = fit_keyframes(time, place, PROGRESS_TOLERANCE_M / curve.length, rising=True)
        keyed = fit_keyframes(time, force, FORCE_TOLERANCE_N)
        return PenStroke(path, curve.length, float(time[-1]), progress, keyed, lifted)
    steady = make_time_grid(
        compute_travel_time(curve.length, style.speed_m_s), ACTION_RATE_HZ, where="the drawn stroke"
    )
    reached = make_motion_at_speed(steady, curve.length, style.speed_m_s).position / curve.length
    keyed = fit_keyframes(steady, np.interp(reached, place, force), FORCE_TOLERANCE_N)
    return PenStroke(path, curve.length, float(steady[-1]), None, keyed, lifted)


def spread_times_evenly(count: int, before: float, now: float) -> Float:
    """(count,) times of events that reached us together at `now`, the last of them then: their own times are lost, and
    a hand moves evenly between two events of the window system."""
    return np.asarray(before + (now - before) * np.arange(1, count + 1) / count)


def _trim_to_touching(samples: PenSamples) -> PenSamples:
    """From the first to the last touching sample, from time 0."""
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
    """Time, point, force [N] and touching at the action rate; a resting hand stays where it was."""
    down = samples.touching
    if (samples.pressure[down] == 1.0).all():
        newton = np.full(len(down), style.mouse_n)
    else:
        lightest, hardest = style.force_n
        newton = lightest + (hardest - lightest) * np.clip(samples.pressure, 0.0, 1.0)
    time, point = samples.time[down], samples.point[down]
    both = np.diff(np.flatnonzero(down)) == 1
    rests = np.flatnonzero((np.diff(time) > REST_S) & both)
    known = np.insert(time, rests + 1, time[rests + 1] - 1.0 / ACTION_RATE_HZ)
    stays = np.insert(np.arange(len(time)), rests + 1, rests)
    grid = np.arange(max(2, round(samples.time[-1] * ACTION_RATE_HZ) + 1)) / ACTION_RATE_HZ
    points = np.stack([np.interp(grid, known, point[stays, axis]) for axis in range(3)], axis=1)
    force = np.interp(grid, known, newton[down][stays])
    before = np.clip(np.searchsorted(samples.time, grid, side="right") - 1, 0, len(down) - 1)
    after = np.clip(before + (samples.time[before] < grid), 0, len(down) - 1)
    touching = down[before] & down[after]
    touching[[0, -1]] = True
    return grid, points, force, touching


def _smooth_runs(values: Float, touching: Bool, width_s: float) -> Float:
    """Gaussian smoothing of (n, d) inside each run of touching; a run's ends stay where they are."""
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
        # Mirrored through its ends, so that these stay and a straight way stays straight.
        ahead, behind = 2.0 * run[:1] - run[pad:0:-1], 2.0 * run[-1:] - run[-2 : -2 - pad : -1]
        short = np.repeat(ahead[:1] if pad else run[:1], reach - pad, axis=0)
        late = np.repeat(behind[-1:] if pad else run[-1:], reach - pad, axis=0)
        whole = np.concatenate([short, ahead, run, behind, late])
        for axis in range(values.shape[1]):
            smooth[first:end, axis] = np.convolve(whole[:, axis], kernel, mode="valid")
    return smooth


def _compute_landing_envelope(touching: Bool) -> Float:
    """(n,) 0–1: 0 where the hand is off the surface, eased over LAND_S before and after."""
    off = np.flatnonzero(~touching)
    if len(off) == 0:
        return np.ones(len(touching))
    at = np.arange(len(touching))
    beside = np.searchsorted(off, at)
    gap = np.minimum(np.abs(off[np.minimum(beside, len(off) - 1)] - at), np.abs(off[np.maximum(beside - 1, 0)] - at))
    share = np.clip(gap / (LANDING_S * ACTION_RATE_HZ), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _compute_progress(point: Float, moved: Bool, path: FittedBezier, curve: ArcCurve) -> Float:
    """Share of the fitted length at each sample (n,): inside a piece, as the drawn way goes."""
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(point, axis=0), axis=1))])
    knots = np.flatnonzero(moved)[path.index]
    pieces = np.arange(curve.curve.segment_count)
    ends = curve.station[np.searchsorted(curve.segment, pieces, side="right")]
    share = np.interp(station, station[knots], np.concatenate([[0.0], ends / curve.length]))
    return np.maximum.accumulate(share)
