"""Force noise of a fingertip's pad, junction by junction and by numerical integration, against which bands are tested.

No closed-form integral, no midpoint of a band: densities are summed over a fine grid of wavenumbers, ridges over their
neighbors, and threads over the phases at which junctions meet them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.contact_model import KnownMechanics
from hnf_core.material.probe import Pad

Float = NDArray[np.float64]
STEPS = 60
"""Wavenumbers per band."""
NEIGHBORS = 200
"""Ridges on either side whose place a ridge passes over later or earlier."""


def integrate(density: Float, wavenumber: Float) -> float:
    """Trapezoidal integral of a density over wavenumbers."""
    return float(np.sum(0.5 * (density[1:] + density[:-1]) * np.diff(wavenumber)))


def ridge_factor(wavenumber: Float, pad: Pad) -> Float:
    """Structure factor of a chain of ridges whose likeness falls from one to the next, summed over the neighbors.

    The spacing's jitter is a random walk, so the n-th neighbor has n times its variance.
    """
    phase = 2.0 * np.pi * wavenumber * pad.ridge_spacing_m
    total = np.ones_like(phase)
    for n in range(1, NEIGHBORS):
        likeness = pad.ridge_coherence**n * np.exp(-0.5 * n * np.square(phase * pad.ridge_jitter))
        total += 2.0 * likeness * np.cos(n * phase)
    return total


def spot_factor(wavenumber: Float, radius: float) -> Float:
    """Power that a Hertzian spot passes, without lobes: Padé approximant of the documented limits."""
    q = 2.0 * np.pi * wavenumber * radius
    return 1.0 / (1.0 + q**2 / 5.0 + 2.0 * q**4 / 9.0)


def pad_band_power(low: float, high: float, known: KnownMechanics, pad: Pad, force: float) -> float:
    """Power [N²] of the tangential force of all junctions between two wavenumbers [cycles/m], without threads."""
    area = pad.contact_area_m2 * force**0.5
    junctions = area / pad.ridge_spacing_m**2
    load = force / junctions
    # One junction under its share of the load: a power law, as strong as stated in the octave about a millimetre.
    octave = np.linspace(1e3 / np.sqrt(2.0), 1e3 * np.sqrt(2.0), 2001)
    slope = known.friction_noise_slope
    scale = (known.friction_noise_n * load**0.38) ** 2 / integrate((octave / 1e3) ** -slope, octave)
    # From waves as long as the contact to waves as short as a junction it rubs at most by its friction.
    everywhere = np.geomspace(1.0 / (2.0 * np.sqrt(area / np.pi)), 1.0 / (2.0 * pad.junction_radius_m), 4001)
    free = scale * integrate((everywhere / 1e3) ** -slope, everywhere)
    rubbing = (known.friction * load) ** 2
    scale *= rubbing / (rubbing + free)
    wavenumber = np.linspace(low, high, STEPS + 1)
    density = scale * (wavenumber / 1e3) ** -slope * spot_factor(wavenumber, 0.5 * pad.junction_radius_m)
    passed = ridge_factor(wavenumber, pad) * bending_factor(wavenumber, known, pad, force)
    return junctions * integrate(density * passed, wavenumber)


def pile_compression(known: KnownMechanics, pad: Pad, force: float) -> float:
    """Depth [m] by which a pile gives way to the load by its tangent stiffness, from van Wyk's pressure over depth.

    5 kPa press it to half its depth.
    """
    free = known.pile_m
    if free == 0.0:
        return 0.0
    pressure = force / (pad.contact_area_m2 * force**0.5)

    def resist(share: float) -> float:
        return 5e3 * (share**-3 - 1.0) / (0.5**-3 - 1.0)

    low, share = 1e-3, 1.0
    for _ in range(60):  # halving: it resists the less, the more of it is left
        middle = 0.5 * (low + share)
        low, share = (middle, share) if resist(middle) > pressure else (low, middle)
    step = 1e-5 * share
    stiffness = (resist(share - step) - resist(share + step)) / (2.0 * step * free)
    return float(pressure / stiffness)


def bending_factor(wavenumber: Float, known: KnownMechanics, pad: Pad, force: float) -> Float:
    """Power that is left of a force whose fibers bend by their compression times the friction before they slip."""
    bend = known.friction * pile_compression(known, pad, force) / 0.82
    return 1.0 / (1.0 + (2.0 * np.pi * wavenumber * bend) ** 2)


def thread_line_power(order: int, known: KnownMechanics, pad: Pad, force: float) -> float:
    """Mean power [N²] of a harmonic of threads, of junctions that meet them at random phases, without filters."""
    junctions = pad.contact_area_m2 * force**0.5 / pad.ridge_spacing_m**2
    heights = 0.1 * known.thread_spacing_m * np.array([1.0, 0.35]) / np.hypot(1.0, 0.35)
    crests = force / (2.0 * junctions * pad.ridge_modulus_pa * pad.junction_radius_m)
    compression = crests + pile_compression(known, pad, force)
    modulation = heights[order - 1] / np.sqrt(np.square(heights).sum() + compression**2)
    phase = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    one = known.friction * force / junctions * modulation * np.cos(phase)
    return float(junctions * np.mean(np.square(one)))
