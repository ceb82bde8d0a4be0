"""Evaluate the field F_Θ at only as many samples of a stroke as a given error tolerance needs.

Amplitudes follow the action, which is slow most of the time and turns within milliseconds where a hand lands or
reverses. They are evaluated on a coarse grid of samples, then in the middle between neighbours; where the middle is off
the straight line, further, the largest errors first, until the power that is missed over the whole stroke is within the
tolerance. `find_breakpoints` adds the samples where the action itself bends, since a short touch, a stop or a push
shorter than the grid's interval would be missed otherwise. Exact evaluation, which the tolerance is relative to, takes
every sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..kernel.compiled_carriers import find_bends
from ..kernel.compiled_field import blend_rows
from ..kernel.loader import load_kernel
from .field import Emission, FieldConfig
from .linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S
from .render_weights import render_weights
from .stroke import SAMPLES_PER_STATE

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Samples = NDArray[np.int64]

MAX_INTERVAL, MIN_INTERVAL = 800, 2
"""Largest and smallest interval between evaluations [samples]: 80 ms and 0.2 ms."""
TOLERANCE_SAFETY = 0.42
"""Fraction of the requested tolerance that is aimed at.

The error of an interval is judged by its middle alone; and where the error is in few bands for a few milliseconds, one
realisation of their noise may be far louder than its expectation. docs/benchmarks.md has the results over the library.
"""
UNREFINED_ERROR_SHARE = 0.8
"""Fraction of the error budget that is left to intervals which are not halved again, since halves have errors too.

With all of it a ten-second stroke took five to eight rounds, the last of a few states each; with this, three or four.
"""
_PARABOLA_MEAN_SQUARE = 8.0 / 15.0
"""Mean square of a parabola's distance from its chord, over the square in the middle."""
BATCH_SAMPLES = 512
"""Samples that are evaluated at once."""
INITIAL_CAPACITY = 1024
"""Evaluations that memory is reserved for at the start; unused memory costs nothing."""
MAX_EVALUATIONS = 40_000
"""Largest number of evaluations (0.8 GB of intermediate results); a 200 Hz action needs no more."""


@dataclass(frozen=True)
class SampledEmission:
    """Field output (amplitudes α, densities σΔt) at m chosen samples, linear in time between them.

    at: (m,) ascending samples. alpha: (m, K) per carrier. sigma_dt: (m, N) per past state. residual_power: expected
    power of the interpolation error over that of the signal, from the errors in the intervals' middles over
    TOLERANCE_SAFETY². It is within the square of the tolerance unless MAX_EVALUATIONS did not suffice.
    """

    at: Samples
    alpha: Float32
    sigma_dt: Float
    residual_power: float

    def locate(self, sample: Samples) -> tuple[Samples, Float]:
        """Return per sample the row of the evaluation before it, and the fraction of the way to the next, 0 … 1."""
        row = np.clip(np.searchsorted(self.at, sample, side="right") - 1, 0, len(self.at) - 2)
        begin = self.at[row]
        return row, np.clip((sample - begin) / (self.at[row + 1] - begin), 0.0, 1.0)


EvaluateAt = Callable[[Samples], Emission]
"""Function from samples of the model rate (m,), BATCH_SAMPLES at most, to their emissions; prepare.make_evaluate_at."""


def interpolate_rows(values: Float32, row: Samples, share: Float, factor: Float) -> Float32:
    """Sum interpolated rows of a table: (n, K) Σ_t factor · ((1 − share) · values[row] + share · values[row + 1]).

    values: (m, K) table. row, share, factor: (n, terms) row before, fraction of the way to the next, and weight of each
    term.
    """
    compiled = load_kernel()
    if compiled is not None:
        return blend_rows(compiled, np.ascontiguousarray(values), row, share, np.ascontiguousarray(factor))
    out = np.zeros((len(row), values.shape[1]))
    for one, part, times in zip(row.T, share.T, factor.T, strict=True):
        far = (times * part)[:, None]
        out += (times[:, None] - far) * values[one] + far * values[one + 1]
    return out.astype(np.float32)


def sample_adaptively(
    evaluate_at: EvaluateAt, count: int, tolerance: float, breakpoints: Samples | None = None
) -> SampledEmission:
    """Evaluate a field with one head at few samples of 0 … count, and at more where linear interpolation is off.

    Parameters
    ----------
    evaluate_at
        Function (samples at 10 kHz) → the field's output there.
    count
        Number of samples of the stroke.
    tolerance
        Largest RMS of the interpolation error over the RMS of the stroke; 0 for the smallest intervals.
    breakpoints
        Samples that are evaluated in any case.

    Returns
    -------
    SampledEmission
        At most MAX_EVALUATIONS evaluations; residual_power says whether the tolerance is kept.
    """
    fixed = np.arange(0) if breakpoints is None else breakpoints[breakpoints < count]
    grid = np.unique(np.concatenate([np.arange(0, count, MAX_INTERVAL), fixed, [count]]))
    pending = np.stack([np.arange(len(grid) - 1), np.arange(1, len(grid))], axis=1)
    pending = pending[np.diff(grid) > MIN_INTERVAL]
    evaluated, before = _Evaluations(evaluate_at), np.zeros(len(pending))
    # Every middle of the grid is needed in any case, so grid and middles are evaluated together.
    evaluated.add(np.concatenate([grid, grid[pending].sum(axis=1) // 2]))
    middle = slice(len(grid), evaluated.count)
    settled, power, claimed = np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros(0)
    while True:
        if len(pending):
            halves, found = evaluated.bisect(pending, middle)
            settled, power = np.concatenate([settled, halves]), np.concatenate([power, np.tile(found, 2)])
            claimed = np.concatenate([claimed, np.tile(_predict_child_error(found, before), 2)])
        total = evaluated.total_power()
        left_out = claimed * evaluated.lengths(settled) * _PARABOLA_MEAN_SQUARE
        order = np.argsort(left_out)
        so_far = np.cumsum(left_out[order])
        missed = float(so_far[-1] / total) / TOLERANCE_SAFETY**2 if len(so_far) and total > 0.0 else 0.0
        limit = (TOLERANCE_SAFETY * tolerance) ** 2 * total
        if len(so_far) == 0 or so_far[-1] <= limit:
            return evaluated.to_sampled_emission(missed)
        worst = order[np.searchsorted(so_far, UNREFINED_ERROR_SHARE * limit, side="right") :]
        worst = worst[evaluated.lengths(settled[worst]) > MIN_INTERVAL]
        worst = worst[len(worst) - min(len(worst), max(MAX_EVALUATIONS - evaluated.count, 0) // 2) :]
        if len(worst) == 0:
            return evaluated.to_sampled_emission(missed)
        worst.sort()
        pending, before = settled[worst], power[worst]
        middle = evaluated.add(evaluated.middles(pending))
        settled, power, claimed = np.delete(settled, worst, axis=0), np.delete(power, worst), np.delete(claimed, worst)


class _Evaluations:
    """Evaluations in the order they were made.

    An interval between two of them is given by their row numbers: intervals is (p, 2).
    """

    def __init__(self, evaluate_at: EvaluateAt) -> None:
        self.count = 0
        self._evaluate_at = evaluate_at
        self._at = np.zeros(0, dtype=np.int64)
        self._alpha = np.zeros((0, 0), dtype=np.float32)
        self._sigma_dt, self._power = np.zeros((0, 0)), np.zeros(0)

    def lengths(self, intervals: Samples) -> Samples:
        """Return the lengths (p,) [samples] of intervals (p, 2)."""
        return np.asarray(self._at[intervals[:, 1]] - self._at[intervals[:, 0]])

    def middles(self, intervals: Samples) -> Samples:
        """Return the sample (p,) in the middle of each of the intervals (p, 2)."""
        return np.asarray(self._at[intervals].sum(axis=1) // 2)

    def bisect(self, intervals: Samples, rows: slice) -> tuple[Samples, Float]:
        """Return the halves (2p, 2) of the intervals, and the power (p,) of the interpolation error in each middle.

        rows: rows of the evaluations in the middles, in the order of the intervals.
        """
        low, high = intervals.T
        share = ((self._at[rows] - self._at[low]) / (self._at[high] - self._at[low])).astype(np.float32)[:, None]
        off, thinner = (
            each[rows] - (each[low] + share * (each[high] - each[low])) for each in (self._alpha, self._sigma_dt)
        )
        # A weight changes at most as much as its density, so an error of density is one of the whole amplitude.
        missed = _sum_squares(off) + self._power[rows] * _sum_squares(thinner)
        between = np.arange(rows.start, rows.stop)
        return np.concatenate([np.stack([low, between], 1), np.stack([between, high], 1)]), missed

    def total_power(self) -> float:
        """Return the power of the interpolated amplitudes, summed over all samples."""
        order = np.argsort(self._at[: self.count])
        power, at = self._power[order], self._at[order]
        return float(np.sum(0.5 * (power[1:] + power[:-1]) * np.diff(at)))

    def to_sampled_emission(self, residual_power: float) -> SampledEmission:
        """Return the evaluations sorted by sample, as a SampledEmission."""
        order = np.argsort(self._at[: self.count])
        return SampledEmission(self._at[order], self._alpha[order], self._sigma_dt[order], residual_power)

    def add(self, at: Samples) -> slice:
        """Evaluate the field at these samples, append the results, and return their rows."""
        begin = self.count
        for low in range(0, len(at), BATCH_SAMPLES):
            batch = at[low : low + BATCH_SAMPLES]
            emission, rows = self._evaluate_at(batch), slice(self.count, self.count + len(batch))
            alpha = emission.alpha[:, 0].astype(np.float32)
            self._at = _append_rows(self._at, rows, batch)
            self._power = _append_rows(self._power, rows, _sum_squares(alpha))
            self._alpha = _append_rows(self._alpha, rows, alpha)
            self._sigma_dt = _append_rows(self._sigma_dt, rows, emission.sigma_dt)
            self.count = rows.stop
        return slice(begin, self.count)


def _append_rows(array: NDArray[Any], rows: slice, new: NDArray[Any]) -> NDArray[Any]:
    """Return the array with new values in these rows, which follow the last; a full array grows to twice its size."""
    if rows.stop > len(array):
        grown = np.empty((max(2 * len(array), rows.stop, INITIAL_CAPACITY), *new.shape[1:]), dtype=new.dtype)
        grown[: rows.start] = array[: rows.start] if rows.start else 0.0
        array = grown
    array[rows] = new
    return array


def _sum_squares(values: NDArray[np.floating[Any]]) -> Float:
    """Return the sums of squares (n,) of (n, K)."""
    return np.asarray(np.einsum("nk,nk->n", values, values))


def _predict_child_error(found: Float, before: Float) -> Float:
    """Predict the interpolation error in the middle of each half of p intervals, as power (p,).

    found: (p,) error in the interval's own middle. before: (p,) error in the middle of the interval it is a half of, 0
    if there was none. A parabola leaves a 16th to each half, a kink or a jump all of it to one half, counted as half to
    each. If the last halving left at least half, the error counts as one of these, otherwise a quarter is predicted.
    """
    share: Float = 0.5 * np.clip(found / np.maximum(before, 1e-300), 0.5, 1.0)
    return found * share


def accumulate_samples(config: FieldConfig, sampled: SampledEmission, count: int) -> tuple[Samples, Float32]:
    """Return knots (m,), samples in 0 … count, and the amplitudes (m, K) there, weighted over the past states.

    Does what field.accumulate does, on field outputs that are interpolated between the evaluated samples.
    """
    lag = config.stride * SAMPLES_PER_STATE
    # A bend occurs again one past state later; older states have only a hundredth of the weight.
    at = np.unique(np.concatenate([sampled.at, np.minimum(sampled.at + lag, count)]))
    row, share = sampled.locate(at[:, None] - lag * np.arange(config.states))
    density, state = sampled.sigma_dt, np.arange(config.states)
    before = density[row, state]
    weights = render_weights(before + share * (density[row + 1, state] - before))
    return at, interpolate_rows(sampled.alpha, row, share, weights * (at[:, None] >= lag * state))


MAX_DEVIATION = 0.25
"""Largest deviation of log speed, log force and direction (radians) from a straight line between breakpoints.

F_Θ changes with them about one to one, and the effect of such a bend shows in the middle between two breakpoints.
"""


def find_breakpoints(action: Action, token_index: NDArray[np.int32]) -> Samples:
    """Return the samples (10 kHz, ascending) at which an action bends or changes contact or material.

    Between two of them log speed, log force and direction are straight lines within MAX_DEVIATION, on one material, and
    throughout in contact or in the air.
    """
    force = np.where(action.contact, np.maximum(action.force, FORCE_FLOOR_N), FORCE_FLOOR_N)
    speed = np.maximum(action.speed, SPEED_FLOOR_M_S)
    course = np.column_stack([np.log(speed), np.log(force), action.direction])
    changes = np.flatnonzero((np.diff(token_index) != 0) | (np.diff(action.contact.astype(np.int8)) != 0))
    fixed = np.unique(np.concatenate([[0, len(speed) - 1], changes, changes + 1]))
    compiled = load_kernel()
    found = _find_bends_numpy(course, fixed) if compiled is None else find_bends(compiled, course, fixed, MAX_DEVIATION)
    states: Samples = SAMPLES_PER_STATE * found.astype(np.int64)
    breakpoints: Samples = np.unique(
        np.concatenate([states, _find_bends_between_states(speed), _find_bends_between_states(force)])
    )
    return breakpoints


def _find_bends_numpy(course: Float, fixed: Samples) -> Samples:
    """Return the rows of a course (n, channels) between which it is straight within MAX_DEVIATION, in numpy.

    fixed: rows that are always included. Same result as compiled_carriers.find_bends.
    """
    pending = list(zip(fixed[:-1].tolist(), fixed[1:].tolist(), strict=True))
    found = set(fixed.tolist())
    while pending:
        low, high = pending.pop()
        if high - low < 2:
            continue
        share = np.arange(1, high - low)[:, None] / (high - low)
        off = np.abs(course[low + 1 : high] - (course[low] + share * (course[high] - course[low]))).max(axis=1)
        worst = int(np.argmax(off))
        if off[worst] > MAX_DEVIATION:
            found.add(low + 1 + worst)
            pending += [(low, low + 1 + worst), (low + 1 + worst, high)]
    return np.array(sorted(found), dtype=np.int64)


def _find_bends_between_states(value: Float) -> Samples:
    """Return samples where the logarithm of a value > 0, linear between states, bends by more than MAX_DEVIATION.

    That is a stop or a start within one state. The bend is largest where the value is the logarithmic mean of its ends.
    """
    rise, growth = np.diff(value), np.diff(np.log(value))
    row = np.flatnonzero(np.abs(growth) > 1.0)
    mean = rise[row] / growth[row]
    share = (mean - value[row]) / rise[row]
    bent = np.log(mean / value[row]) - share * growth[row] > MAX_DEVIATION
    at: Samples = SAMPLES_PER_STATE * row[bent] + np.rint(SAMPLES_PER_STATE * share[bent]).astype(np.int64)
    return at
