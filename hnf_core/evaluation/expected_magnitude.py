"""What the field expects window by window, and a signal whose every window shows just that. For benchmarks only.

The second, the *expected-magnitude form*, is no signal to feel: it repeats every 50 ms. Against one recording of a
random texture it scores a smaller spectral MSE than the texture itself could, and is compared with its own kind only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..field.carriers import MODEL_RATE_HZ, Carriers
from ..field.field import Field, accumulate, evaluate
from ..field.stroke import StrokeInput
from ..field.timeline import build_condition, resample_action, sample_count
from ..metrics.magnitudes import BIN_COUNT
from ..metrics.spectra import WINDOW_SAMPLES, hann_window

Float = NDArray[np.float64]

BIN_HZ = MODEL_RATE_HZ / WINDOW_SAMPLES
LINE_HZ = 2.0 * BIN_HZ
"""Lines at 15, 35, 55 … Hz lie midway between bins: each is the strongest in the two bins beside it, and the next ones
are down by 14 dB there, so a window hardly shows where it starts."""
LINE_COUNT = BIN_COUNT // 2
_STATE_STRIDE = 4
"""States from one that is asked to the next, 20 ms."""
_CELL_HZ = 1.0
_REACH_HZ = 4.0 * BIN_HZ
"""Beyond four bins a Hann window passes less than 1e-5 of a band's power."""


def compute_expected_densities(field: Field, stroke: StrokeInput, every: int = 1) -> Float:
    """(n, 100) one-sided power density [(m/s²)²/Hz] that a Hann window of 0.1 s at 10 kHz is expected to show at
    10, 20 … 1000 Hz, for every `every`-th action state, as if that state lasted.

    The texture term: constant carriers have no density and are left out.
    """
    action, token_index = resample_action(stroke)
    amplitude = accumulate(field.config, evaluate(field, build_condition(stroke, action, token_index)))
    return compute_window_densities(
        field.config.carriers, np.square(amplitude.sum(axis=1))[::every], action.speed[::every]
    )


def compute_window_densities(carriers: Carriers, power: Float, speed: Float) -> Float:
    """(n, 100) density that a Hann window of 0.1 s shows at 10 … 1000 Hz of carriers of power (n, K) at speed (n,)."""
    cells = np.zeros((len(power), len(_make_cell_edges()) - 1))
    if carriers.time_count:
        cells += power[:, carriers.time_slice] @ _compute_band_shares(carriers.time_edges())
    if carriers.arc_count:
        edges = carriers.arc_edges()
        for value in np.unique(speed[speed > 0.0]):
            rows = speed == value
            cells[rows] += power[rows, carriers.arc_slice] @ _compute_band_shares(edges * value)
    return np.asarray(cells @ _compute_window_kernel())


def make_expected_magnitude_signal(density: ArrayLike, count: int, lasting: float | None = None) -> Float:
    """(count,) m/s² at 10 kHz: lines at 15, 35 … 995 Hz with phases 2π n² / n_tot, so loud that |X_k| of a Hann window
    of 1000 samples is sqrt(π S_k) / 2, what a Gaussian texture of density S is expected to show, wherever it starts.

    density: (n, 100) as from expected_densities, at even steps, read linearly between and held beyond the last.
    lasting: steps that the signal lasts, n − 1 where nothing is said.
    """
    states = np.asarray(density, dtype=np.float64)
    window = hann_window(WINDOW_SAMPLES)
    squared = states * (0.5 * MODEL_RATE_HZ * float(np.sum(np.square(window))))  # one-sided density → E |X_k|²
    magnitude = 0.5 * np.sqrt(np.pi * squared)
    at_half_a_bin = 0.5 * float(window.sum()) * float(np.sinc(0.5)) / 0.75
    level = magnitude.reshape(len(states), LINE_COUNT, 2).mean(axis=2) / at_half_a_bin
    end = len(states) - 1.0
    place = np.minimum(np.linspace(0.0, end if lasting is None else lasting, count), end)
    low = np.minimum(place.astype(np.intp), max(len(states) - 2, 0))
    high, share = np.minimum(low + 1, len(states) - 1), place - low
    time, out = np.arange(count) / MODEL_RATE_HZ, np.zeros(count)
    for line in range(LINE_COUNT):
        envelope = (1.0 - share) * level[low, line] + share * level[high, line]
        out += envelope * np.cos(2.0 * np.pi * ((1.5 * BIN_HZ + LINE_HZ * line) * time + line**2 / LINE_COUNT))
    return out


def synthesise_expected_magnitude(field: Field, stroke: StrokeInput) -> Float:
    """The stroke's texture in expected-magnitude form, (count,) m/s² at 10 kHz; there is no seed to it."""
    action, _ = resample_action(stroke)
    lasting = (len(action.speed) - 1) / _STATE_STRIDE
    return make_expected_magnitude_signal(
        compute_expected_densities(field, stroke, _STATE_STRIDE), sample_count(action), lasting
    )


def _make_cell_edges() -> Float:
    return np.arange(0.0, BIN_COUNT * BIN_HZ + _REACH_HZ + _CELL_HZ, _CELL_HZ)


def _compute_band_shares(edges: Float) -> Float:
    """(B, cells) share of each band's power that falls into each cell of 1 Hz."""
    reached = np.clip((_make_cell_edges()[None, :] - edges[:-1, None]) / np.diff(edges)[:, None], 0.0, 1.0)
    return np.asarray(np.diff(reached, axis=1))


def _compute_window_kernel() -> Float:
    """(cells, 100) density that unit power in a cell shows in each bin, its image at negative frequencies included."""
    centre = _make_cell_edges()[:-1] + 0.5 * _CELL_HZ
    bins = np.arange(1, BIN_COUNT + 1) * BIN_HZ
    near, mirrored = (_compute_window_power((bins[None, :] - sign * centre[:, None]) / BIN_HZ) for sign in (1.0, -1.0))
    return np.asarray((near + mirrored) / (1.5 * BIN_HZ))


def _compute_window_power(offset: Float) -> Float:
    """|W|² of a Hann window at an offset in bins, 1 at its middle; its integral is 1.5 bins."""
    wide = np.where(np.abs(np.abs(offset) - 1.0) < 1e-9, np.abs(offset) + 1e-6, offset)
    return np.asarray(np.square(np.sinc(wide) / (1.0 - np.square(wide))))
