"""What an even grid can hold of a table of any grid: no vibration between its rows folds to a tone."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Float = NDArray[np.float64]

CELLS_PER_SAMPLE = 16
"""Averages per sample of the grid that the Gaussian is summed over. An average knows every row in its cell, so neither
time nor memory follows the finest step of a table."""
_SUPPORT_SIGMAS = 4.0
_STEP_NEIGHBOURHOOD = 2.0
"""Samples of the grid on either side of one that say how fine the table is there: about as far as the Gaussian."""
_SUPPORT_SAMPLES = 4.0
"""Samples of the grid that no average or Gaussian looks beyond."""
_SAMPLES_PER_CHUNK = 1024


def resample_band_limited(values: Float, time: Float, count: int, rate: float) -> Float:
    """(count, k) of values (n, k) at times (n,) [s], ascending, on a grid of `rate` Hz that begins with them.

    Straight lines between rows; where the table is finer than half a step of the grid, averaged under a Gaussian that
    is −3 dB at a quarter of the rate and −27 dB at three. Beyond its ends a table goes on as it began and ended.
    """
    place = time[0] + np.arange(count) / rate
    out = np.stack([np.interp(place, time, column) for column in values.T], axis=1)
    if np.diff(time).min() > 0.5 / rate:
        return out
    since, reach = time - time[0], _SUPPORT_SAMPLES / rate
    for low in range(0, count, _SAMPLES_PER_CHUNK):
        samples = np.arange(low, min(low + _SAMPLES_PER_CHUNK, count)) / rate
        about = _find_rows(since, samples[0] - reach, samples[-1] + reach)
        fine = _compute_mean_step(since[about], samples, rate) <= 0.5 / rate
        if fine.any():
            out[low : low + _SAMPLES_PER_CHUNK][fine] = _average_gaussian(
                values[about], since[about], low, len(samples), rate
            )[fine]
    return out


def _find_rows(time: Float, first: float, last: float) -> slice:
    """The rows that say what is between two times, one beyond each where there is one."""
    low, high = np.searchsorted(time, (first, last))
    return slice(max(int(low) - 1, 0), int(high) + 1)


def _compute_mean_step(time: Float, at: Float, rate: float) -> Float:
    """Mean step [s] of the rows about each place: one narrow pair among wide ones does not make a table fine."""
    low = np.maximum(at - _STEP_NEIGHBOURHOOD / rate, time[0])
    high = np.minimum(at + _STEP_NEIGHBOURHOOD / rate, time[-1])
    row = np.arange(len(time), dtype=np.float64)
    return np.asarray((high - low) / np.maximum(np.interp(high, time, row) - np.interp(low, time, row), 1e-300))


def _average_gaussian(values: Float, time: Float, first: int, count: int, rate: float) -> Float:
    """(count, k) under the Gaussian, from sample `first` of the grid on; times begin with 0."""
    cell = 1.0 / (rate * CELLS_PER_SAMPLE)
    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi * 0.25 * rate)
    reach = int(np.ceil(_SUPPORT_SIGMAS * sigma / cell))
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) * cell / sigma))
    middles = np.arange(first * CELLS_PER_SAMPLE - reach, (first + count - 1) * CELLS_PER_SAMPLE + reach + 1)
    cells = _compute_cell_means(values, time, (np.append(middles, middles[-1] + 1) - 0.5) * cell)
    return np.asarray(sliding_window_view(cells, len(weights), axis=0)[::CELLS_PER_SAMPLE] @ (weights / weights.sum()))


def _compute_cell_means(values: Float, time: Float, edges: Float) -> Float:
    """(m, k) of the straight lines between rows, in each of m cells between edges (m + 1,): exact, and with nothing
    subtracted that is nearly equal."""
    inside = time[slice(*np.searchsorted(time, (edges[0], edges[-1])))]
    knots = np.sort(np.concatenate([edges, inside]), kind="stable")
    width, starts = np.diff(knots), np.searchsorted(knots, edges[:-1])
    spans = np.add.reduceat(width, starts)
    means = np.empty((len(edges) - 1, values.shape[1]))
    for column, series in enumerate(values.T):
        at = np.interp(knots, time, series)
        means[:, column] = np.add.reduceat(0.5 * width * (at[1:] + at[:-1]), starts) / spans
    return means
