"""Taps, presses and releases: the whole contact along the normal, integrated where the pressing force changes fast.

Linear contact (`contact_filter`) is wrong by 20 dB and more there, because a contact softens as its load goes to 0, and
opens. The whole contact is the simulator's, on a flat surface: a mass m on a Hertzian contact in series with the
probe's spring k, depth δ = b N^(2/3) + N / k, a damper that grows with the tangent stiffness, 2ζ sqrt(m dN/dδ) (Y.
Tsuji, T. Tanaka & T. Ishida 1992, Powder Technology 71), and no pull, N ≥ 0: m z̈ = N(−z, ż) − F. It flies and lands by
itself.

`find_tap_spans` finds the spans of time around fast changes, from one state before them until all has settled. In
these, `TapRenderer` gives the response in place of the linear one. Slow changes of force never begin a span.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...action.action import ForceCurve
from ...kernel.compiled_carriers import integrate_tap
from ...kernel.loader import load_kernel
from ...material.contact_model import Mechanics, surface_stiffness_at_1n, with_defaults
from ...material.probe import Probe, get_probe
from ...progress import add_work
from ..carriers import MODEL_RATE_HZ
from ..stroke import SAMPLES_PER_STATE, STATE_FRACTIONS, catmull_rom_weights
from .contact_filter import CACHED_RESPONSES, TAIL_SAMPLES

Float = NDArray[np.float64]

FAST_CHANGE_N = 0.2
"""Change of the force within one 5 ms state from which the whole contact is integrated [N].

1 N pressed evenly in 20 ms is above it; the ready strokes, which press 2 N in 100 ms, are below.
"""
FAST_TOUCH_N = 0.05
"""The same for a state in which a contact begins or ends, where it is softest [N]."""
RELEASED_SHARE = 0.1
"""Lowest over highest force up to which a fast change between two states begins or ends a contact. Other vibrations of
a finely given force are left to its low-pass, as in a recording of the force under a moving hand."""
SETTLE_STATES = TAIL_SAMPLES // SAMPLES_PER_STATE + 1
"""States after a fast change until the linear contact takes over again, as long as its own responses last."""
RELEASE_STATES = 12
"""States in the air (60 ms) after which the hand has taken the probe up: the next touch begins at rest."""
HAND_DRAG_PER_S = 10.0
"""Drag of the hand along the normal, per mass [1/s]: it only slows free flight, far below the contact's own damping."""
FADE_IN_SAMPLES = 20
"""Samples in which a span fades in (2 ms), so that a force that changes right from its begin is not lost. It fades out
over a state."""
FADE_IN = np.minimum(np.arange(SAMPLES_PER_STATE) / FADE_IN_SAMPLES, 1.0)
PORTION_STATES = 2000
"""States that are integrated at once (10 s), so that memory for the force in between is bounded."""
HIGHEST_HALF_ANGLE = 1.0
"""Half the phase that a mode advances in a step, up to which its frequency is kept exactly [rad]."""
LEAST_STEPS, MOST_STEPS = 2, 16
"""Integration steps per 10 kHz sample, as many as the simulator takes, and most."""
LARGEST_STEP = 0.8
"""Largest time step, in units of the stiffest contact's 1/ω, or 1/(2ζω) if it is damped so much, at which the
integration is stable and accurate."""


def count_tap_steps(mechanics: Mechanics, probe: Probe) -> int:
    """Return the integration steps per 10 kHz sample that a contact takes; 0 if it is too stiff to be integrated.

    The probe's own spring, in series, bounds the stiffness of any contact.
    """
    fastest = math.sqrt(probe.stiffness_n_m / probe.mass_kg) * max(1.0, 2.0 * with_defaults(mechanics).damping_ratio)
    steps = max(LEAST_STEPS, math.ceil(fastest / (MODEL_RATE_HZ * LARGEST_STEP)))
    return steps if steps <= MOST_STEPS else 0


def describe_softened_relief(mechanics: Sequence[Mechanics], probe: Probe) -> str:
    """Return a warning if a contact is too stiff or damped to be drawn over a relief as it is; "" if none is."""
    for each in dict.fromkeys(mechanics):
        if not count_tap_steps(each, probe):
            stiff = (
                f"the {probe.name} ({probe.stiffness_n_m:g} N/m) at damping ratio {with_defaults(each).damping_ratio:g}"
            )
            return f"The relief is felt as by a softer, less damped contact: {stiff} is too stiff to be integrated."
    return ""


def describe_linear_taps(mechanics: Sequence[Mechanics], probe: Probe, when: str = "") -> str:
    """Return a warning if a contact is too stiff or too damped to be integrated; "" if all are integrated.

    when: continues "Taps".
    """
    for each in dict.fromkeys(mechanics):
        if not count_tap_steps(each, probe):
            damping = f"on a material of damping ratio {with_defaults(each).damping_ratio:g}"
            stiff = f"the {probe.name} ({probe.stiffness_n_m:g} N/m) {damping} is too stiff to be integrated"
            return f"Taps{when} are felt as by a linear contact, up to 30 dB off: {stiff}."
    return ""


@dataclass(frozen=True)
class NormalContact:
    """Constants of the whole contact of a mass along the normal.

    Attributes
    ----------
    compliance : float
        b in δ = b N^(2/3) + N / k, the surface's Hertzian compliance [m/N^(2/3)].
    inverse_spring : float
        1/k of the probe's own spring in series [m/N].
    damping : float
        Damper over the square root of the tangent stiffness, 2ζ sqrt(m) [kg^(1/2)].
    inverse_mass : float
        1/m [1/kg].
    drag : float
        HAND_DRAG_PER_S [1/s].
    dt : float
        Time step [s].
    """

    compliance: float
    inverse_spring: float
    damping: float
    inverse_mass: float
    drag: float
    dt: float

    @cached_property
    def columns(self) -> Float:
        """All constants in order, (6,), as the kernel takes them."""
        return np.array(
            [self.compliance, self.inverse_spring, self.damping, self.inverse_mass, self.drag, self.dt], np.float64
        )

    def compute_depth(self, force: float) -> float:
        """Return the depth at rest [m] under a force ≥ 0 [N]."""
        return self.compliance * math.pow(force, 2.0 / 3.0) + force * self.inverse_spring

    def compute_force(self, depth: float) -> tuple[float, float]:
        """Return the elastic force [N] and the tangent stiffness [N/m] at a depth > 0 [m].

        As `contact_dynamics.compute_contact_force` of the simulator, for one contact.
        """
        x = math.sqrt(depth / self.compliance)
        beta = x / self.compliance * self.inverse_spring
        y = math.sqrt(1.0 + beta)
        y = math.sqrt(1.0 + beta / y)
        y = math.sqrt(1.0 + beta / y)
        for _ in range(3):
            square = y * y
            y = (2.0 * square * y + beta) / (3.0 * square - 1.0)
        s = x / y
        return s * s * s, 3.0 * s / (2.0 * self.compliance + 3.0 * self.inverse_spring * s)


@lru_cache(maxsize=CACHED_RESPONSES)
def make_normal_contact(mechanics: Mechanics, probe: Probe, steps: int) -> NormalContact:
    """Make the constants of a material under a probe, at `steps` integration steps per 10 kHz sample."""
    return NormalContact(
        1.5 / surface_stiffness_at_1n(mechanics, probe),
        1.0 / probe.stiffness_n_m,
        2.0 * with_defaults(mechanics).damping_ratio * math.sqrt(probe.mass_kg),
        1.0 / probe.mass_kg,
        HAND_DRAG_PER_S,
        1.0 / (MODEL_RATE_HZ * steps),
    )


@lru_cache(maxsize=CACHED_RESPONSES)
def make_body_biquads(probe: Probe, steps: int) -> Float:
    """Make the modes of the probe's body as biquads (m, 5), b0, b1, b2, a1, a2, to be added to the tip's acceleration.

    `contact_model.body_response` by the bilinear transform at `steps` times 10 kHz, exact at each mode's own frequency.
    """
    rate, biquads = MODEL_RATE_HZ * steps, []
    for mode in probe.body_modes:
        omega = 2.0 * math.pi * mode.frequency_hz
        half_angle = min(0.5 * omega / rate, HIGHEST_HALF_ANGLE)
        twice = 2.0 * rate * half_angle / math.tan(half_angle)
        damping = 2.0 * mode.damping_ratio * omega * twice
        scale = 1.0 / (twice**2 + damping + omega**2)
        gain = -mode.gain * twice**2 * scale
        biquads.append(
            [gain, -2.0 * gain, gain, 2.0 * (omega**2 - twice**2) * scale, (twice**2 - damping + omega**2) * scale]
        )
    table = np.array(biquads, dtype=np.float64).reshape(-1, 5)
    table.setflags(write=False)
    return table


def integrate_numpy(contact: NormalContact, modes: Float, force: Float, every: int, state: Float) -> Float:
    """Integrate as the kernel's hnf_tap does: semi-implicit Euler, as the simulator. See integrate_tap."""
    z, v, dt = float(state[0]), float(state[1]), contact.dt
    biquads, memory = modes.tolist(), state[2:].reshape(-1, 2).tolist()
    out = np.empty(len(force) // every)
    for step, pressed in enumerate(force.tolist()):
        normal = 0.0
        if z < 0.0:
            normal, stiffness = contact.compute_force(-z)
            normal = max(normal - contact.damping * math.sqrt(stiffness) * v, 0.0)
        tip = (normal - pressed) * contact.inverse_mass - contact.drag * v
        v += dt * tip
        z += dt * v
        body = tip
        for (b0, b1, b2, a1, a2), past in zip(biquads, memory, strict=True):
            y = b0 * tip + past[0]
            past[0], past[1] = b1 * tip - a1 * y + past[1], b2 * tip - a2 * y
            body += y
        if step % every == 0:
            out[step // every] = body
    state[0], state[1] = z, v
    state[2:] = np.array(memory, dtype=np.float64).ravel()
    return out


class TapIntegrator:
    """Integrator of the whole contact of a probe on flat materials, continued from state to state.

    Parameters
    ----------
    mechanics
        (M,) stiffness, damping and friction of the materials.
    probe
        The probe.
    """

    def __init__(self, mechanics: Sequence[Mechanics], probe: Probe) -> None:
        counts = [count_tap_steps(each, probe) for each in dict.fromkeys(mechanics)]
        self.steps = max(counts) if all(counts) else 0
        self._mechanics, self._probe = tuple(mechanics), probe
        if self.steps:
            self._modes = make_body_biquads(probe, self.steps)
            self._state = np.zeros(2 + 2 * len(self._modes))
            self._contact = make_normal_contact(self._mechanics[0], probe, self.steps)

    @property
    def is_stable(self) -> bool:
        """False if one of the contacts is too stiff or damped for the time step; then only the linear one is there."""
        return self.steps > 0

    def start(self, force: float, material: int) -> None:
        """Put the mass at rest under a force [N] on a material."""
        self._contact = make_normal_contact(self._mechanics[material], self._probe, self.steps)
        self._state[:] = 0.0
        self._state[0] = -self._contact.compute_depth(force)

    def integrate(self, force: Float, material: int) -> Float:
        """Return the acceleration (m,) [m/s²] at 10 kHz under a force (m · steps,) [N].

        Where another material begins, its contact takes over at the same elastic force, since surfaces join without a
        step.
        """
        contact = make_normal_contact(self._mechanics[material], self._probe, self.steps)
        if contact is not self._contact:
            if self._state[0] < 0.0:
                self._state[0] = -contact.compute_depth(self._contact.compute_force(-float(self._state[0]))[0])
            self._contact = contact
        kernel = load_kernel()
        if kernel is None:
            return integrate_numpy(contact, self._modes, force, self.steps, self._state)
        return integrate_tap(kernel, contact.columns, self._modes, force, self.steps, self._state)


@lru_cache(maxsize=MOST_STEPS)
def _force_table(steps: int) -> Float:
    """Return the Catmull–Rom weights (4, SAMPLES_PER_STATE · steps) of four states, from the second to the third."""
    fraction = np.arange(SAMPLES_PER_STATE * steps) / (SAMPLES_PER_STATE * steps)
    return np.stack(catmull_rom_weights(fraction))


def interpolate_force(states: Float, steps: int) -> Float:
    """Interpolate force [N] by Catmull–Rom splines from the second to the last but one of n states, not below 0.

    Result: ((n − 3) · SAMPLES_PER_STATE · steps,). Unlike the B-spline of slow pressing, it passes through the states.
    """
    table, fine = _force_table(steps), np.zeros((len(states) - 3, SAMPLES_PER_STATE * steps))
    for tap in range(4):
        fine += states[tap : len(states) - 3 + tap, None] * table[tap]
    return np.asarray(np.maximum(fine, 0.0, out=fine).reshape(-1))


@dataclass(frozen=True)
class TapResponse:
    """Response of the whole contact to a fast change of force, in place of the linear one.

    Attributes
    ----------
    start : int
        First sample at 10 kHz; may lie before the stroke.
    samples : ndarray, shape (m,)
        Acceleration, faded in and out [m/s²].
    linear_share : ndarray, shape (m,)
        Factor on the linear response to the force, 1 less that fade.
    """

    start: int
    samples: Float
    linear_share: Float

    def apply(self, pressing: Float, start: int) -> None:
        """Replace the linear response by this one in `pressing` (count,), which begins with sample `start`."""
        low, high = max(self.start, start), min(self.start + len(self.samples), start + len(pressing))
        if low < high:
            out, own = pressing[low - start : high - start], slice(low - self.start, high - self.start)
            out *= self.linear_share[own]
            out += self.samples[own]

    def shift(self, samples: int) -> TapResponse:
        """Return the response so many samples later."""
        return TapResponse(self.start + samples, self.samples, self.linear_share)


def is_fast_change(before: float, after: float) -> bool:
    """Return True if the force changes fast from one state to the next [N]."""
    return abs(after - before) >= (FAST_TOUCH_N if min(before, after) <= 0.0 else FAST_CHANGE_N)


def find_fast_changes(force: Float, curve: ForceCurve | None = None) -> NDArray[np.intp]:
    """Return the states (k,) after which the force changes fast, before the next one.

    force: (n,) [N] at the states. curve: the force on a finer grid, if it is known.
    """
    change, in_air = np.abs(np.diff(force)), np.minimum(force[1:], force[:-1]) <= 0.0
    fast = change >= FAST_CHANGE_N
    if curve is None:
        fast |= in_air & (change >= FAST_TOUCH_N)
    else:
        # Where the force is known in between, its low-pass at the states says nothing about how a touch begins.
        lowest, highest = curve.find_extremes(np.arange(len(force)) * (SAMPLES_PER_STATE / MODEL_RATE_HZ))
        fast |= (highest - lowest >= FAST_CHANGE_N) & (lowest <= RELEASED_SHARE * highest)
        fast |= (highest >= FAST_TOUCH_N) & (lowest <= 0.0)
    return np.flatnonzero(fast)


def find_lifted_states(force: Float) -> NDArray[np.bool_]:
    """Return the states (n,) at which the hand has taken the probe up, RELEASE_STATES after its last force (n,) [N]."""
    states = np.arange(len(force))
    return np.asarray(states - np.maximum.accumulate(np.where(force > 0.0, states, -1)) >= RELEASE_STATES)


def find_tap_spans(force: Float, curve: ForceCurve | None = None) -> list[tuple[int, int]]:
    """Find the spans in which the whole contact is integrated, as their first and last states (begin, end).

    A span begins one state before a fast change, and ends SETTLE_STATES after the last one, or RELEASE_STATES after
    the hand has left the surface. begin may be −1. Arguments as of find_fast_changes.
    """
    fast = find_fast_changes(force, curve)
    if not len(fast):
        return []
    released = np.flatnonzero(find_lifted_states(force))
    spans: list[tuple[int, int]] = []
    for state in fast.tolist():
        begin, end = state - 1, state + 1 + SETTLE_STATES
        index = int(np.searchsorted(released, state + 1))
        if index < len(released):
            end = min(end, int(released[index]))
        if spans and begin < spans[-1][1]:
            spans[-1] = spans[-1][0], end
        else:
            spans.append((begin, end))
    return spans


class TapRenderer:
    """Renderer of the whole contact's response to the fast changes of a stroke's force.

    Parameters
    ----------
    mechanics
        (M,) stiffness, damping and friction.
    material
        (n,) index into mechanics at each state.
    force
        (n,) pressing force at the states, 0 out of contact [N].
    probe
        Name of the probe.
    curve
        Force on a finer grid, if it is known.
    """

    def __init__(
        self,
        mechanics: tuple[Mechanics, ...],
        material: NDArray[np.int32],
        force: Float,
        probe: str,
        curve: ForceCurve | None = None,
    ) -> None:
        self._material, self._force, self._curve = material, force, curve
        self._mechanics, self._probe = mechanics, probe
        self._spans = find_tap_spans(force, curve)
        self._rendered: dict[tuple[int, int], TapResponse] = {}

    def render(self, first: int = 0, end: int | None = None) -> tuple[TapResponse, ...]:
        """Render the spans that reach into samples first … end − 1, all by default, in order and without overlap.

        Spans that were rendered for earlier samples are not rendered again. Where a contact is too stiff to be
        integrated there are none, which `range_check.check_ranges` says.
        """
        last = (len(self._force) - 1) * SAMPLES_PER_STATE if end is None else end
        wanted = [
            each for each in self._spans if each[0] * SAMPLES_PER_STATE < last and each[1] * SAMPLES_PER_STATE > first
        ]
        if not wanted or not self._integrator.is_stable:
            return ()
        self._rendered = {each: self._rendered.get(each) or self._render_span(*each) for each in wanted}
        return tuple(self._rendered.values())

    @cached_property
    def _integrator(self) -> TapIntegrator:
        return TapIntegrator(self._mechanics, get_probe(self._probe))

    def _render_span(self, begin: int, end: int) -> TapResponse:
        """Render the span from state `begin` to state `end`, or to the end of the stroke."""
        add_work("tap_spans", item=begin)
        stop = min(end, len(self._force) - 1)
        rows = np.clip(np.arange(begin, stop + 1), 0, None)
        # Where a touch begins between two states, its material is that of the second.
        touched = np.where(self._force[rows[:-1]] > 0.0, self._material[rows[:-1]], self._material[rows[1:]])
        integrator = self._integrator
        integrator.start(float(self._interpolate_force(begin, begin + 1)[0]), int(touched[0]))
        acceleration = np.concatenate(
            [
                integrator.integrate(self._interpolate_force(begin + first, begin + following), index)
                for first, following, index in _split_materials(touched)
            ]
        )
        fade = np.ones((end - begin) * SAMPLES_PER_STATE)
        fade[:SAMPLES_PER_STATE], fade[-SAMPLES_PER_STATE:] = FADE_IN, 1.0 - STATE_FRACTIONS
        fade = fade[: len(acceleration)]
        return TapResponse(begin * SAMPLES_PER_STATE, fade * acceleration, 1.0 - fade)

    def _interpolate_force(self, first: int, following: int) -> Float:
        """Return the force at every integration step from one state to another [N]."""
        steps = self._integrator.steps
        if self._curve is None:
            states = np.clip(np.arange(first - 1, following + 2), 0, len(self._force) - 1)
            return interpolate_force(self._force[states], steps)
        step = np.arange(first * SAMPLES_PER_STATE * steps, following * SAMPLES_PER_STATE * steps)
        return self._curve.evaluate(step / (MODEL_RATE_HZ * steps))


def _split_materials(touched: NDArray[np.int32]) -> Iterator[tuple[int, int, int]]:
    """Yield (first, next, material) of each run of states on one material, PORTION_STATES long at most."""
    changes = (np.flatnonzero(np.diff(touched)) + 1).tolist()
    bounds = sorted({*range(0, len(touched), PORTION_STATES), *changes, len(touched)})
    for first, following in pairwise(bounds):
        yield first, following, int(touched[first])
