"""Evaluate the field F_Θ at only as many samples of a stroke as a given error tolerance needs.

Amplitudes follow the action, which is slow most of the time and turns within milliseconds where a hand lands or
reverses. They are evaluated on a coarse grid of samples, then in the middle between neighbours; where the middle is off
the straight line, the halves are evaluated in their middles, and so on, until what is missed there is within the
tolerance of the amplitudes around. `find_breakpoints` adds the samples where the action itself bends, since a short
touch, a stop or a push shorter than the grid's interval would be missed otherwise.

A stroke is divided into passages of PASSAGE_STATES. What is evaluated in a passage depends on the action there alone,
so that a chunk of a stroke, and a stroke of which a force key was moved, are evaluated where the whole stroke is.
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

DEFAULT_TOLERANCE = 0.01
"""Tolerance where none is given: −40 dB, far below the 0.7 dB by which the field itself is off."""
PASSAGE_STATES = 128
"""States (200 Hz) of a passage: 0.64 s."""
PASSAGE_SAMPLES = PASSAGE_STATES * SAMPLES_PER_STATE
"""Samples of a passage."""
MAX_INTERVAL, MIN_INTERVAL = 400, 2
"""Largest and smallest interval between evaluations [samples]: 40 ms and 0.2 ms."""
TOLERANCE_SAFETY = 0.38
"""Fraction of the requested tolerance that is aimed at.

The error of an interval is predicted from its middle alone; and where the error is in few bands for a few milliseconds,
one realisation of their noise may be far louder than its expectation. docs/benchmarks.md has the results over the
library.
"""
_PARABOLA_MEAN_SQUARE = 8.0 / 15.0
"""Mean square of a parabola's distance from its chord, over the square in the middle."""
_HALF_SHARE = 1.0 / 8.0
"""Power that is predicted in the middle of each half, over that in the middle. A parabola leaves a 16th; a kink up to a
half, but to intervals that are soon too short to matter."""
BATCH_SAMPLES = 512
"""Samples that are evaluated at once."""
MAX_PASSAGE_EVALUATIONS = 1280
"""Largest number of evaluations in a passage: one every 0.5 ms. A 200 Hz action needs no more."""


@dataclass(frozen=True)
class SampledEmission:
    """Field output (amplitudes α, densities σΔt) at m chosen samples, linear in time between them.

    at: (m,) ascending samples. alpha: (m, K) per carrier. sigma_dt: (m, N) per past state. residual_power: expected
    power of the interpolation error over that of the signal, from the errors in the intervals' middles over
    TOLERANCE_SAFETY². It is within the square of the tolerance unless MIN_INTERVAL or MAX_PASSAGE_EVALUATIONS did not
    suffice.
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


@dataclass(frozen=True)
class KnownPassages:
    """Passages of a stroke in which an earlier one, of the same length, was evaluated under the same action.

    sampled: of the earlier stroke. is_known: (passages,) True for these passages; see count_passages.
    """

    sampled: SampledEmission
    is_known: NDArray[np.bool_]


def count_passages(count: int) -> int:
    """Return the number of passages of a stroke of samples 0 … count; the last one may hold the last sample alone."""
    return count // PASSAGE_SAMPLES + 1


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
    evaluate_at: EvaluateAt,
    count: int,
    tolerance: float,
    breakpoints: Samples | None = None,
    *,
    known: KnownPassages | None = None,
    by_passage: bool = False,
) -> SampledEmission:
    """Evaluate a field with one head at few samples of 0 … count, and at more where linear interpolation is off.

    Parameters
    ----------
    evaluate_at
        Function (samples at 10 kHz) → the field's output there.
    count
        Number of samples of the stroke.
    tolerance
        Largest RMS of the interpolation error over the RMS of each passage; 0 for the smallest intervals.
    breakpoints
        Samples that are evaluated in any case.
    known
        Passages that are taken from an earlier stroke.
    by_passage
        True to evaluate each passage by itself, where a result depends on what is evaluated with it.

    Returns
    -------
    SampledEmission
        residual_power says whether the tolerance is kept; it counts the passages that are not known.
    """
    is_new = np.ones(count_passages(count), dtype=bool) if known is None else ~known.is_known
    fixed = np.arange(0) if breakpoints is None else breakpoints[breakpoints < count]
    grid = _divide_gaps(np.unique(np.concatenate([np.arange(0, count, PASSAGE_SAMPLES), fixed, [count]])))
    bounds = np.stack([grid[:-1], grid[1:]], axis=1)
    bounds = bounds[(np.diff(grid) > MIN_INTERVAL) & is_new[grid[:-1] // PASSAGE_SAMPLES]]
    # Every middle of the grid is needed in any case, so grid and middles are evaluated together.
    first = np.concatenate([grid[is_new[grid // PASSAGE_SAMPLES]], bounds.sum(axis=1) // 2])
    evaluations = _Evaluations(evaluate_at, by_passage, known)
    evaluations.add(np.sort(first))
    settled = np.zeros(len(is_new))
    while len(bounds):
        error, length = evaluations.measure_middles(bounds), np.diff(bounds)[:, 0]
        passage = bounds[:, 0] // PASSAGE_SAMPLES
        missed = error * length * (_HALF_SHARE * _PARABOLA_MEAN_SQUARE)
        energy, intervals = evaluations.sum_passages(len(is_new))
        allowed = (TOLERANCE_SAFETY * tolerance) ** 2 * energy
        is_over = settled + np.bincount(passage, missed, len(is_new)) > allowed
        # An evaluation is worth most where most energy is missed, however long the interval.
        is_large = missed > (allowed / np.maximum(intervals, 1))[passage]
        chosen = is_over[passage] & is_large & (length > 2 * MIN_INTERVAL)
        chosen = _limit_evaluations(chosen, missed, passage, MAX_PASSAGE_EVALUATIONS - intervals)
        settled += np.bincount(passage[~chosen], missed[~chosen], len(is_new))
        halved, middle = bounds[chosen], bounds[chosen].sum(axis=1) // 2
        bounds = np.stack([halved[:, 0], middle, middle, halved[:, 1]], axis=1).reshape(-1, 2)
        evaluations.add(bounds.sum(axis=1) // 2)
    total = evaluations.sum_passages(len(is_new))[0].sum()
    residual = settled.sum() / total / TOLERANCE_SAFETY**2 if total > 0.0 else 0.0
    return SampledEmission(evaluations.at, evaluations.alpha, evaluations.sigma_dt, float(residual))


def _divide_gaps(fixed: Samples) -> Samples:
    """Return fixed samples (f,) and those between them (m,), which divide gaps into equal parts up to MAX_INTERVAL."""
    gap = np.diff(fixed)
    parts = -(-gap // MAX_INTERVAL)
    index = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    grid = np.repeat(fixed[:-1], parts) + index * np.repeat(gap, parts) // np.repeat(parts, parts)
    return np.append(grid, fixed[-1])


def _limit_evaluations(chosen: NDArray[np.bool_], missed: Float, passage: Samples, room: Samples) -> NDArray[np.bool_]:
    """Return the chosen intervals (p,) that are still halved where a passage has little room for evaluations.

    missed: (p,) error energy; the largest come first. passage: (p,) of each interval. room: (passages,) evaluations
    that may be added, two for each halved interval.
    """
    for full in np.flatnonzero(2 * np.bincount(passage[chosen], minlength=len(room)) > room):
        rows = np.flatnonzero(chosen & (passage == full))
        chosen[rows[np.argsort(-missed[rows], kind="stable")[max(room[full], 0) // 2 :]]] = False
    return chosen


class _Evaluations:
    """Evaluations of a field in the order of their samples.

    at: (m,) samples. alpha: (m, K). sigma_dt: (m, N).
    """

    def __init__(self, evaluate_at: EvaluateAt, by_passage: bool, known: KnownPassages | None) -> None:
        self._evaluate_at, self._by_passage = evaluate_at, by_passage
        self.at = np.zeros(0, dtype=np.int64)
        self.alpha = np.zeros((0, 0), dtype=np.float32)
        self.sigma_dt = np.zeros((0, 0))
        self._power = np.zeros(0)
        if known is not None:
            rows, sampled = known.is_known[known.sampled.at // PASSAGE_SAMPLES], known.sampled
            self._insert(sampled.at[rows], sampled.alpha[rows], sampled.sigma_dt[rows])

    def add(self, at: Samples) -> None:
        """Evaluate the field at these ascending samples, which were not evaluated before."""
        cuts = np.arange(0)
        if self._by_passage:
            cuts = np.flatnonzero(np.diff(at // PASSAGE_SAMPLES)) + 1
        parts = [
            group[low : low + BATCH_SAMPLES]
            for group in np.split(at, cuts)
            for low in range(0, len(group), BATCH_SAMPLES)
        ]
        if parts:
            emissions = [self._evaluate_at(part) for part in parts]
            alpha = np.concatenate([each.alpha[:, 0].astype(np.float32) for each in emissions])
            self._insert(at, alpha, np.concatenate([each.sigma_dt for each in emissions]))

    def _insert(self, at: Samples, alpha: Float32, sigma_dt: Float) -> None:
        rows = np.searchsorted(self.at, at)
        self.alpha = _insert_rows(self.alpha, rows, alpha)
        self.sigma_dt = _insert_rows(self.sigma_dt, rows, sigma_dt)
        self._power = _insert_rows(self._power, rows, _sum_squares(alpha))
        self.at = _insert_rows(self.at, rows, at)

    def measure_middles(self, bounds: Samples) -> Float:
        """Return the power (p,) of the interpolation error in the middles of intervals with the ends (p, 2)."""
        low, middle, high = np.searchsorted(self.at, [bounds[:, 0], bounds.sum(axis=1) // 2, bounds[:, 1]])
        share = ((self.at[middle] - self.at[low]) / (self.at[high] - self.at[low])).astype(np.float32)[:, None]
        off, thinner = (
            each[middle] - (each[low] + share * (each[high] - each[low])) for each in (self.alpha, self.sigma_dt)
        )
        # A weight changes at most as much as its density, so an error of density is one of the whole amplitude.
        return np.asarray(_sum_squares(off) + self._power[middle] * _sum_squares(thinner))

    def sum_passages(self, passages: int) -> tuple[Float, Samples]:
        """Return the power of the interpolated amplitudes summed over the samples of each passage, and its intervals.

        Each passage is summed by itself, so that its last bit does not depend on others.
        """
        passage = self.at[:-1] // PASSAGE_SAMPLES
        energy = np.bincount(passage, 0.5 * (self._power[1:] + self._power[:-1]) * np.diff(self.at), passages)
        return np.asarray(energy, dtype=np.float64), np.bincount(passage, minlength=passages).astype(np.int64)


def _insert_rows(array: NDArray[Any], rows: Samples, new: NDArray[Any]) -> NDArray[Any]:
    """Return the array with new values before these rows."""
    return np.insert(array, rows, new, axis=0) if len(array) else new


def _sum_squares(values: NDArray[np.floating[Any]]) -> Float:
    """Return the sums of squares (n,) of (n, K)."""
    return np.asarray(np.einsum("nk,nk->n", values, values))


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


MAX_DEVIATION = 0.005
"""Largest deviation of log speed and log force from a straight line between breakpoints.

F_Θ changes with them by up to twice as much. A larger bend would show in the middle between two breakpoints, but for a
tremor whose waves are as long as the intervals; and where a hand turns over a regular surface, whose lines then pass
from band to band.
"""
DIRECTION_WEIGHT = 0.5
"""Weight of a deviation of the direction [rad] beside one of log speed: with MAX_DEVIATION, a breakpoint every 0.28 rad
of an even turn."""


def find_breakpoints(action: Action, token_index: NDArray[np.int32]) -> Samples:
    """Return the samples (10 kHz, ascending) at which an action bends or changes contact or material.

    Between two of them log speed, log force and direction are straight lines within MAX_DEVIATION, on one material, and
    throughout in contact or in the air.
    """
    force = np.where(action.contact, np.maximum(action.force, FORCE_FLOOR_N), FORCE_FLOOR_N)
    speed = np.maximum(action.speed, SPEED_FLOOR_M_S)
    course = np.column_stack([np.log(speed), np.log(force), DIRECTION_WEIGHT * action.direction])
    changes = np.flatnonzero((np.diff(token_index) != 0) | (np.diff(action.contact.astype(np.int8)) != 0))
    passages = np.arange(0, len(speed), PASSAGE_STATES)
    fixed = np.unique(np.concatenate([passages, [len(speed) - 1], changes, changes + 1]))
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
