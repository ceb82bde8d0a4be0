"""Pressing force through the linear contact as a causal filter, state by state.

The impulse responses are those of contact/contact_filter.py, except for their part before t = 0: the taper to 5 kHz
is made minimum-phase (A. V. Oppenheim & R. W. Schafer, Discrete-Time Signal Processing, ch. 13: the folded cepstrum),
so that they start at t = 0. Force has nothing at these frequencies, and the remaining difference is a delay of a
quarter of a sample.

Fast changes of force go through the whole contact, in the same spans and by the same integrator as offline.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...material.contact_model import Mechanics, force_response
from ...material.probe import Probe, get_probe
from ..carriers import MODEL_RATE_HZ
from ..contact.contact_filter import (
    CACHED_RESPONSES,
    LEAD_SAMPLES,
    LOADS_PER_OCTAVE,
    MIN_FORCE_OCTAVE,
    RESPONSE_PERIOD,
    STATE_CURVE,
    TAIL_SAMPLES,
)
from ..contact.taps import (
    FADE_IN,
    RELEASE_STATES,
    SETTLE_STATES,
    TapIntegrator,
    describe_linear_taps,
    interpolate_force,
    is_fast_change,
)
from ..stroke import SAMPLES_PER_STATE, STATE_FRACTIONS

Float = NDArray[np.float64]
Spectrum = NDArray[np.complex128]
Load = tuple[int, int]
"""Index of a material, and level of the load on it."""
Blend = tuple[tuple[Load, float], ...]
"""Responses with their weights."""

_FLOOR, _FINE = 1e-3, 8
MAX_FORCE_OCTAVE = 4
"""Exponent of the largest load (16 N) whose response is computed in advance; heavier ones are when they occur."""
HISTORY_STATES = -(-(TAIL_SAMPLES + len(STATE_CURVE) - 1) // SAMPLES_PER_STATE)
"""Past force states that contribute to one sample."""


class LiveContactFilter:
    """Filter from the pressing force, one value per 5 ms state, to the probe's acceleration two states later.

    One state of delay is that of every state, the other is due to the spline of the force (stroke.evaluate_bspline),
    which needs the state beyond. Spline and response are linear, so that a step is a product of HISTORY_STATES forces
    and a table. Where the force changes fast, the whole contact is integrated in place of it (`taps.TapResponse`).
    """

    def __init__(self, mechanics: Sequence[Mechanics], probe: str) -> None:
        self._mechanics, self._probe = tuple(mechanics), get_probe(probe)
        levels = range(MIN_FORCE_OCTAVE * LOADS_PER_OCTAVE, MAX_FORCE_OCTAVE * LOADS_PER_OCTAVE + 1)
        self._tables: dict[Load, Float] = {}
        for material in range(len(self._mechanics)):
            for level in levels:
                self._response_table((material, level))
        self._states = np.zeros(HISTORY_STATES)
        self._whole_contact = TapIntegrator(self._mechanics, self._probe)
        problem = describe_linear_taps(self._mechanics, self._probe)
        self.warnings = (problem,) if problem else ()
        self.reset()

    def reset(self) -> None:
        """Forget the past, as if nothing had ever pressed."""
        self._states[:] = 0.0
        self._blends: tuple[Blend, Blend] = (), ()
        self._touched = [0, 0, 0]  # materials of the last states, the newest first
        self._states_in_air, self._tap_states = 0, 0

    def step(self, force: float, material: int) -> Float:
        """Return the acceleration (SAMPLES_PER_STATE,) [m/s²] after another state of force [N], 0 in the air.

        It is exactly 0 if the force has not changed for HISTORY_STATES.
        """
        states = self._states
        states[1:] = states[:-1].copy()
        states[0] = force
        self._touched = [material, *self._touched[:2]]
        self._states_in_air = 0 if force > 0.0 else self._states_in_air + 1
        return self._replace_in_taps(self._compute_linear(force, material))

    def _replace_in_taps(self, linear: Float) -> Float:
        """Return the response of the whole contact within a tap's span, else the linear one; fade between them."""
        states, begins = self._states, self._tap_states == 0
        if is_fast_change(float(states[1]), float(states[0])):
            # The samples are two states late, so that the span lasts from before the change.
            self._tap_states = SETTLE_STATES + 2
        elif self._states_in_air >= RELEASE_STATES:
            self._tap_states = min(self._tap_states, 2)
        if self._tap_states == 0 or not self._whole_contact.is_stable:
            return linear
        force = interpolate_force(states[3::-1], self._whole_contact.steps)
        material = self._touched[2] if states[2] > 0.0 else self._touched[1]
        if begins:
            self._whole_contact.start(float(force[0]), material)
        whole, fade = self._whole_contact.integrate(force, material), np.ones(SAMPLES_PER_STATE)
        if begins:
            fade = FADE_IN
        elif self._tap_states == 1:
            fade = 1.0 - STATE_FRACTIONS
        self._tap_states -= 1
        return np.asarray((1.0 - fade) * linear + fade * whole)

    def _compute_linear(self, force: float, material: int) -> Float:
        """Return the linear response (SAMPLES_PER_STATE,) [m/s²] to the states in memory."""
        states = self._states
        previous, current = self._blends
        self._blends = current, self._blend_responses(force, material)
        if not current or states.min() == states.max():
            return np.zeros(SAMPLES_PER_STATE)
        fades: dict[Load, Float] = {}
        for blend, fade in ((previous or current, 1.0 - STATE_FRACTIONS), (current, STATE_FRACTIONS)):
            for load, weight in blend:
                fades[load] = fades.get(load, 0.0) + weight * fade
        out = np.zeros(SAMPLES_PER_STATE)
        for load, fade in fades.items():
            out += fade * (states @ self._response_table(load))
        return out

    def _response_table(self, load: Load) -> Float:
        """Return the response table of a material under a load, computed if it is missing."""
        if load not in self._tables:
            self._tables[load] = _compute_response_table(self._mechanics[load[0]], self._probe, load[1])
        return self._tables[load]

    def _blend_responses(self, force: float, material: int) -> Blend:
        """Return the response tables at the two tabulated loads next to `force` [N], with their weights."""
        position = LOADS_PER_OCTAVE * math.log2(max(force, 2.0**MIN_FORCE_OCTAVE))
        level = math.floor(position)
        fraction = position - level
        upper = (((material, level + 1), fraction),) if fraction > 0.0 else ()
        return (((material, level), 1.0 - fraction), *upper)


@lru_cache(maxsize=CACHED_RESPONSES)
def _compute_response_table(mechanics: Mechanics, probe: Probe, level: int) -> Float:
    """Compute the acceleration (HISTORY_STATES, SAMPLES_PER_STATE) that 1 N in one state causes from its step on.

    level: number of the tabulated load, which is 2^(level / LOADS_PER_OCTAVE) N.
    """
    kernel = compute_causal_response(mechanics, probe, 2.0 ** (level / LOADS_PER_OCTAVE))
    response = np.fft.irfft(
        np.fft.rfft(kernel, RESPONSE_PERIOD) * np.fft.rfft(STATE_CURVE, RESPONSE_PERIOD), RESPONSE_PERIOD
    )[: HISTORY_STATES * SAMPLES_PER_STATE]
    table = response.reshape(HISTORY_STATES, SAMPLES_PER_STATE)
    table.setflags(write=False)
    return np.asarray(table)


def compute_causal_response(mechanics: Mechanics, probe: Probe, force: float) -> Float:
    """Compute the causal response (TAIL_SAMPLES,) of acceleration to an impulse of the pressing force, [m/s² per N].

    force: load about which the contact's stiffness is linearized [N].
    """
    frequency = np.fft.rfftfreq(RESPONSE_PERIOD, 1.0 / MODEL_RATE_HZ)
    periodic = np.fft.irfft(
        force_response(frequency, mechanics, probe, force) * _minimum_phase_taper(), RESPONSE_PERIOD
    )
    kernel, early = periodic[:TAIL_SAMPLES].copy(), periodic[-LEAD_SAMPLES:]
    # A thousandth is left before t = 0, because the contact itself has no band limit. Its sum and first moment are
    # added at the start, so that slow pressing, the small difference of large terms, stays as weak as it should be.
    moment = float(early @ np.arange(-LEAD_SAMPLES, 0))
    kernel[0] += early.sum() - moment
    kernel[1] += moment
    window, fade = np.ones(TAIL_SAMPLES), TAIL_SAMPLES // 4
    window[-fade:] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
    kernel = kernel * window
    return np.asarray(kernel - window * (kernel.sum() / window.sum()))


@lru_cache(maxsize=1)
def _minimum_phase_taper() -> Spectrum:
    """Return the low-pass taper (4 to 4.8 kHz) of contact_filter with minimum phase, (RESPONSE_PERIOD // 2 + 1,)."""
    size = _FINE * RESPONSE_PERIOD
    frequency = np.fft.rfftfreq(size, 1.0 / MODEL_RATE_HZ)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency - 4000.0) / 800.0, 0.0, 1.0))
    cepstrum = np.fft.irfft(np.log(np.maximum(taper, _FLOOR)), size)
    cepstrum[1 : size // 2] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    return np.asarray(np.exp(np.fft.rfft(cepstrum))[::_FINE])
