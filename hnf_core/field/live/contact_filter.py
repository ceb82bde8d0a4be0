"""Pressing, without looking ahead: the linear contact as a causal filter, block by block.

The impulse responses are those of contact_filter, but for what they hold before t = 0: its taper towards 5 kHz is made
minimum-phase (A. V. Oppenheim & R. W. Schafer, Discrete-Time Signal Processing, ch. 13: the folded cepstrum), so that
they start at t = 0. Force has nothing up there; what is left is a delay of a quarter of a sample.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...material.contact_model import Mechanics, force_response
from ...material.probe import PROBES, Probe
from ..carriers import MODEL_RATE_HZ
from ..contact_filter import (
    CACHED_RESPONSES,
    LEAD_SAMPLES,
    LOADS_PER_OCTAVE,
    MIN_FORCE_OCTAVE,
    RESPONSE_PERIOD,
    STATE_CURVE,
    TAIL_SAMPLES,
)
from ..stroke import SAMPLES_PER_STATE, STATE_FRACTIONS

Float = NDArray[np.float64]
Spectrum = NDArray[np.complex128]
Load = tuple[int, int]
"""A material by its place, and the level of the load on it."""
Blend = tuple[tuple[Load, float], ...]
"""Shares of the responses."""

_FLOOR, _FINE = 1e-3, 8
MAX_FORCE_OCTAVE = 4
"""Up to 16 N responses are made ready; a heavier hand's when it comes."""
HISTORY_STATES = -(-(TAIL_SAMPLES + len(STATE_CURVE) - 1) // SAMPLES_PER_STATE)
"""Past force states that contribute to one sample."""


class LiveContactFilter:
    """Force states in, acceleration of the probe out, two states later: one that every state waits for the next, and
    one that the spline of the force (timeline.smooth) needs beyond it.

    Spline and response are both linear, so that what every past state still gives is known beforehand: a step is a
    product of HISTORY_STATES forces and a table.
    """

    def __init__(self, mechanics: Sequence[Mechanics], probe: str) -> None:
        self._mechanics, self._probe = tuple(mechanics), PROBES[probe]
        levels = range(MIN_FORCE_OCTAVE * LOADS_PER_OCTAVE, MAX_FORCE_OCTAVE * LOADS_PER_OCTAVE + 1)
        self._tables: dict[Load, Float] = {}
        for material in range(len(self._mechanics)):
            for level in levels:
                self._response_table((material, level))
        self._states = np.zeros(HISTORY_STATES)
        self.reset()

    def reset(self) -> None:
        """As if nothing had ever pressed."""
        self._states[:] = 0.0
        self._blends: tuple[Blend, Blend] = (), ()

    def step(self, force: float, material: int) -> Float:
        """(SAMPLES_PER_STATE,) m/s². force: N, 0 in the air. Exactly 0 where it has not changed for HISTORY_STATES."""
        states = self._states
        states[1:] = states[:-1].copy()
        states[0] = force
        before, now = self._blends
        self._blends = now, self._blend_responses(force, material)
        if not now or states.min() == states.max():
            return np.zeros(SAMPLES_PER_STATE)
        fades: dict[Load, Float] = {}
        for blend, fade in ((before or now, 1.0 - STATE_FRACTIONS), (now, STATE_FRACTIONS)):
            for load, share in blend:
                fades[load] = fades.get(load, 0.0) + share * fade
        out = np.zeros(SAMPLES_PER_STATE)
        for load, fade in fades.items():
            out += fade * (states @ self._response_table(load))
        return out

    def _response_table(self, load: Load) -> Float:
        if load not in self._tables:
            self._tables[load] = _compute_response_table(self._mechanics[load[0]], self._probe, load[1])
        return self._tables[load]

    def _blend_responses(self, force: float, material: int) -> Blend:
        """The two responses next to this load."""
        place = LOADS_PER_OCTAVE * math.log2(max(force, 2.0**MIN_FORCE_OCTAVE))
        level = math.floor(place)
        share = place - level
        upper = (((material, level + 1), share),) if share > 0.0 else ()
        return (((material, level), 1.0 - share), *upper)


@lru_cache(maxsize=CACHED_RESPONSES)
def _compute_response_table(mechanics: Mechanics, probe: Probe, level: int) -> Float:
    """(HISTORY_STATES, SAMPLES_PER_STATE): what 1 N in a state gives in the steps from its own on."""
    kernel = compute_causal_response(mechanics, probe, 2.0 ** (level / LOADS_PER_OCTAVE))
    whole = np.fft.irfft(
        np.fft.rfft(kernel, RESPONSE_PERIOD) * np.fft.rfft(STATE_CURVE, RESPONSE_PERIOD), RESPONSE_PERIOD
    )[: HISTORY_STATES * SAMPLES_PER_STATE]
    table = whole.reshape(HISTORY_STATES, SAMPLES_PER_STATE)
    table.setflags(write=False)
    return np.asarray(table)


def compute_causal_response(mechanics: Mechanics, probe: Probe, force: float) -> Float:
    """(TAIL,) samples of the response to pressing at a load, from t = 0 on; no DC, and nothing above 4.8 kHz."""
    frequency = np.fft.rfftfreq(RESPONSE_PERIOD, 1.0 / MODEL_RATE_HZ)
    whole = np.fft.irfft(force_response(frequency, mechanics, probe, force) * _minimum_phase_taper(), RESPONSE_PERIOD)
    kernel, early = whole[:TAIL_SAMPLES].copy(), whole[-LEAD_SAMPLES:]
    # A thousandth is left before t = 0, for the contact itself has no band limit. Its sum and first moment go to the
    # start: slow pressing, whose response is the small difference of large terms, is then as weak as it should be.
    moment = float(early @ np.arange(-LEAD_SAMPLES, 0))
    kernel[0] += early.sum() - moment
    kernel[1] += moment
    window, fade = np.ones(TAIL_SAMPLES), TAIL_SAMPLES // 4
    window[-fade:] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
    kernel = kernel * window
    return np.asarray(kernel - window * (kernel.sum() / window.sum()))


@lru_cache(maxsize=1)
def _minimum_phase_taper() -> Spectrum:
    """contact_filter's taper, minimum-phase: (RESPONSE_GRID // 2 + 1,)."""
    size = _FINE * RESPONSE_PERIOD
    frequency = np.fft.rfftfreq(size, 1.0 / MODEL_RATE_HZ)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency - 4000.0) / 800.0, 0.0, 1.0))
    cepstrum = np.fft.irfft(np.log(np.maximum(taper, _FLOOR)), size)
    cepstrum[1 : size // 2] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    return np.asarray(np.exp(np.fft.rfft(cepstrum))[::_FINE])
