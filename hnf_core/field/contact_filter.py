"""The linear contact as a filter in time: profile height or pressing force in, acceleration out.

Stiffness follows material and load, both slow; a small bank of impulse responses, one per material and octave of
force, is cross-faded at the action rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..material.contact import force_response, height_response
from ..material.mechanics import PROBES, Mechanics, Probe
from .carriers import MODEL_RATE_HZ
from .linear_contact import FORCE_FLOOR_N
from .modulation import interpolate

Float = NDArray[np.float64]
Response = Callable[[ArrayLike, Mechanics, Probe, ArrayLike], NDArray[np.complex128]]

LEAD, TAIL = 256, 3840
"""Samples of an impulse response kept before and after t = 0 (0.38 s: a 50 Hz contact of 5 % damping is 50 dB down)."""
_GRID = 8192
FORCE_RATIO = 2.0
_LEVELS = 6


@dataclass(frozen=True)
class FilterBank:
    """height, force: (B, LEAD + TAIL) impulse responses. weights: (n, B) at each state, sum 1."""

    height: Float
    force: Float
    weights: Float

    def apply(self, kernels: Float, signal: Float, start: int) -> Float:
        """Filter signal (TAIL + count + LEAD,), which begins TAIL samples before sample `start`; (count,) m/s²."""
        count = len(signal) - LEAD - TAIL
        size = 1 << (len(signal) + kernels.shape[1] - 1).bit_length()
        used = np.flatnonzero(np.any(self.weights > 0.0, axis=0))
        spectrum = np.fft.rfft(signal, size)
        fades = interpolate(self.weights[:, used], start, count)
        out = np.zeros(count)
        for column, index in enumerate(used):
            # y(t) = Σ_τ h(τ) x(t − τ), τ from −LEAD to TAIL − 1.
            full = np.fft.irfft(spectrum * np.fft.rfft(kernels[index], size), size)
            out += fades[:, column] * full[TAIL + LEAD : TAIL + LEAD + count]
        return out


def filter_bank(
    mechanics: tuple[Mechanics, ...],
    material: NDArray[np.int32],
    force: Float,
    probe: str,
    *,
    ratio: float = FORCE_RATIO,
    levels: int = _LEVELS,
) -> FilterBank:
    """Impulse responses for `levels` loads from the strongest force down by `ratio` each, for every material used.

    material: (n,) index at each state; force: (n,) N.
    """
    top = max(float(force.max(initial=0.0)), FORCE_FLOOR_N)
    loads = top / ratio ** np.arange(levels)
    position = np.clip(np.log(top / np.maximum(force, 1e-9)) / np.log(ratio), 0.0, levels - 1.0)
    hat = np.maximum(1.0 - np.abs(position[:, None] - np.arange(levels)), 0.0)
    weights, height, pressing = [], [], []
    for index in np.unique(material):
        for level, load in enumerate(loads):
            weights.append(hat[:, level] * (material == index))
            height.append(impulse_response(height_response, mechanics[index], PROBES[probe], load))
            pressing.append(impulse_response(force_response, mechanics[index], PROBES[probe], load))
    return FilterBank(np.stack(height), np.stack(pressing), np.stack(weights, axis=1))


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
    return np.asarray(kernel - window * (kernel.sum() / window.sum()))
