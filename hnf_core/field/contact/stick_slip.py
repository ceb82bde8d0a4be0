"""Stick–slip: the jerks of a tip that is pulled slowly over a surface.

A pressed tip that a hand drags through its own spring sticks until the spring is wound up to static friction, slips,
and sticks again. F_Θ gives amplitudes of noise, in which such events have no place. Where friction asks for them, the
tip's motion along the stroke is therefore integrated in time as the simulator does it (`simulation.contact_dynamics`):
the probe's mass, the hand's spring and damper, LuGre friction under the load N(t), and the force along the path that
friction's fluctuation and the relief's slopes add, drawn from carriers like the field's own. Its acceleration passes
through the probe's body and is added to what the field renders, of which the motion along the stroke fades out there to
the same degree (`Condition.along_share`), so that no power is counted twice.

Where it asks for them: m a + (c + N dμ/dv) v + k x = 0 has no steady sliding where friction falls faster with speed
than the hand damps, −N dμ/dv > c. On the Stribeck curve that ends at a critical speed (`compute_critical_speed`). Above
it friction's fluctuation still slows the tip into that range at times, up to `compute_onset_speed`. Motion counts only
where it lasts (`LEAST_MOVING_STATES`), so that strokes which begin and end at rest are as they were.

Left out: fingertips, whose skin takes the bristles' place in `force_noise`; the swing of the probe across the stroke
(a hand that turns takes the spring's part along the new direction); and live touch, which has the force noise alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...action.action import Action
from ...material.contact_model import (
    FRICTION_NOISE_FORCE_EXPONENT,
    STATIC_OVER_KINETIC,
    STRIBECK_SPEED_M_S,
    Mechanics,
    body_response,
    compute_bristles,
    friction_noise_power,
    with_defaults,
)
from ...material.probe import Probe, get_probe
from ..carrier_rendering import sum_arc_carriers, sum_time_carriers
from ..carriers import MODEL_RATE_HZ, WORD_MASK, Carriers
from ..linear_contact import SPEED_FLOOR_M_S, Condition, compute_along_force
from ..stroke import SAMPLES_PER_STATE, interpolate_cubic, interpolate_cubic_samples

Float = NDArray[np.float64]

FASTEST_M_S = 20e-3
"""Speed from which a stroke never has stick–slip [m/s]."""
FADE = 1.25
"""Ratio of the speed at which stick–slip has faded out to the onset speed."""
NOISE_DEVIATIONS = 4.0
"""Standard deviations of the tip's speed, by friction's fluctuation, that the onset speed is above the critical one."""
LONGEST_WAVE_M = 20e-3
"""Longest wave of friction's fluctuation [m], that of the arc carriers. Paths over the simulator's map have the same
variance."""
LEAST_MOVING_STATES = 50
"""States of slow motion (0.25 s) from which a span counts; faster starts and stops have no time to wind up the hand."""
LONG_WINDING_S = 4.0
"""Time between two slips from which a stroke begins between them, and not with one [s]."""
SHORTEST_WAVE_M = 20e-6
"""Shortest wave of that fluctuation [m], as of the simulator's map: a slow tip would make it audible."""
FORCE_SEED = 0x571C_511B
"""Mixed into the seed of the force along the path: where stick–slip fades, it must not cancel the field's own noise."""
STEPS = 2
"""Integration steps per 10 kHz sample, as the simulator takes."""
DT = 1.0 / (MODEL_RATE_HZ * STEPS)
"""Time step [s]."""
MOST_DAMPED = 0.5
"""Decay of the hand's velocity by its damper within one step, up to which steps are short enough."""
PIECE_SAMPLES = 128 * SAMPLES_PER_STATE
"""Samples that are integrated at a time; pieces begin with the span, so that no cut elsewhere changes a bit."""
LEAD_STEPS, RESPONSE_STEPS = 32, 512
"""Steps that the low-pass looks ahead, and steps of its response together with that of the body."""


def compute_critical_speed(mechanics: Mechanics, probe: Probe, force: ArrayLike) -> Float:
    """Compute the speed below which no steady sliding is stable, for normal forces [N]; 0 where all sliding is [m/s].

    Notes
    -----
    With u = v / v_s, −N dμ/dv = 2 (s − 1) (μ N / v_s) u exp(−u²) falls below the hand's damping c at u² = −W₋₁(−2 a²)
    / 2, a = c v_s / (2 (s − 1) μ N), where W₋₁ is the lower branch of Lambert's function. Bristles are taken as stiff.
    """
    load = np.maximum(np.asarray(force, dtype=np.float64), 1e-9)
    drop = 2.0 * (STATIC_OVER_KINETIC - 1.0) * with_defaults(mechanics).friction * load
    # w − ln w = target with w = 2u² ≥ 1, by Newton from above the root of a convex function.
    damped = np.maximum(_hand_damping(probe) * STRIBECK_SPEED_M_S, 1e-9)
    target = -np.log(2.0 * np.square(damped / np.maximum(drop, 1e-30)))
    has_root = target > 1.0 + 1e-9
    target = np.where(has_root, target, 2.0)
    square = target + np.sqrt(2.0 * (target - 1.0))
    for _ in range(8):
        square -= (square - np.log(square) - target) / (1.0 - 1.0 / square)
    return np.asarray(np.where(has_root, STRIBECK_SPEED_M_S * np.sqrt(0.5 * square), 0.0))


def compute_onset_speed(mechanics: Mechanics, probe: Probe, force: ArrayLike) -> Float:
    """Compute the speed up to which stick–slip is integrated, for normal forces [N]; 0 where there is none [m/s].

    The fluctuation of friction moves a tip that slides by its standard deviation over the hand's damping.
    """
    critical = compute_critical_speed(mechanics, probe, force)
    power = friction_noise_power(1.0 / LONGEST_WAVE_M, 1e6, mechanics, force)
    spread = np.sqrt(power) / max(_hand_damping(probe), 1e-9)
    onset = np.minimum(critical + NOISE_DEVIATIONS * spread, FASTEST_M_S / FADE)
    return np.asarray(np.where(critical > 0.0, onset, 0.0))


def _hand_damping(probe: Probe) -> float:
    """Return the hand's damping sideways [N s/m]."""
    return 2.0 * probe.hand_damping_ratio * math.sqrt(probe.hand_stiffness_n_m * probe.mass_kg)


@dataclass(frozen=True)
class SlowMotion:
    """Spans of a stroke in which stick–slip is integrated.

    Attributes
    ----------
    share : ndarray, shape (n,)
        Share of the tip's motion along the stroke, in power, that is integrated at each state.
    spans : tuple of (int, int)
        First state of each span and the one after its last.
    """

    share: Float
    spans: tuple[tuple[int, int], ...]

    @property
    def along_share(self) -> Float | None:
        """Share that is left to F_Θ at each state, (n,); None if that is all of it everywhere."""
        return 1.0 - self.share if self.spans else None


def may_stick(action: Action) -> bool:
    """Return True if a stiff tip moves slowly for long enough; then `find_slow_motion` is worth asking."""
    slow = (action.speed < FASTEST_M_S) & (action.speed > 0.0)
    return get_probe(action.probe).pad is None and np.count_nonzero(slow & action.contact) >= LEAST_MOVING_STATES


def find_slow_motion(condition: Condition) -> SlowMotion:
    """Find the spans of a stroke, n states, in which stick–slip is integrated; each is in contact throughout."""
    share, probe, speed = np.zeros(len(condition.speed)), get_probe(condition.probe), condition.speed
    is_stiff = DT * _hand_damping(probe) > MOST_DAMPED * probe.mass_kg  # then the time step is too long for the hand
    if probe.pad is not None or is_stiff:
        return SlowMotion(share, ())
    slow = condition.contact & (speed < FASTEST_M_S) & (condition.force > 0.0)
    for index, mechanics in enumerate(condition.mechanics):
        rows = np.flatnonzero(slow & (condition.material == index))
        onset = compute_onset_speed(mechanics, probe, condition.force[rows])
        left = 1.0 - (speed[rows] / np.maximum(onset, 1e-9) - 1.0) / (FADE - 1.0)
        share[rows] = np.where(onset > 0.0, np.clip(left, 0.0, 1.0), 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], share > 0.0, [0]])))
    spans = []
    for begin, end in edges.reshape(-1, 2).tolist():
        if np.count_nonzero(speed[begin:end] > 0.0) >= LEAST_MOVING_STATES:
            spans.append((begin, end))
        else:
            share[begin:end] = 0.0
    return SlowMotion(share, tuple(spans))


@dataclass(frozen=True)
class SlidingContact:
    """Constants of a mass that a hand drags over a surface with LuGre friction.

    Attributes
    ----------
    friction : float
        Coulomb μ.
    bristle_step : float
        Bristle stiffness σ0 per load, times the time step [s/m].
    bristle_damping : float
        Bristle damping σ1 per load over bristle_step.
    inverse_mass : float
        1/m [1/kg].
    hand_spring, hand_damper : float
        Hand's spring [1/s²] and damper [1/s], per mass.
    """

    friction: float
    bristle_step: float
    bristle_damping: float
    inverse_mass: float
    hand_spring: float
    hand_damper: float

    def start(self, speed: float, load: float) -> list[float]:
        """Return the state of steady sliding: deflection [m] and velocity [m/s] against the hand, bristles' force."""
        extra = (STATIC_OVER_KINETIC - 1.0) * math.exp(-((speed / STRIBECK_SPEED_M_S) ** 2))
        bristles = self.friction * (1.0 + extra) * min(abs(speed) / 1e-9, 1.0)
        return [self._balance(load * bristles), 0.0, bristles]

    def start_stuck(self, speed: float, load: float, fluctuation: float) -> list[float]:
        """Return the state halfway between two slips, the tip at rest under a moving hand; units as for `integrate`.

        Steady sliding is unstable at such speeds: a stroke that began with it would begin with a jerk, long before the
        next one.
        """
        bristles = self.friction * (1.0 + 0.5 * (STATIC_OVER_KINETIC - 1.0)) * min(abs(speed) / 1e-9, 1.0)
        grip = max(load + fluctuation / max(bristles, self.friction), 0.0)
        return [self._balance(grip * bristles), -speed, bristles]

    def measure_winding(self, speed: float, load: float) -> float:
        """Return the time in which a hand at this speed winds up its spring from sliding to breaking away [s]."""
        pull = self.hand_spring * abs(speed)
        rise = self.friction * (STATIC_OVER_KINETIC - 1.0) * load * self.inverse_mass
        return rise / pull if pull > 0.0 else 0.0

    def _balance(self, force: float) -> float:
        """Return the deflection at which the hand's spring balances a friction force [N]."""
        return -force * self.inverse_mass / self.hand_spring if self.hand_spring else 0.0

    def integrate(self, velocity: Float, load: Float, fluctuation: Float, state: list[float]) -> list[float]:
        """Integrate some steps; return the acceleration against the hand at each [m/s²], and continue the state.

        velocity: of the hand [m/s]. load: normal force [N]. fluctuation: of the friction force [N]. All (steps,). The
        scheme is that of `contact_dynamics.integrate_contact` for a flat surface: backward Euler in the friction.
        """
        lateral, swing, bristles = state
        friction, extra, step = self.friction, STATIC_OVER_KINETIC - 1.0, self.bristle_step
        spring, damper, weight = DT * self.hand_spring, DT * self.hand_damper, DT * self.inverse_mass
        inverse_speed, damping, exp, out = -1.0 / STRIBECK_SPEED_M_S**2, self.bristle_damping, math.exp, []
        for hand, normal, noise in zip(velocity.tolist(), load.tolist(), fluctuation.tolist(), strict=True):
            sliding = hand + swing
            stribeck = exp(inverse_speed * sliding * sliding)
            settling = 1.0 + step * abs(sliding) / (friction * (1.0 + extra * stribeck))
            damped, gain, predicted = damping * stribeck, step / settling, bristles / settling
            grip = normal + noise / max(abs(bristles), friction)
            impulse = weight * grip if grip > 0.0 else 0.0
            after = sliding - impulse * ((1.0 + damped) * predicted - damped * bristles)
            after = (after - spring * lateral - damper * swing) / (1.0 + impulse * (1.0 + damped) * gain)
            bristles = predicted + gain * after
            change = after - sliding
            swing += change
            lateral += DT * swing
            out.append(change / DT)
        state[:] = lateral, swing, bristles
        return out


@lru_cache(maxsize=256)
def make_sliding_contact(mechanics: Mechanics, probe: Probe) -> SlidingContact:
    """Make the constants of a material under a probe."""
    known, (stiffness, damping) = with_defaults(mechanics), compute_bristles(mechanics, probe)
    return SlidingContact(
        max(known.friction, 1e-6),
        stiffness * DT,
        damping / (stiffness * DT),
        1.0 / probe.mass_kg,
        probe.hand_stiffness_n_m / probe.mass_kg,
        _hand_damping(probe) / probe.mass_kg,
    )


@lru_cache(maxsize=32)
def make_output_response(probe: Probe) -> Float:
    """Make the impulse response (RESPONSE_STEPS,), LEAD_STEPS ahead, of the low-pass to 10 kHz and the probe's body."""
    steps = np.arange(-LEAD_STEPS, LEAD_STEPS + 1)
    lowpass = np.sinc(steps / STEPS) * np.kaiser(len(steps), 6.0)
    size = 1 << 14
    body = body_response(np.fft.rfftfreq(size, DT), probe)
    response = np.fft.irfft(np.fft.rfft(lowpass / lowpass.sum(), size) * body, size)[:RESPONSE_STEPS]
    response.setflags(write=False)
    return np.asarray(response)


@dataclass(frozen=True)
class SlipResponse:
    """Acceleration along the stroke during one span of slow motion, or a part of it.

    Attributes
    ----------
    start : int
        First sample at 10 kHz.
    samples : ndarray, shape (m,)
        Acceleration [m/s²].
    """

    start: int
    samples: Float

    def apply(self, out: Float, start: int) -> None:
        """Add it to `out` (count,), which begins with sample `start`."""
        low, high = max(self.start, start), min(self.start + len(self.samples), start + len(out))
        if low < high:
            out[low - start : high - start] += self.samples[low - self.start : high - self.start]

    def shift(self, samples: int) -> SlipResponse:
        """Return the slip so many samples later."""
        return SlipResponse(self.start + samples, self.samples)


class StickSlip:
    """Integrator of a stroke's spans of slow motion; asked for samples in order, it computes each once.

    Parameters
    ----------
    condition
        The n states of the stroke.
    position
        (n,) s(t) along the path at the states [m].
    carriers
        Carriers of the field, with which the force along the path is drawn.
    seed
        Their seed.
    """

    def __init__(self, condition: Condition, position: Float, carriers: Carriers, seed: int) -> None:
        self.motion = find_slow_motion(condition)
        self._condition, self._position, self._carriers, self._seed = (
            condition,
            position,
            carriers,
            (seed ^ FORCE_SEED) & WORD_MASK,
        )
        self._probe = get_probe(condition.probe)
        self._force = np.where(condition.contact, condition.force, 0.0)
        self._next: tuple[int, int] | None = None
        self._state: list[float] = []
        self._recent = np.zeros(0)

    def render(self, first: int = 0, stop: int | None = None) -> tuple[SlipResponse, ...]:
        """Render the pieces of all spans that reach into samples first … stop − 1, by default all."""
        last = (len(self._force) - 1) * SAMPLES_PER_STATE
        stop = last if stop is None else min(stop, last)
        pieces = []
        for span, (begin, end) in enumerate(self.motion.spans):
            start, finish = begin * SAMPLES_PER_STATE, min(end * SAMPLES_PER_STATE, last)
            if start >= stop or finish <= first:
                continue
            for piece in range(-(-(finish - start) // PIECE_SAMPLES)):
                low = start + piece * PIECE_SAMPLES
                if low >= stop:
                    break
                if low + PIECE_SAMPLES > first:
                    pieces.append(SlipResponse(low, self._render_piece(span, piece, start, finish)))
        return tuple(pieces)

    def _render_piece(self, span: int, piece: int, start: int, finish: int) -> Float:
        """Render one piece of the span of samples start … finish − 1, (m,), after all pieces before it."""
        if self._next is None or self._next[0] != span or self._next[1] > piece:
            self._next, self._recent = (span, 0), np.zeros(RESPONSE_STEPS - 1 - LEAD_STEPS)
            self._state = self._start_state(start // SAMPLES_PER_STATE)
        while self._next[1] < piece:
            self._advance(self._next[1], start, finish)
            self._next = span, self._next[1] + 1
        fine = self._advance(piece, start, finish)
        self._next = span, piece + 1
        low = start + piece * PIECE_SAMPLES
        count = min(PIECE_SAMPLES, finish - low)
        samples = np.convolve(fine, make_output_response(self._probe), "valid")[: STEPS * count : STEPS]
        place = np.arange(low, low + count) / SAMPLES_PER_STATE
        samples *= np.sqrt(np.interp(place, np.arange(len(self.motion.share)), self.motion.share))
        return np.asarray(samples)

    def _start_state(self, begin: int) -> list[float]:
        """Return the motion at a span's first state: sliding, stuck, or none where the touch begins there."""
        if begin > 0 and not self._condition.contact[begin - 1]:
            return [0.0, 0.0, 0.0]
        contact, speed, load = self._get_contact(begin), float(self._condition.speed[begin]), float(self._force[begin])
        if begin == 0 and contact.measure_winding(speed, load) > LONG_WINDING_S:
            return contact.start_stuck(speed, load, float(self._draw_fluctuation(np.arange(2))[0]))
        return contact.start(speed, load)

    def _get_contact(self, row: int) -> SlidingContact:
        """Return the contact at a state."""
        return make_sliding_contact(self._condition.mechanics[self._condition.material[row]], self._probe)

    def _advance(self, piece: int, start: int, finish: int) -> Float:
        """Integrate one piece; return its steps' acceleration, with those before it that the response reads.

        The steps run LEAD_STEPS ahead of the piece's samples, and are 0 from the end of the span on.
        """
        total, size = STEPS * (finish - start), STEPS * PIECE_SAMPLES
        low, high = (piece * size + LEAD_STEPS if piece else 0), (piece + 1) * size + LEAD_STEPS
        steps = np.zeros(high - low)
        if low < total:
            steps[: min(high, total) - low] = self._integrate(start, low, min(high, total))
        fine = np.concatenate([self._recent, steps])
        self._recent = fine[1 - RESPONSE_STEPS :]
        return fine

    def _integrate(self, start: int, low: int, high: int) -> Float:
        """Integrate steps low … high − 1 after sample `start`, (high − low,) [m/s²]."""
        step = STEPS * start + np.arange(low, high + 1)
        place = step / (STEPS * SAMPLES_PER_STATE)
        velocity = np.diff(interpolate_cubic(self._position, place)) / DT
        load = np.maximum(interpolate_cubic(self._force, place[:-1]), 0.0)
        fluctuation = self._draw_fluctuation(step[:-1])
        direction, state = self._condition.direction, step[:-1] // (STEPS * SAMPLES_PER_STATE)
        bounds = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), high - low]
        acceleration: list[float] = []
        for first, following in pairwise(bounds):
            row, rows = int(state[first]), slice(first, following)
            if step[first] % (STEPS * SAMPLES_PER_STATE) == 0 and row > 0 and low + first > 0:
                along = float(direction[row] @ direction[row - 1])
                self._state[:] = (along * value for value in self._state)
            acceleration += self._get_contact(row).integrate(velocity[rows], load[rows], fluctuation[rows], self._state)
        return np.array(acceleration)

    def _draw_fluctuation(self, step: NDArray[np.int64]) -> Float:
        """Draw the fluctuation of the friction force at some consecutive steps under the hand, (steps,) [N]."""
        first, last = int(step[0]) // STEPS, int(step[-1]) // STEPS + 1
        low = max(min(first // SAMPLES_PER_STATE, len(self._force) - 2), 0)
        rows = slice(low, min(last // SAMPLES_PER_STATE + 2, len(self._force)))
        arc, time = self._compute_fluctuation_bands(rows)
        begin, count, carriers, seed = first - low * SAMPLES_PER_STATE, last + 1 - first, self._carriers, self._seed
        samples = sum_arc_carriers(
            arc, carriers, lambda octave, start, length: carriers.arc_samples(seed, octave, start, length),
            interpolate_cubic_samples(self._position, first, count), begin,
        )  # fmt: skip
        samples += sum_time_carriers(time, carriers, seed, begin, count, origin=low * SAMPLES_PER_STATE)
        return np.interp(step / STEPS, np.arange(first, last + 1), samples)

    def _compute_fluctuation_bands(self, rows: slice) -> tuple[Float, Float]:
        """Compute the fluctuation's amplitude in the arc bands (m, Ka) and in the time bands (m, Kt), at m states [N].

        Waves that are shorter than the arc carriers go to the time carriers, as in `force_noise`.
        """
        carriers, edges, limits = self._carriers, self._carriers.arc_edges(), self._carriers.time_edges()
        part, load = self._condition.rows(rows), self._force[rows, None] ** (2.0 * FRICTION_NOISE_FORCE_EXPONENT)
        pace = np.maximum(part.speed, SPEED_FLOOR_M_S)[:, None]
        still = np.square(np.minimum(part.speed / SPEED_FLOOR_M_S, 1.0))[:, None]
        arc, time = compute_along_force(part, carriers), np.zeros((len(load), carriers.time_count))
        for index, mechanics in enumerate(part.mechanics):
            at = part.material == index
            if at.any():
                arc[at] += load[at] * friction_noise_power(edges[:-1], edges[1:], mechanics, 1.0)
                low, high = (
                    np.clip(limit / pace[at], edges[-1], 1.0 / SHORTEST_WAVE_M) for limit in (limits[:-1], limits[1:])
                )
                time[at] = load[at] * still[at] * friction_noise_power(low, high, mechanics, 1.0)
        arc *= part.contact[:, None]
        return np.sqrt(arc), np.sqrt(time)
