"""Statistics of a simulated texture's acceleration: level, spectrum, anisotropy, dependence on speed and force.

They are compared with those of recorded textures, to validate the simulator and the material library.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.contact_model import Mechanics
from hnf_core.material.probe import Probe
from hnf_core.signal import dft321
from hnf_core.simulation.contact_dynamics import Physics, SmoothedMaps
from hnf_core.simulation.simulate import FULL_PHYSICS, PEN, SAMPLE_RATE_HZ, simulate_batch, straight_stroke

Float = NDArray[np.float64]

STROKE_CONDITIONS = ((0.1, 1.0), (0.05, 1.0), (0.15, 1.0), (0.1, 0.5), (0.1, 2.0))
"""Speed [m/s] and force [N] of strokes: a central condition, two speeds for the exponent of speed, two forces for that
of force."""
STROKE_ANGLES_RAD = (float(np.radians(8.0)), float(np.radians(98.0)))
"""Directions almost along x and y [rad]: exactly along them, a stroke would cross the same line of the tile
repeatedly."""
SETTLE_S = 0.1
"""Start of a stroke that is discarded [s]."""
LOWEST_HZ = 10.0
"""Lowest frequency in the spectra [Hz]."""


@dataclass(frozen=True)
class TextureStatistics:
    """Statistics of the acceleration on one surface at 100 mm/s and 1 N, averaged in power over two directions.

    Attributes
    ----------
    rms : float
        RMS acceleration [m/s²].
    rms_along, rms_across : float
        RMS acceleration of strokes almost along x, and almost along y [m/s²].
    centroid_hz : float
        Spectral centroid [Hz].
    below_1k : float
        Fraction of the power below 1 kHz.
    v_exponent : float
        Slope of log RMS over log speed, from 50 to 150 mm/s at 1 N.
    f_exponent : float
        Slope of log RMS over log force, from 0.5 to 2 N at 100 mm/s.
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
    probe: Probe = PEN,
    physics: Physics = FULL_PHYSICS,
    oversample: int = 2,
) -> list[TextureStatistics]:
    """Simulate strokes on each surface and compute its statistics; parameters as in `simulate_strokes`."""
    power, frequency = simulate_strokes(surfaces, duration_s, probe=probe, physics=physics, oversample=oversample)
    return [aggregate_strokes(surface_power, frequency) for surface_power in power]


def simulate_strokes(
    surfaces: Sequence[tuple[SmoothedMaps, Mechanics]],
    duration_s: float = 1.0,
    *,
    probe: Probe = PEN,
    physics: Physics = FULL_PHYSICS,
    oversample: int = 2,
) -> tuple[Float, Float]:
    """Simulate ten strokes on each surface (five speeds and forces, two directions) and return their spectra.

    Parameters
    ----------
    surfaces : sequence of (SmoothedMaps, Mechanics)
        Height map and mechanics of each surface.
    duration_s : float
        Duration of a stroke that is evaluated, after `SETTLE_S` [s].
    probe : Probe
        The probe.
    physics : Physics
        Physical effects to model.
    oversample : int
        Integration steps per sample.

    Returns
    -------
    power : ndarray, shape (surfaces, 10, bins)
        Power per FFT bin of the three axes fused by DFT321 [(m/s²)²]; strokes in the order `STROKE_CONDITIONS` ×
        `STROKE_ANGLES_RAD`.
    frequency : ndarray, shape (bins,)
        Frequencies of the bins [Hz].
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
    """Return power per FFT bin (rows, bins) of accelerations fused by DFT321, and the bins' frequencies [Hz].

    `acceleration` is (rows, n, 3) [m/s²]; bins start at `LOWEST_HZ`.
    """
    fused = dft321(acceleration - acceleration.mean(axis=1, keepdims=True))
    n = fused.shape[1]
    frequency = np.fft.rfftfreq(n, 1.0 / SAMPLE_RATE_HZ)
    power = 2.0 * np.square(np.abs(np.fft.rfft(fused, axis=1)) / n)
    return power[:, frequency >= LOWEST_HZ], frequency[frequency >= LOWEST_HZ]


def aggregate_strokes(
    power: Float, frequency: Float, instrument: Callable[[Float], Float] | None = None
) -> TextureStatistics:
    """Compute the statistics of one surface from the spectra of its ten strokes.

    Parameters
    ----------
    power : ndarray, shape (10, bins)
        Power per FFT bin from `simulate_strokes` [(m/s²)²].
    frequency : ndarray, shape (bins,)
        Frequencies [Hz].
    instrument : callable, optional
        Function from frequency [Hz] to the power density of a recording instrument's noise [(m/s²)²/Hz], which is
        added.

    Returns
    -------
    TextureStatistics
        The statistics.
    """
    if instrument is not None:
        power = power + instrument(frequency) * (frequency[1] - frequency[0])
    rms = np.sqrt(power.sum(axis=1).reshape(len(STROKE_CONDITIONS), len(STROKE_ANGLES_RAD)))
    mean_rms = np.sqrt(np.mean(np.square(rms), axis=1))
    centre_power = power[: len(STROKE_ANGLES_RAD)].sum(axis=0)
    return TextureStatistics(
        rms=float(mean_rms[0]),
        rms_along=float(rms[0, 0]),
        rms_across=float(rms[0, 1]),
        centroid_hz=float((centre_power * frequency).sum() / centre_power.sum()),
        below_1k=float(centre_power[frequency < 1000.0].sum() / centre_power.sum()),
        v_exponent=float(np.log(mean_rms[2] / mean_rms[1]) / np.log(3.0)),
        f_exponent=float(np.log(mean_rms[4] / mean_rms[3]) / np.log(4.0)),
    )
