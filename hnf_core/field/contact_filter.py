"""The linear contact as a filter in time: profile height or pressing force in, acceleration out.

Stiffness follows material and load, both slow; a small bank of impulse responses, one per material and half octave of
force, is cross-faded at the action rate. Its loads are the same for every stroke, so that pressing harder in one place
changes nothing in another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..material.contact import force_response, height_response
from ..material.mechanics import Mechanics
from ..material.probe import PROBES, Probe
from .carriers import MODEL_RATE_HZ
from .modulation import interpolate, states_read

Float = NDArray[np.float64]
Response = Callable[[ArrayLike, Mechanics, Probe, ArrayLike], NDArray[np.complex128]]

LEAD, TAIL = 256, 3840
"""Samples of an impulse response kept before and after t = 0 (0.38 s: a 50 Hz contact of 5 % damping is 50 dB down)."""
_GRID = 8192
LOADS_PER_OCTAVE = 2
"""Between two loads their responses are blended: over the library's materials 0.6 % of the response's energy norm off
at worst, 0.02 % in the median (a test holds it)."""
LIGHTEST_OCTAVE = -6
"""2⁻⁶ N = 16 mN; what presses less answers alike."""
KEPT_RESPONSES = 512


@dataclass(frozen=True)
class FilterBank:
    """height, force: (B, LEAD + TAIL) impulse responses. weights: (n, B) at each state, sum 1."""

    height: Float
    force: Float
    weights: Float

    def height_term(self, height: Float, start: int) -> Float:
        """Acceleration (count,) [m/s²] of a profile height (TAIL + count + LEAD,) [m], which begins TAIL samples before
        sample `start`."""
        return self._apply(self.height, self._height_spectra, height, start)

    def force_term(self, force: Float, start: int) -> Float:
        """The same of a pressing force [N]."""
        return self._apply(self.force, self._force_spectra, force, start)

    @cached_property
    def _height_spectra(self) -> NDArray[np.complex128]:
        return np.asarray(np.fft.rfft(self.height, _GRID))

    @cached_property
    def _force_spectra(self) -> NDArray[np.complex128]:
        return np.asarray(np.fft.rfft(self.force, _GRID))

    def _apply(self, kernels: Float, spectra: NDArray[np.complex128], signal: Float, start: int) -> Float:
        count = len(signal) - LEAD - TAIL
        # A circle as long as the signal is enough: what wraps round is in the samples before `start`.
        size = 1 << (len(signal) - 1).bit_length()
        used = np.flatnonzero(np.any(self.weights[states_read(len(self.weights), start, count)] > 0.0, axis=0))
        spectrum = np.fft.rfft(signal, size)
        fades = interpolate(self.weights[:, used], start, count)
        # y(t) = Σ_τ h(τ) x(t − τ), τ from −LEAD to TAIL − 1.
        full = np.fft.irfft(spectrum * (spectra[used] if size == _GRID else np.fft.rfft(kernels[used], size)), size)
        return np.asarray(np.einsum("tb,bt->t", fades, full[:, TAIL + LEAD : TAIL + LEAD + count]))


def filter_bank(mechanics: tuple[Mechanics, ...], material: NDArray[np.int32], force: Float, probe: str) -> FilterBank:
    """Impulse responses of every different mechanics that is touched, at the loads next to those it is pressed with.

    material: (n,) index into mechanics at each state; force: (n,) N.
    """
    floor = 2.0**LIGHTEST_OCTAVE
    place = LOADS_PER_OCTAVE * np.log2(np.maximum(force, floor) / floor)
    kinds = list(dict.fromkeys(mechanics[index] for index in np.unique(material)))
    kind = np.array([kinds.index(each) if each in kinds else -1 for each in mechanics])[material]
    weights, height, pressing = [], [], []
    for index, each in enumerate(kinds):
        mine = kind == index
        levels = np.arange(np.floor(place[mine].min()), np.ceil(place[mine].max()) + 1.0)
        for level in levels:
            hat = np.where(mine, np.maximum(1.0 - np.abs(place - level), 0.0), 0.0)
            if hat.any():
                load = floor * 2.0 ** (level / LOADS_PER_OCTAVE)
                weights.append(hat)
                height.append(impulse_response(height_response, each, PROBES[probe], load))
                pressing.append(impulse_response(force_response, each, PROBES[probe], load))
    return FilterBank(np.stack(height), np.stack(pressing), np.stack(weights, axis=1))


@lru_cache(maxsize=KEPT_RESPONSES)
def impulse_response(response: Response, mechanics: Mechanics, probe: Probe, force: float) -> Float:
    """(LEAD + TAIL,) samples at the model rate from −LEAD on; no DC, and nothing above 4.8 kHz."""
    frequency = np.fft.rfftfreq(_GRID, 1.0 / MODEL_RATE_HZ)
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency - 4000.0) / 800.0, 0.0, 1.0))
    kernel = np.roll(np.fft.irfft(response(frequency, mechanics, probe, force) * taper, _GRID), LEAD)[: LEAD + TAIL]
    window = np.ones(LEAD + TAIL)
    window[:LEAD] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(LEAD) + 0.5) / LEAD)
    fade = TAIL // 4
    window[-fade:] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
    kernel = kernel * window
    # A constant force or height must give exactly nothing, also after the cut.
    kernel = kernel - window * (kernel.sum() / window.sum())
    kernel.setflags(write=False)
    return np.asarray(kernel)
