"""What a surface feels like in five numbers: those that method and library are held against recorded textures with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..material.contact_model import Mechanics
from ..material.probe import PROBES, Probe
from .contact_dynamics import Physics
from .dft321 import dft321
from .height_sampling import SmoothedMaps
from .simulate import FULL_PHYSICS, SAMPLE_RATE_HZ, simulate_batch, straight_stroke

Float = NDArray[np.float64]

STROKE_CONDITIONS = ((0.1, 1.0), (0.05, 1.0), (0.15, 1.0), (0.1, 0.5), (0.1, 2.0))
"""(m/s, N): the middle, then the ends of the speed and the force exponent."""
STROKE_ANGLES_RAD = (float(np.radians(8.0)), float(np.radians(98.0)))
"""Almost along x and y: exactly along them, a stroke would meet the same line of the tile again and again."""
SETTLE_S = 0.1
LOWEST_HZ = 10.0


@dataclass(frozen=True)
class TextureStatistics:
    """Of one surface at 100 mm/s, 1 N, both directions in power; rms_along, rms_across of each alone [m/s²].

    v_exponent: slope of log RMS over log speed from 50 to 150 mm/s at 1 N; f_exponent: over log force from 0.5 to 2 N
    at 100 mm/s. below_1k: share of the power.
    """

    rms: float
    rms_along: float
    rms_across: float
    centroid_hz: float
    below_1k: float
    v_exponent: float
    f_exponent: float


def compute_texture_statistics(
    surfaces: Sequence[tuple[SmoothedMaps, Mechanics]],
    duration_s: float = 1.0,
    *,
    probe: Probe = PROBES["pen"],
    physics: Physics = FULL_PHYSICS,
    oversample: int = 2,
) -> list[TextureStatistics]:
    """The five numbers of each surface; see stroked."""
    power, frequency = simulate_strokes(surfaces, duration_s, probe=probe, physics=physics, oversample=oversample)
    return [aggregate_strokes(each, frequency) for each in power]


def simulate_strokes(
    surfaces: Sequence[tuple[SmoothedMaps, Mechanics]],
    duration_s: float = 1.0,
    *,
    probe: Probe = PROBES["pen"],
    physics: Physics = FULL_PHYSICS,
    oversample: int = 2,
) -> tuple[Float, Float]:
    """Simulate ten strokes of each surface: CONDITIONS × ANGLES, `duration_s` each after SETTLE_S.

    Returns power per bin (surfaces, 10, bins) [(m/s²)²] and the bins' frequencies.
    """
    rows = [(v, f, angle) for v, f in STROKE_CONDITIONS for angle in STROKE_ANGLES_RAD]
    strokes = [straight_stroke(v, f, duration_s + SETTLE_S, angle_rad=angle) for v, f, angle in rows]
    acceleration = simulate_batch(
        [maps for maps, _ in surfaces for _ in rows],
        strokes * len(surfaces),
        [mechanics for _, mechanics in surfaces for _ in rows],
        probe,
        oversample=oversample,
        physics=physics,
    )
    power, frequency = compute_fused_spectra(acceleration[:, round(SETTLE_S * SAMPLE_RATE_HZ) :])
    return power.reshape(len(surfaces), len(rows), -1), frequency


def compute_fused_spectra(acceleration: Float) -> tuple[Float, Float]:
    """Power per bin (rows, bins) of the fused signal from LOWEST_HZ on, and the bins' frequencies."""
    fused = dft321(acceleration - acceleration.mean(axis=1, keepdims=True))
    n = fused.shape[1]
    frequency = np.fft.rfftfreq(n, 1.0 / SAMPLE_RATE_HZ)
    power = 2.0 * np.square(np.abs(np.fft.rfft(fused, axis=1)) / n)
    return power[:, frequency >= LOWEST_HZ], frequency[frequency >= LOWEST_HZ]


def aggregate_strokes(
    power: Float, frequency: Float, instrument: Callable[[Float], Float] | None = None
) -> TextureStatistics:
    """The five numbers of one surface's ten strokes (10, bins).

    instrument: frequency [Hz] → power density [(m/s²)²/Hz] of the noise that a recording instrument adds.
    """
    if instrument is not None:
        power = power + instrument(frequency) * (frequency[1] - frequency[0])
    rms = np.sqrt(power.sum(axis=1).reshape(len(STROKE_CONDITIONS), len(STROKE_ANGLES_RAD)))
    both = np.sqrt(np.mean(np.square(rms), axis=1))
    middle = power[: len(STROKE_ANGLES_RAD)].sum(axis=0)
    return TextureStatistics(
        rms=float(both[0]),
        rms_along=float(rms[0, 0]),
        rms_across=float(rms[0, 1]),
        centroid_hz=float((middle * frequency).sum() / middle.sum()),
        below_1k=float(middle[frequency < 1000.0].sum() / middle.sum()),
        v_exponent=float(np.log(both[2] / both[1]) / np.log(3.0)),
        f_exponent=float(np.log(both[4] / both[3]) / np.log(4.0)),
    )
