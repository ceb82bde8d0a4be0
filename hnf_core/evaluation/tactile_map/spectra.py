"""From tokens to long-run spectra through the field, and how far two sets of spectra lie apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...field.field import Field, evaluate, steady_amplitude
from ...field.linear_contact import Condition as States
from ...material.mechanics import Mechanics
from ...metrics.average_spectrum import select_compared_bins
from ...training.conditions import make_middle_conditions, make_speed_grid
from ..expected_magnitude import compute_window_densities
from ..reference import FREQUENCY_HZ

Float = NDArray[np.float64]

PROBE_NAME = "pen"
BINS_HZ = FREQUENCY_HZ[1:101]


def predict_long_run_spectra(field: Field, tokens: NDArray[np.float32], mechanics: Sequence[Mechanics]) -> Float:
    """(n, 6, 100) density at 10 … 1000 Hz that the field expects of long steady strokes with the pen, under the six
    middle conditions of training.conditions. tokens: (n, TOKEN_DIM). mechanics: n."""
    count, grid = len(tokens), make_speed_grid()
    spectra = []
    for each in make_middle_conditions():
        states = States(
            tokens=np.asarray(tokens, dtype=np.float64),
            mechanics=tuple(mechanics),
            material=np.arange(count, dtype=np.int32),
            direction=np.tile([np.cos(each.angle), np.sin(each.angle)], (count, 1)),
            speed=np.full(count, grid[each.speed]),
            force=np.full(count, each.force),
            contact=np.ones(count, dtype=bool),
            probe=PROBE_NAME,
        )
        amplitude = steady_amplitude(field.config, evaluate(field, states)).sum(axis=1)
        spectra.append(compute_window_densities(field.config.carriers, np.square(amplitude), states.speed))
    return np.stack(spectra, axis=1)


@dataclass(frozen=True)
class SpectrumError:
    """In dB, averaged over conditions. total: RMS over the counted bins (metrics.average_spectrum). level: what one
    gain would mend, the absolute mean difference; bias: the same with its sign. shape: RMS of the rest. Within a
    condition total² = level² + shape²."""

    total: float
    level: float
    bias: float
    shape: float


def compute_spectrum_error(spectra: Float, reference: Float) -> SpectrumError:
    """(6, 100) each, as long_run_spectra has them. The reference's peaks choose the bins."""
    parts = []
    for ours, theirs in zip(spectra, reference, strict=True):
        bins = select_compared_bins(theirs, BINS_HZ)
        floor = 1e-12 * float(theirs[bins].max())
        over = 10.0 * np.log10(np.maximum(ours[bins], floor) / theirs[bins])
        parts.append((np.sqrt(np.mean(over**2)), abs(over.mean()), over.mean(), over.std()))
    total, level, bias, shape = np.mean(parts, axis=0)
    return SpectrumError(float(total), float(level), float(bias), float(shape))


def compute_log_mean(spectra: Float) -> Float:
    """Over the first axis, of levels."""
    return np.asarray(np.exp(np.mean(np.log(np.maximum(spectra, 1e-30)), axis=0)))
