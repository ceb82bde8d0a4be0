"""A resonant transducer: counts in, acceleration [m/s²] and coil temperature [°C] out.

A moving coil on a spring is pressed onto a fingertip: m x″ = F − k x − c x′. The current makes the force F and warms
the coil. It is constant between samples, as behind a converter, so the linear parts are integrated exactly and no time
step is too long. The linear system is evaluated sample by sample in blocks of matrix products.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from .limits import FULL_SCALE_COUNTS

Floats = NDArray[np.float64]

BLOCK_SAMPLES = 64
"""Samples per matrix product; few enough that the zeros in half of each matrix cost little."""


@dataclass(frozen=True)
class StateSpace:
    """Exact step s[n+1] = A s[n] + b u[n] of a linear system whose input is constant between samples.

    `transition` (S, S) is A, `input_vector` (S,) is b. Channels are independent and share both.
    """

    transition: Floats
    input_vector: Floats

    def simulate(self, start: Floats, inputs: Floats) -> Floats:
        """Return all states (n + 1, S, C) from `start` (S, C) on, with `inputs` (n, C)."""
        states = np.empty((len(inputs) + 1, *start.shape))
        states[0] = start
        free, forced = self._block_matrices
        for begin in range(0, len(inputs), BLOCK_SAMPLES):
            block = inputs[begin : begin + BLOCK_SAMPLES]
            count = len(block)
            free_motion = np.einsum("nst,tc->nsc", free[:count], states[begin])
            states[begin + 1 : begin + 1 + count] = free_motion + np.tensordot(forced[:count, :, :count], block, axes=1)
        return states

    @cached_property
    def _block_matrices(self) -> tuple[Floats, Floats]:
        """Matrices that advance the system over a block of N samples at once.

        These are the powers A^(n+1), (N, S, S), and the responses of the state after sample n to the input at sample j,
        (N, S, N).
        """
        powers = [np.eye(len(self.input_vector))]
        for _ in range(BLOCK_SAMPLES):
            powers.append(self.transition @ powers[-1])
        responses = np.asarray(powers[:-1]) @ self.input_vector
        forced = np.zeros((BLOCK_SAMPLES, len(self.input_vector), BLOCK_SAMPLES))
        for sample in range(BLOCK_SAMPLES):
            forced[sample:, :, sample] = responses[: BLOCK_SAMPLES - sample]
        return np.asarray(powers[1:]), forced


@dataclass(frozen=True)
class Transducer:
    """Mechanical, electrical and thermal constants of a transducer.

    Attributes
    ----------
    mass_kg : float
        Moving mass, including the skin's contribution [kg].
    stiffness_n_m, damping_n_s_m : float
        Stiffness [N/m] and damping [N s/m] of spring and skin.
    force_n_a : float
        Force constant [N/A].
    current_a : float
        Current at full scale [A].
    saturation_n : float
        Largest force of the magnet [N].
    stroke_m : float
        Distance to either end stop [m].
    resistance_ohm : float
        Resistance of the coil [Ω].
    thermal_k_w : float
        Final warming per power [K/W].
    thermal_s : float
        Time constant of the warming [s].
    ambient_c : float
        Ambient temperature [°C].
    """

    mass_kg: float = 0.005
    stiffness_n_m: float = 700.0
    damping_n_s_m: float = 1.5
    force_n_a: float = 0.6
    current_a: float = 0.25
    saturation_n: float = 0.6
    stroke_m: float = 0.001
    resistance_ohm: float = 8.0
    thermal_k_w: float = 60.0
    thermal_s: float = 10.0
    ambient_c: float = 25.0

    def __post_init__(self) -> None:
        positive = (
            self.mass_kg, self.stiffness_n_m, self.force_n_a, self.current_a, self.saturation_n, self.stroke_m,
            self.resistance_ohm, self.thermal_k_w, self.thermal_s,
        )  # fmt: skip
        if not (all(value > 0.0 for value in positive) and self.damping_n_s_m >= 0.0):
            raise UsageError(f"this transducer cannot exist: {self}.", remedy="Give positive figures.")

    @property
    def resonance_hz(self) -> float:
        return math.sqrt(self.stiffness_n_m / self.mass_kg) / (2.0 * math.pi)

    def compute_force(self, drive: Floats) -> Floats:
        """Compute the force [N] of a drive (fraction of full scale): linear if small, saturating at `saturation_n`."""
        linear = self.force_n_a * self.current_a * drive
        force: Floats = self.saturation_n * np.tanh(linear / self.saturation_n)
        return force

    def compute_power(self, drive: Floats) -> Floats:
        """Compute the power that warms the coil [W]."""
        power: Floats = self.resistance_ohm * np.square(self.current_a * drive)
        return power


CHUNK_SAMPLES = 1024
"""Samples simulated at once as long as no end stop is hit."""

GENERIC_TRANSDUCER = Transducer()
"""Assumed transducer, not a real device: 60 Hz, damping ratio 0.4.

At full scale it gives 30 m/s² above the resonance, as `GENERIC_PEAK_M_S2`.
"""


@dataclass(frozen=True)
class TransducerState:
    """State of all channels, (C,) each: position [m], velocity [m/s], temperature [°C]."""

    position: Floats
    velocity: Floats
    temperature: Floats


def make_rest_state(transducer: Transducer, channels: int) -> TransducerState:
    zero = np.zeros(channels)
    return TransducerState(zero, zero, np.full(channels, transducer.ambient_c))


@dataclass(frozen=True)
class Motion:
    """Motion (n, C) at each sample, with its force already acting: position [m], acceleration [m/s²], temperature [°C].

    `end` is the state after the last sample's duration.
    """

    position: Floats
    acceleration: Floats
    temperature: Floats
    end: TransducerState


def counts_to_drive(counts: NDArray[np.int16]) -> Floats:
    """Convert counts to fractions of full scale."""
    return np.asarray(counts, dtype=np.float64) / FULL_SCALE_COUNTS


def simulate_motion(
    transducer: Transducer, drive: Floats, rate_hz: float, start: TransducerState | None = None
) -> Motion:
    """Simulate the motion and temperature of a transducer.

    Parameters
    ----------
    transducer : Transducer
        Constants of the transducer.
    drive : (n, C) array
        Fractions of full scale, each constant for one sample.
    rate_hz : float
        Sample rate [Hz].
    start : TransducerState or None
        Initial state; at rest and cool by default.

    Returns
    -------
    Motion
        Position, acceleration and temperature at each sample.
    """
    start = make_rest_state(transducer, drive.shape[1]) if start is None else start
    force = transducer.compute_force(drive)
    mechanics = make_mechanical_system(transducer, rate_hz)
    states = np.empty((len(force) + 1, 2, force.shape[1]))
    states[0] = start.position, start.velocity
    for begin in range(0, len(force), CHUNK_SAMPLES):
        block = force[begin : begin + CHUNK_SAMPLES]
        block_states = mechanics.simulate(states[begin], block)
        if np.abs(block_states[:, 0]).max() > transducer.stroke_m:
            block_states = simulate_with_stops(mechanics, states[begin], block, transducer.stroke_m)
        states[begin : begin + len(block_states)] = block_states
    return make_motion(transducer, states, force, simulate_temperature(transducer, drive, rate_hz, start.temperature))


def simulate_temperature(transducer: Transducer, drive: Floats, rate_hz: float, start_c: Floats) -> Floats:
    """Simulate the coil's temperature [°C], (n + 1, C), for a drive (n, C) from `start_c` (C,) on."""
    rise = (start_c - transducer.ambient_c)[None]
    return (
        make_thermal_system(transducer, rate_hz).simulate(rise, transducer.compute_power(drive))[:, 0]
        + transducer.ambient_c
    )


def compute_temperature_after(transducer: Transducer, drive: Floats, seconds: float, start_c: Floats) -> Floats:
    """Compute the temperature (C,) [°C] after a drive of constant RMS (C,) that lasts `seconds`."""
    final = transducer.ambient_c + transducer.thermal_k_w * transducer.compute_power(drive)
    return final + (start_c - final) * math.exp(-seconds / transducer.thermal_s)


@lru_cache(maxsize=16)
def make_mechanical_system(transducer: Transducer, rate_hz: float) -> StateSpace:
    """Make the system from force [N] to position [m] and velocity [m/s]."""
    spring, mass = transducer.stiffness_n_m, transducer.mass_kg
    transition = _compute_transition_matrix(spring / mass, transducer.damping_n_s_m / mass, 1.0 / rate_hz)
    # A constant force only moves the rest position to F / k, around which the free motion continues.
    rest = np.array([1.0 / spring, 0.0])
    return StateSpace(transition, rest - transition @ rest)


@lru_cache(maxsize=16)
def make_thermal_system(transducer: Transducer, rate_hz: float) -> StateSpace:
    """Make the system from power [W] to the temperature rise above ambient [K]."""
    decay = math.exp(-1.0 / (rate_hz * transducer.thermal_s))
    return StateSpace(np.array([[decay]]), np.array([(1.0 - decay) * transducer.thermal_k_w]))


def _compute_transition_matrix(stiffness: float, damping: float, seconds: float) -> Floats:
    """Compute exp(A t) of x″ + damping x′ + stiffness x = 0 from its roots −decay ± root, also if they coincide."""
    decay = damping / 2.0
    root = cmath.sqrt(decay * decay - stiffness)
    first, second = cmath.exp((root - decay) * seconds), cmath.exp((-root - decay) * seconds)
    even = ((first + second) / 2.0).real
    coincide = abs(root) * seconds < 1e-6
    odd = seconds * math.exp(-decay * seconds) if coincide else ((first - second) / (2.0 * root)).real
    return np.array([[even + decay * odd, odd], [-stiffness * odd, even - decay * odd]])


def simulate_with_stops(mechanics: StateSpace, start: Floats, force: Floats, stroke_m: float) -> Floats:
    """Simulate a mass between two end stops sample by sample: position and velocity (n + 1, 2, C).

    `force` (n, C) is in N; a position beyond an end stop, at ± `stroke_m` [m], rests at it.
    """
    states = [start]
    for value in force:
        position, velocity = mechanics.transition @ states[-1] + np.outer(mechanics.input_vector, value)
        stopped = np.abs(position) > stroke_m
        states.append(np.stack([np.clip(position, -stroke_m, stroke_m), np.where(stopped, 0.0, velocity)]))
    return np.asarray(states)


def make_motion(transducer: Transducer, states: Floats, force: Floats, temperature: Floats) -> Motion:
    position, velocity = states[:-1, 0], states[:-1, 1]
    net_force = force - transducer.stiffness_n_m * position - transducer.damping_n_s_m * velocity
    return Motion(
        position,
        net_force / transducer.mass_kg,
        temperature[:-1],
        TransducerState(states[-1, 0], states[-1, 1], temperature[-1]),
    )
