"""The linear contact of one state, as quickly as numpy can: a token's spectrum, cut by one stroke direction after
another, and what a probe makes of it. field/linear_texture.py and field/linear_contact.py are the reference, term by
term.

What follows from the token alone is worked out once, and all angles are taken at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...material.contact import power_gain, surface_stiffness_at_1n, with_defaults
from ...material.mechanics import Mechanics
from ...material.probe import Probe
from ...material.token import BAND_FEATURES, BAND_WAVELENGTHS_M
from ..carriers import ARC_PER_OCTAVE, Carriers
from ..linear_contact import FLANK_FRICTION, arc_gain, lateral_hand_impedance, time_edges_in_arc_bands
from ..linear_texture import (
    ANGLES,
    GRID_ANGLES,
    LINE_CONCENTRATION,
    ORIENTED_DENSITY_MEAN,
    compute_surface_spectrum,
    noise_remainder,
)

Float = NDArray[np.float64]

_HALF = ANGLES // 2
_ANGLE = GRID_ANGLES[:, None]
_TWO, _FOUR = np.exp(-2j * _ANGLE) * (4.0 / 3.0), np.exp(-4j * _ANGLE) * (2.0 / 3.0)
_ROTATION_EXPONENTS = np.array([[-2j], [-4j]])
_TAPS = np.arange(2)[:, None]


@dataclass(frozen=True)
class ProjectedSpectrum:
    """Power of three cuts of one surface. noise: (3, Ka). lines: (3, 2, lines) in the two arc bands about each tone.
    low: (lines,) index of the lower one, which may lie outside."""

    noise: Float
    lines: Float
    low: NDArray[np.intp]


class LiveSurfaceSpectrum:
    """One material's token (TOKEN_DIM,), ready to be cut in any direction."""

    def __init__(self, token: Float, carriers: Carriers) -> None:
        bands, count = len(BAND_WAVELENGTHS_M), carriers.arc_count
        values = np.asarray(token, dtype=np.float64)[: bands * len(BAND_FEATURES)].reshape(bands, len(BAND_FEATURES))
        feature = dict(zip(BAND_FEATURES, values.T, strict=True))
        self._moments = np.stack([feature["cos2"] + 1j * feature["sin2"], feature["cos4"] + 1j * feature["sin4"]])
        self._peak, self._power = feature["peak"].copy(), 10.0 ** (2.0 * feature["level"])
        still = compute_surface_spectrum(np.asarray(token)[None], np.array([[1.0, 0.0]]), carriers)
        self._octaves = ARC_PER_OCTAVE * np.log2(np.tile(still.line_wavenumber[0], 2) / carriers.arc_centres()[0])
        position = np.log2(carriers.arc_centres() * BAND_WAVELENGTHS_M[0])
        self._below = np.clip(np.floor(position).astype(int), 0, bands - 2)
        self._share = np.clip(position - self._below, 0.0, 1.0)
        self._line_at = np.clip(np.rint(self._octaves[:bands]).astype(int), 0, count - 1)
        shift = np.rint(-ARC_PER_OCTAVE * np.log2(np.abs(np.cos(_ANGLE[:_HALF, 0])))).astype(int)
        source = np.arange(count)[None, :] + shift[:, None]
        self._source = np.where(source < count, source, count)
        self._density_at = (np.arange(_HALF) * bands)[:, None] + np.append(still.band, 0)[self._source]
        self._weighted, self._moved = np.zeros((3, count + 1)), np.empty((3, *self._source.shape))

    def project(self, angle: float, weight: Float) -> ProjectedSpectrum:
        """angle: of the stroke, radians. weight: (3, Ka), what of a wave of each |κ| counts in three cuts."""
        two, four = self._moments * np.exp(angle * _ROTATION_EXPONENTS)
        axis = 0.25 * np.arctan2(four.imag, four.real)
        along = 0.5 * (1.0 + (two * np.exp(-2j * axis)).real)
        along = np.minimum(np.maximum(along, 0.0), 1.0)
        split = np.stack([along, 1.0 - along])
        tones = self._peak * split / split.max(axis=0)
        tones /= np.maximum(tones.sum(axis=0), 1.0)
        tones = np.minimum(np.maximum(tones, 0.0), 1.0)
        density = self._density(two, four, axis, along)
        np.multiply(
            weight, self._spread_over_wavenumbers(self._power * noise_remainder(tones)), out=self._weighted[:, :-1]
        )
        np.take(self._weighted, self._source, axis=1, out=self._moved, mode="clip")
        noise = np.einsum("waj,aj->wj", self._moved, density.take(self._density_at))
        power = (weight[:, None, self._line_at] * (self._power * tones)).reshape(3, -1)
        cosine = np.abs(np.concatenate([np.cos(axis), np.sin(axis)]))
        # The same floor as the reference's 1e-9 cycles/m: a wave along the stroke is met by nobody.
        place = np.maximum(self._octaves + ARC_PER_OCTAVE * np.log2(np.maximum(cosine, 1e-300)), -1e3)
        low = np.floor(place)
        share = place - low
        return ProjectedSpectrum(
            noise / ANGLES, np.stack([power * (1.0 - share), power * share], axis=1), low.astype(np.intp)
        )

    def _spread_over_wavenumbers(self, power: Float) -> Float:
        """Powers per token band spread over |κ| (Ka,)."""
        level = np.log(np.maximum(power, 1e-30) / ARC_PER_OCTAVE)
        return np.asarray(np.exp(level[self._below] * (1.0 - self._share) + level[self._below + 1] * self._share))

    def _density(self, two: NDArray[np.complex128], four: NDArray[np.complex128], axis: Float, along: Float) -> Float:
        """(ANGLES / 2, bands): angular density at δ and at π − δ, added, since both move the spectrum alike."""
        oriented = np.minimum(np.square(four.real) + np.square(four.imag), 1.0)
        series = 1.0 + two.real * _TWO.real - two.imag * _TWO.imag + four.real * _FOUR.real - four.imag * _FOUR.imag
        turned = np.cos(2.0 * (_ANGLE - axis))
        line = along * np.exp(LINE_CONCENTRATION * (turned - 1.0)) + (1.0 - along) * np.exp(
            -LINE_CONCENTRATION * (turned + 1.0)
        )
        density = np.maximum((1.0 - oriented) * series + oriented * line / ORIENTED_DENSITY_MEAN, 0.0)
        return np.asarray(density[:_HALF] + density[: _HALF - 1 : -1])


@dataclass(frozen=True)
class LinearState:
    """As LinearContact, of one state: power, noise (Ka,); normal, resonance: numbers; lines: (2, lines) and low
    (lines,). gain: (Ka,) arc_gain at its speed."""

    power: Float
    noise: Float
    normal: float
    resonance: float
    lines: Float
    low: NDArray[np.intp]
    gain: Float


class LiveLinearContact:
    """The linear contact of one material under one probe."""

    def __init__(self, token: Float, mechanics: Mechanics, probe: Probe, carriers: Carriers) -> None:
        self._of = token, carriers
        self._kappa = carriers.arc_centres()
        self._wave = np.square(2.0 * np.pi * self._kappa)
        self._known, self._probe = with_defaults(mechanics), probe
        self._surface = surface_stiffness_at_1n(mechanics, probe)
        self._weight = np.empty((3, len(self._kappa)))

    @cached_property
    def _spectrum(self) -> LiveSurfaceSpectrum:
        """That of at() alone."""
        return LiveSurfaceSpectrum(*self._of)

    def contact_columns(self, angle: float, speed: float, force: float) -> tuple[tuple[float, ...], float]:
        """Columns TOUCH of a state, and its resonance [Hz]. angle: radians; speed, force: m/s and N, not below their
        floors."""
        probe, tip = self._probe, self._probe.tip_radius_m
        surface = self._surface * force ** (1.0 / 3.0)
        stiffness = surface * probe.stiffness_n_m / (surface + probe.stiffness_n_m)
        radius = min(math.sqrt(1.5 * force * tip / (stiffness if probe.soft_tip else surface)), tip)
        damping = 4.0 * self._known.damping_ratio**2 * stiffness * probe.mass_kg
        rubbed = 1.0 + self._known.friction**2
        flank = (1.0 + FLANK_FRICTION * (1.0 - radius / tip) ** 2) ** 2 - 1.0
        resonance = math.sqrt(stiffness / probe.mass_kg) / (2.0 * math.pi)
        leaning = (force / probe.mass_kg) ** 2
        return (angle, speed, radius, stiffness, damping, probe.mass_kg, leaning, rubbed, flank), resonance

    def evaluate(self, angle: float, speed: float, force: float) -> LinearState:
        """In numpy; arguments as of touch()."""
        touch, resonance = self.contact_columns(angle, speed, force)
        radius, stiffness, damping, mass, leaning, rubbed, flank = touch[2:]
        gain, wave = arc_gain(self._kappa, np.array([speed]))[0], self._wave
        # The squares of tip_response at κ and at half of it, by which the bearing spots are smaller.
        reach = wave * radius**2
        passed, bent, leaned = weight = self._weight
        np.exp(reach * (-1.0 / 5.0), out=passed)
        np.exp(reach * (-1.0 / 20.0), out=leaned)
        np.multiply(leaned, wave, out=bent)
        squared, fade = wave * speed**2, np.square(gain)
        hand, hand_damping = lateral_hand_impedance(self._probe.name)
        lateral = np.square(squared) / (np.square(hand - squared) + hand_damping * squared)
        up, aside = power_gain(squared, stiffness, damping, mass) * fade, lateral * leaning * fade
        cut = self._spectrum.project(angle, weight)
        met = cut.noise[0] * up
        noise = met * rubbed + (cut.noise[1] + flank * wave * cut.noise[2]) * aside
        count = len(wave)
        where = cut.low + _TAPS
        at = np.minimum(np.maximum(where, 0), count - 1)
        tone = cut.lines[0] * up[at]
        lines = tone * rubbed + (cut.lines[1] + flank * wave[at] * cut.lines[2]) * aside[at]
        inside = where == at
        power = noise + np.bincount(at.ravel(), (lines * inside).ravel(), count)
        normal = float(met.sum() + (tone * inside).sum())
        return LinearState(power, noise, normal, resonance, lines, cut.low, gain)


class TimeBandPower:
    """time_band_power for one state."""

    def __init__(self, carriers: Carriers) -> None:
        self._edges = time_edges_in_arc_bands(carriers)
        self._sum = np.zeros(carriers.arc_count + 1)

    def to_time_bands(self, power: Float, speed: float) -> Float:
        """(Ka,) power per arc band at a speed not below its floor → (Kt,) per time band."""
        np.cumsum(power, out=self._sum[1:])
        place = np.minimum(np.maximum(self._edges - ARC_PER_OCTAVE * math.log2(speed), 0.0), len(power))
        low = np.minimum(place.astype(int), len(power) - 1)
        start = self._sum[low]
        edges = start + (place - low) * (self._sum[low + 1] - start)
        return np.asarray(edges[1:] - edges[:-1])
