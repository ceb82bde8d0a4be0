"""The tones of a lattice, apart from the noise around them: what the linear contact expects, and a gain for each.

A weave, knurl or grating rings at κ |cos δ| v. One smooth correction over log κ, which suits noise, cannot silence one
such tone and keep its neighbour; a free value per arc carrier is learnt from the few strokes whose tone falls on it. So
each tone (two per token band, see linear_texture) has an output of its own that moves with it, and so have its second
and third harmonic, which hopping and friction make of a pure wave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..material.token import BAND_WAVELENGTHS_M
from .carriers import ARC_PER_OCTAVE

Float = NDArray[np.float64]

LINE_COUNT = 2 * len(BAND_WAVELENGTHS_M)
HARMONICS = (1, 2, 3)
HARMONIC_START_DB = (0.0, -25.0, -30.0)
"""Level of a harmonic beside the tone, before training."""
HARMONIC_SHIFTS = tuple(round(ARC_PER_OCTAVE * float(np.log2(harmonic))) for harmonic in HARMONICS)
HARMONIC_START_LOG = tuple(level * np.log(10.0) / 20.0 for level in HARMONIC_START_DB)
LINE_GAIN_COUNT = LINE_COUNT * len(HARMONICS)
"""Outputs of the α head for tones: by harmonic, then by line."""
LINE_FLOOR_M_S2 = 1e-5


@dataclass(frozen=True)
class SpectralLines:
    """power: (2, n, LINES) acceleration power [(m/s²)²] in the two arc carriers about each tone. low: (n, LINES) index
    of the lower one; it may lie outside the carriers."""

    power: Float
    low: NDArray[np.intp]


def encode_line_prior(lines: SpectralLines) -> Float:
    """(n, 3 LINES) appended to the prior: log amplitude in the lower and in the upper of the two carriers about each
    tone, then the lower one's index."""
    level = 0.5 * np.log(lines.power + LINE_FLOOR_M_S2**2)
    return np.concatenate([level[0], level[1], lines.low.astype(np.float64)], axis=1)


def compute_line_power(gains: Float, columns: Float, count: int, ceiling: float) -> Float:
    """Power per arc carrier (n, count) of tones with log gains (n, GAINS) and prior_columns (n, 3 LINES).

    ceiling: of a log amplitude.
    """
    rows = np.broadcast_to(np.arange(len(gains))[:, None], (len(gains), LINE_COUNT))
    low = columns[:, 2 * LINE_COUNT :].astype(np.intp)
    out = np.zeros((len(gains), count))
    for order, (shift, start) in enumerate(zip(HARMONIC_SHIFTS, HARMONIC_START_LOG, strict=True)):
        gain = gains[:, order * LINE_COUNT : (order + 1) * LINE_COUNT] + start
        for tap in range(2):
            power = np.exp(2.0 * np.minimum(gain + columns[:, tap * LINE_COUNT : (tap + 1) * LINE_COUNT], ceiling))
            index = low + (shift + tap)
            inside = (index >= 0) & (index < count)
            np.add.at(out, (rows[inside], index[inside]), power[inside])
    return out
