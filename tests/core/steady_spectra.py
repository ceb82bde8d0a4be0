"""What a field expects of a long steady stroke: its spectrum and its loudness, without a draw of noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.field.field import Field, evaluate, steady_amplitude
from hnf_core.field.linear_contact import Condition
from hnf_core.material.contact_model import Mechanics

Float = NDArray[np.float64]


def expected_spectrum(
    field: Field,
    token: NDArray[np.float32],
    mechanics: Mechanics,
    probe: str,
    direction: ArrayLike,
    speed: float,
    force: float,
    frequency_hz: ArrayLike,
) -> Float:
    """One-sided power spectral density [(m/s²)²/Hz] of the texture term of a long steady stroke.

    token: (TOKEN_DIM,). direction: (2,) unit vector. speed: m/s. force: N. frequency_hz: any shape, returned likewise.
    Constant carriers have no density and are left out; lagging heads add in amplitude, as their lags (0.5 ms) are
    short of the bands' coherence.
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    amplitude = steady_amplitudes(field, token, mechanics, probe, direction, speed, force)
    carriers = field.config.carriers
    out = np.zeros(frequency.shape)
    if carriers.time_count:
        out += _density(frequency, carriers.time_edges(), np.square(amplitude[carriers.time_slice]))
    if carriers.arc_count and speed > 0.0:
        out += _density(frequency, carriers.arc_edges() * speed, np.square(amplitude[carriers.arc_slice]))
    return out


def expected_rms(
    field: Field,
    token: NDArray[np.float32],
    mechanics: Mechanics,
    probe: str,
    direction: ArrayLike,
    speed: float,
    force: float,
) -> float:
    """RMS [m/s²] of the texture term of a long steady stroke."""
    amplitude = steady_amplitudes(field, token, mechanics, probe, direction, speed, force)
    return float(np.sqrt(np.sum(np.square(amplitude))))


def steady_amplitudes(
    field: Field,
    token: NDArray[np.float32],
    mechanics: Mechanics,
    probe: str,
    direction: ArrayLike,
    speed: float,
    force: float,
) -> Float:
    """(K,) amplitude of each unit-power carrier, as they sound."""
    condition = Condition(
        tokens=np.asarray(token, dtype=np.float64)[None, :],
        mechanics=(mechanics,),
        material=np.zeros(1, dtype=np.int32),
        direction=np.asarray(direction, dtype=np.float64)[None, :],
        speed=np.array([speed]),
        force=np.array([force]),
        contact=np.array([force > 0.0]),
        probe=probe,
    )
    return np.asarray(steady_amplitude(field.config, evaluate(field, condition))[0].sum(axis=0))


def _density(frequency: Float, edges: Float, power: Float) -> Float:
    band = np.searchsorted(edges, frequency, side="right") - 1
    inside = (band >= 0) & (band < len(power))
    density = power / np.diff(edges)
    return np.where(inside, density[np.clip(band, 0, len(power) - 1)], 0.0)


def spectrum_distance_db(a: ArrayLike, b: ArrayLike) -> float:
    """Compute the RMS level difference of two average spectra over their bins [dB].

    Densities below 1e-12 of the peak are raised to that.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    floor = 1e-12 * max(float(first.max()), float(second.max()), 1e-300)
    return float(np.sqrt(np.mean(np.square(10.0 * np.log10((first + floor) / (second + floor))))))
