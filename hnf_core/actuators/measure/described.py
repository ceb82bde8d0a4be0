"""What a data sheet says of a resonant actuator becomes its profile, its response that of a mass on a spring."""

from __future__ import annotations

import math

import numpy as np

from ...errors import UsageError
from ..profile import ActuatorProfile
from ..response import Float, FrequencyResponse
from .resonator import Resonator

LOWEST_HZ, HIGHEST_HZ = 10.0, 1000.0
GRID_POINTS_PER_OCTAVE = 24
DATASHEET_USABLE_DB = 20.0
"""What is fainter than at the resonance by more is outside the range: an inverse filter could not bring it back."""
MIN_Q, MAX_Q = 0.1, 1000.0


def make_datasheet_profile(
    title: str,
    source: str,
    *,
    resonance_hz: float,
    quality: float,
    peak_m_s2: float | None,
    range_hz: tuple[float, float] | None = None,
    sustained: float | None = None,
    thermal_s: float | None = None,
) -> ActuatorProfile:
    """A profile from a maker's figures.

    source: the document they are from. resonance_hz, quality: of the mass on its spring, quality = resonance over the
    width between its half-power points. peak_m_s2: amplitude at the resonance, at the strongest drive, on the load that
    the sheet names; None = not stated. range_hz: where it may be used, None = within USABLE_DB of the resonance.
    sustained, thermal_s: see limits. As where it was measured, the response is told relative to its median in the
    range, and full scale is what that median gives. Raises UsageError for what is no such actuator.
    """
    if not (LOWEST_HZ <= resonance_hz <= HIGHEST_HZ and MIN_Q <= quality <= MAX_Q):
        raise UsageError(
            f"a resonance of {resonance_hz:g} Hz with a Q of {quality:g} is no actuator for touch.",
            remedy=f"Give {LOWEST_HZ:g} to {HIGHEST_HZ:g} Hz, and a Q of {MIN_Q:g} to {MAX_Q:g}.",
        )
    octaves = math.log2(HIGHEST_HZ / LOWEST_HZ)
    grid = np.geomspace(LOWEST_HZ, HIGHEST_HZ, round(octaves * GRID_POINTS_PER_OCTAVE) + 1)
    near = resonance_hz * 2.0 ** np.linspace(-1.0, 1.0, 401) ** 3  # close together where it is sharp
    frequency = np.unique(np.concatenate([grid, near[(near > LOWEST_HZ) & (near < HIGHEST_HZ)]]))
    model = Resonator(resonance_hz, 0.5 / quality, 1.0)
    moved = model.evaluate(frequency)
    level = 20.0 * np.log10(np.abs(moved) / abs(complex(model.evaluate(resonance_hz))))
    found = range_hz or _find_range_around_peak(frequency, level)
    if not found[0] < HIGHEST_HZ or not found[1] > LOWEST_HZ:
        raise UsageError(f"no frequency of touch lies from {found[0]:g} to {found[1]:g} Hz.", remedy="Check the range.")
    within = np.geomspace(max(found[0], LOWEST_HZ), min(found[1], HIGHEST_HZ), 101)
    median = float(np.median(np.interp(np.log(within), np.log(frequency), level)))
    response = FrequencyResponse(frequency, level - median, np.unwrap(np.angle(moved)), np.ones_like(frequency))
    return ActuatorProfile(
        "described",
        title,
        source,
        range_hz=found,
        peak_m_s2=None if peak_m_s2 is None else peak_m_s2 * 10.0 ** (median / 20.0),
        sustained=sustained,
        thermal_s=thermal_s,
        response=response,
    )


def _find_range_around_peak(frequency: Float, level: Float) -> tuple[float, float]:
    """Ends [Hz] of the stretch about the strongest place that is not too faint."""
    good = level >= float(level.max()) - DATASHEET_USABLE_DB
    first = last = int(level.argmax())
    while first > 0 and good[first - 1]:
        first -= 1
    while last < len(level) - 1 and good[last + 1]:
        last += 1
    return float(frequency[first]), float(frequency[last])
