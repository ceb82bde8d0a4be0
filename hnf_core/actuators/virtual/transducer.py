"""A resonant transducer: what a skin would get from counts.

A moving coil on a spring, pressed onto a fingertip: m x″ = F − k x − c x′, a current that makes the force F and warms
the coil. Between samples the current is held, as a converter holds it, and what is linear is then integrated exactly:
no step is too long.

A linear system, sample by sample, by whole blocks.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ..limits import FULL_SCALE_COUNTS

Floats = NDArray[np.float64]

BLOCK_SAMPLES = 64
"""Samples that one product of matrices takes: few enough that half of each matrix being zeros costs little."""


@dataclass(frozen=True)
class StateSpace:
    """s[n+1] = A s[n] + b u[n], the exact step of a linear system whose input is held between samples.

    transition: (S, S), A. entry: (S,), b. Channels are independent of each other and share both.
    """

    transition: Floats
    input_vector: Floats

    def simulate(self, start: Floats, inputs: Floats) -> Floats:
        """start: (S, C). inputs: (n, C). Returns (n + 1, S, C): every state from start on."""
        states = np.empty((len(inputs) + 1, *start.shape))
        states[0] = start
        free, forced = self._block_matrices
        for at in range(0, len(inputs), BLOCK_SAMPLES):
            block = inputs[at : at + BLOCK_SAMPLES]
            count = len(block)
            moved = np.einsum("nst,tc->nsc", free[:count], states[at])
            states[at + 1 : at + 1 + count] = moved + np.tensordot(forced[:count, :, :count], block, axes=1)
        return states

    @cached_property
    def _block_matrices(self) -> tuple[Floats, Floats]:
        """(N, S, S): A^(n+1). (N, S, N): what the input at sample j has become in the state after sample n."""
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
    """mass_kg: all that moves, the skin's share included. stiffness_n_m, damping_n_s_m: of spring and skin.
    force_n_a: force constant. current_a: at full scale. saturation_n: force that the magnet cannot exceed. stroke_m: to
    either end stop. resistance_ohm: of the coil. thermal_k_w: kelvins per watt in the end; thermal_s: time constant.
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
        """drive: share of full scale. In newtons: proportional while small, never beyond saturation_n."""
        wanted = self.force_n_a * self.current_a * drive
        found: Floats = self.saturation_n * np.tanh(wanted / self.saturation_n)
        return found

    def compute_power(self, drive: Floats) -> Floats:
        """Watts that warm the coil."""
        found: Floats = self.resistance_ohm * np.square(self.current_a * drive)
        return found


CHUNK_SAMPLES = 1024
"""Samples that are taken at once as long as no stop is met."""

GENERIC_TRANSDUCER = Transducer()
"""An assumption, no device: 60 Hz, damping ratio 0.4, 30 m/s² at full scale above resonance (as GENERIC_PEAK_M_S2)."""


@dataclass(frozen=True)
class TransducerState:
    """(C,) each. position: m. velocity: m/s. temperature: °C."""

    position: Floats
    velocity: Floats
    temperature: Floats


def make_rest_state(transducer: Transducer, channels: int) -> TransducerState:
    zero = np.zeros(channels)
    return TransducerState(zero, zero, np.full(channels, transducer.ambient_c))


@dataclass(frozen=True)
class Motion:
    """(n, C) each, at the instant of every sample, its force already acting. position: m, acceleration: m/s²,
    temperature: °C. end: after the last sample has been held for its time."""

    position: Floats
    acceleration: Floats
    temperature: Floats
    end: TransducerState


def counts_to_drive(counts: NDArray[np.int16]) -> Floats:
    """Counts of a wire → share of full scale."""
    return np.asarray(counts, dtype=np.float64) / FULL_SCALE_COUNTS


def simulate_motion(
    transducer: Transducer, drive: Floats, rate_hz: float, start: TransducerState | None = None
) -> Motion:
    """drive: (n, C), shares of full scale, each held for one sample. start: at_rest() by default."""
    start = make_rest_state(transducer, drive.shape[1]) if start is None else start
    force = transducer.compute_force(drive)
    mechanics = make_mechanical_system(transducer, rate_hz)
    states = np.empty((len(force) + 1, 2, force.shape[1]))
    states[0] = start.position, start.velocity
    for at in range(0, len(force), CHUNK_SAMPLES):
        piece = force[at : at + CHUNK_SAMPLES]
        moved = mechanics.simulate(states[at], piece)
        if np.abs(moved[:, 0]).max() > transducer.stroke_m:
            moved = simulate_with_stops(mechanics, states[at], piece, transducer.stroke_m)
        states[at : at + len(moved)] = moved
    return make_motion(transducer, states, force, simulate_temperature(transducer, drive, rate_hz, start.temperature))


def simulate_temperature(transducer: Transducer, drive: Floats, rate_hz: float, start_c: Floats) -> Floats:
    """drive: (n, C). start_c: (C,). The coil's temperature in °C from start_c on, (n + 1, C)."""
    warmth = (start_c - transducer.ambient_c)[None]
    return (
        make_thermal_system(transducer, rate_hz).simulate(warmth, transducer.compute_power(drive))[:, 0]
        + transducer.ambient_c
    )


def compute_temperature_after(transducer: Transducer, drive: Floats, seconds: float, start_c: Floats) -> Floats:
    """(C,): the temperature after a drive whose root mean square, (C,), is held for seconds."""
    final = transducer.ambient_c + transducer.thermal_k_w * transducer.compute_power(drive)
    return final + (start_c - final) * math.exp(-seconds / transducer.thermal_s)


@lru_cache(maxsize=16)
def make_mechanical_system(transducer: Transducer, rate_hz: float) -> StateSpace:
    """Position and velocity, by force in newtons."""
    spring, mass = transducer.stiffness_n_m, transducer.mass_kg
    transition = _compute_transition_matrix(spring / mass, transducer.damping_n_s_m / mass, 1.0 / rate_hz)
    # A held force only moves the place of rest, to F / k, around which the free motion goes on.
    rest = np.array([1.0 / spring, 0.0])
    return StateSpace(transition, rest - transition @ rest)


@lru_cache(maxsize=16)
def make_thermal_system(transducer: Transducer, rate_hz: float) -> StateSpace:
    """Kelvins above the ambience, by power in watts."""
    kept = math.exp(-1.0 / (rate_hz * transducer.thermal_s))
    return StateSpace(np.array([[kept]]), np.array([(1.0 - kept) * transducer.thermal_k_w]))


def _compute_transition_matrix(stiffness: float, damping: float, seconds: float) -> Floats:
    """exp(A t) of x″ + damping x′ + stiffness x = 0, by its two roots −decay ± root; also where they are one."""
    decay = damping / 2.0
    root = cmath.sqrt(decay * decay - stiffness)
    one, other = cmath.exp((root - decay) * seconds), cmath.exp((-root - decay) * seconds)
    even = ((one + other) / 2.0).real
    together = abs(root) * seconds < 1e-6
    odd = seconds * math.exp(-decay * seconds) if together else ((one - other) / (2.0 * root)).real
    return np.array([[even + decay * odd, odd], [-stiffness * odd, even - decay * odd]])


def simulate_with_stops(mechanics: StateSpace, start: Floats, force: Floats, stroke_m: float) -> Floats:
    """Sample by sample; what would be past a stop rests at it."""
    states = [start]
    for value in force:
        position, velocity = mechanics.transition @ states[-1] + np.outer(mechanics.input_vector, value)
        stopped = np.abs(position) > stroke_m
        states.append(np.stack([np.clip(position, -stroke_m, stroke_m), np.where(stopped, 0.0, velocity)]))
    return np.asarray(states)


def make_motion(transducer: Transducer, states: Floats, force: Floats, temperature: Floats) -> Motion:
    position, velocity = states[:-1, 0], states[:-1, 1]
    pull = force - transducer.stiffness_n_m * position - transducer.damping_n_s_m * velocity
    return Motion(
        position,
        pull / transducer.mass_kg,
        temperature[:-1],
        TransducerState(states[-1, 0], states[-1, 1], temperature[-1]),
    )
