"""Pressing, without looking ahead: the linear contact as a causal filter, block by block.

The impulse responses are those of contact_filter, but for what they hold before t = 0: its taper towards 5 kHz is made
minimum-phase (A. V. Oppenheim & R. W. Schafer, Discrete-Time Signal Processing, ch. 13: the folded cepstrum), so that
they start at t = 0. Force has nothing up there; what is left is a delay of a quarter of a sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..material.contact import force_response
from ..material.mechanics import PROBES, Mechanics, Probe
from .carriers import MODEL_RATE_HZ
from .contact_filter import LEAD, LIGHTEST_OCTAVE, LOADS_PER_OCTAVE, TAIL
from .timeline import SAMPLES_PER_STATE, smooth

Float = NDArray[np.float64]
Spectrum = NDArray[np.complex128]
Blend = dict[int, float]
"""Load level → its share."""

_GRID = 8192
_SIZE = 4096
"""Of the fast convolution: the newest block is free of wrap-around where TAIL + a block fit."""
_ROUNDING = 1e-12
"""Of the spline, which gives a constant force back to some last bits."""
_FLOOR, _FINE = 1e-3, 8
HEAVIEST_OCTAVE = 4
"""Up to 16 N responses are made ready; a heavier hand's when it comes."""
KEPT_RESPONSES = 512
_SHARE = np.arange(SAMPLES_PER_STATE) / SAMPLES_PER_STATE
# The spline between the second and the third of four states, at every sample.
_BASIS = np.stack([smooth(unit, 1.0 + _SHARE) for unit in np.eye(4)], axis=1)


class LivePressing:
    """Force states in, acceleration of the probe out, two states later: one that every state waits for the next, and
    one that the spline of the force (timeline.smooth) needs beyond it."""

    def __init__(self, mechanics: Sequence[Mechanics], probe: str) -> None:
        self._mechanics, self._probe = tuple(mechanics), PROBES[probe]
        levels = range(LIGHTEST_OCTAVE * LOADS_PER_OCTAVE, HEAVIEST_OCTAVE * LOADS_PER_OCTAVE + 1)
        for each in dict.fromkeys(self._mechanics):
            for level in levels:
                _spectrum(each, self._probe, level)
        self._history = np.zeros(TAIL + SAMPLES_PER_STATE)
        self.forget()

    def forget(self) -> None:
        """As if nothing had ever pressed."""
        self._history[:] = 0.0
        self._states = np.zeros(4)
        self._blend: tuple[Spectrum | None, Spectrum | None] = None, None

    def step(self, force: float, material: int) -> Float:
        """(SAMPLES_PER_STATE,) m/s². force: N, 0 in the air. Exactly 0 where force has not changed for TAIL samples."""
        self._states = np.append(self._states[1:], force)
        before, now = self._blend
        self._blend = now, self._response(force, material)
        history = self._history
        history[:-SAMPLES_PER_STATE] = history[SAMPLES_PER_STATE:]
        history[-SAMPLES_PER_STATE:] = _BASIS @ self._states
        highest = history.max()
        if now is None or highest - history.min() <= _ROUNDING * highest:
            return np.zeros(SAMPLES_PER_STATE)
        spectrum = np.fft.rfft(history, _SIZE)
        rendered = self._newest(spectrum * now)
        if before is None or before is now:
            return rendered
        return np.asarray(self._newest(spectrum * before) * (1.0 - _SHARE) + rendered * _SHARE)

    def _response(self, force: float, material: int) -> Spectrum:
        """The two responses next to this load, blended."""
        lightest = 2.0**LIGHTEST_OCTAVE
        place = LOADS_PER_OCTAVE * np.log2(max(force, lightest))
        level, mechanics = int(np.floor(place)), self._mechanics[material]
        share = float(place - level)
        lower = _spectrum(mechanics, self._probe, level)
        return lower if share == 0.0 else (1.0 - share) * lower + share * _spectrum(mechanics, self._probe, level + 1)

    @staticmethod
    def _newest(product: Spectrum) -> Float:
        return np.asarray(np.fft.irfft(product, _SIZE)[TAIL : TAIL + SAMPLES_PER_STATE])


@lru_cache(maxsize=KEPT_RESPONSES)
def _spectrum(mechanics: Mechanics, probe: Probe, level: int) -> Spectrum:
    spectrum = np.fft.rfft(causal_response(mechanics, probe, 2.0 ** (level / LOADS_PER_OCTAVE)), _SIZE)
    spectrum.setflags(write=False)
    return np.asarray(spectrum)


def causal_response(mechanics: Mechanics, probe: Probe, force: float) -> Float:
    """(TAIL,) samples of the response to pressing at a load, from t = 0 on; no DC, and nothing above 4.8 kHz."""
    frequency = np.fft.rfftfreq(_GRID, 1.0 / MODEL_RATE_HZ)
    whole = np.fft.irfft(force_response(frequency, mechanics, probe, force) * _taper(), _GRID)
    kernel, early = whole[:TAIL].copy(), whole[-LEAD:]
    # A thousandth is left before t = 0, for the contact itself has no band limit. Its sum and first moment go to the
    # start: slow pressing, whose response is the small difference of large terms, is then as weak as it should be.
    moment = float(early @ np.arange(-LEAD, 0))
    kernel[0] += early.sum() - moment
    kernel[1] += moment
    window, fade = np.ones(TAIL), TAIL // 4
    window[-fade:] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
    kernel = kernel * window
    return np.asarray(kernel - window * (kernel.sum() / window.sum()))


@lru_cache(maxsize=1)
def _taper() -> Spectrum:
    """contact_filter's taper, minimum-phase: (_GRID // 2 + 1,)."""
    size = _FINE * _GRID
    frequency = np.fft.rfftfreq(size, 1.0 / MODEL_RATE_HZ)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency - 4000.0) / 800.0, 0.0, 1.0))
    cepstrum = np.fft.irfft(np.log(np.maximum(taper, _FLOOR)), size)
    cepstrum[1 : size // 2] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    return np.asarray(np.exp(np.fft.rfft(cepstrum))[::_FINE])
