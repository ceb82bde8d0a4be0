"""The linear contact of one state, as quickly as numpy can. linear_contact is the reference, term by term."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..material.contact import power_gain, surface_stiffness_at_1n, with_defaults
from ..material.mechanics import Mechanics
from ..material.probe import Probe
from .carriers import ARC_PER_OCTAVE, Carriers
from .linear_contact import FLANK_FRICTION, arc_gain, lateral_hand_impedance, time_edges
from .live_texture import LiveTexture

Float = NDArray[np.float64]

_TAPS = np.arange(2)[:, None]


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


class LiveLinear:
    """The linear contact of one material under one probe."""

    def __init__(self, token: Float, mechanics: Mechanics, probe: Probe, carriers: Carriers) -> None:
        self._of = token, carriers
        self._kappa = carriers.arc_centres()
        self._wave = np.square(2.0 * np.pi * self._kappa)
        self._known, self._probe = with_defaults(mechanics), probe
        self._surface = surface_stiffness_at_1n(mechanics, probe)
        self._weight = np.empty((3, len(self._kappa)))

    @cached_property
    def _texture(self) -> LiveTexture:
        """That of at() alone."""
        return LiveTexture(*self._of)

    def touch(self, angle: float, speed: float, force: float) -> tuple[tuple[float, ...], float]:
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

    def at(self, angle: float, speed: float, force: float) -> LinearState:
        """In numpy; arguments as of touch()."""
        touch, resonance = self.touch(angle, speed, force)
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
        cut = self._texture.cut(angle, weight)
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


class TimeShare:
    """time_band_power for one state."""

    def __init__(self, carriers: Carriers) -> None:
        self._edges = time_edges(carriers)
        self._sum = np.zeros(carriers.arc_count + 1)

    def of(self, power: Float, speed: float) -> Float:
        """(Ka,) power per arc band at a speed not below its floor → (Kt,) per time band."""
        np.cumsum(power, out=self._sum[1:])
        place = np.minimum(np.maximum(self._edges - ARC_PER_OCTAVE * math.log2(speed), 0.0), len(power))
        low = np.minimum(place.astype(int), len(power) - 1)
        start = self._sum[low]
        edges = start + (place - low) * (self._sum[low + 1] - start)
        return np.asarray(edges[1:] - edges[:-1])
