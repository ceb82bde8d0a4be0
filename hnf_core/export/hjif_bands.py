"""The bands of `.hjif`, rendered: keyframes of an effect → samples (see `hjif_read.py`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
TRANSIENT_S = 0.022
"""Of a transient: two periods of a sine (the reference software's TRANSIENT_DURATION_MS)."""


@dataclass(frozen=True)
class TickGrid:
    """The grid to render on: count samples, rate a second, with timescale ticks a second."""

    count: int
    rate: int
    timescale: int


@dataclass(frozen=True)
class EffectKeyframes:
    """An effect's keyframes. start: tick at which it begins. place: (k,) ticks after it, never falling. amplitude,
    frequency: (k,), Hz, NaN where a keyframe has none. phase: rad. shape: of its wave. low_hz, high_hz: of its band.
    linear: whether a curve goes in lines. joined: another begins exactly where this one ends. tail: ticks that it
    sounds on after its last keyframe."""

    start: int
    position: Float
    amplitude: Float
    frequency: Float
    phase: float
    shape: str
    low_hz: float = 0.0
    high_hz: float = np.inf
    linear: bool = False
    joined: bool = False
    tail: float = 0.0

    @property
    def end(self) -> float:
        """Tick at which it is over."""
        return self.start + (float(self.position[-1]) if len(self.position) else 0.0) + self.tail


def render_curve(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """(first sample, values) of a curve: lines, or cubics that are level at each keyframe."""
    known = np.isfinite(effect.amplitude)
    place, value = effect.position[known], effect.amplitude[known]
    first, at = _sample_ticks(effect, ticks)
    if len(place) == 0:
        return first, np.zeros(0)
    if effect.joined and len(at) and at[-1] >= effect.position[-1]:
        at = at[:-1]
    if effect.linear or len(place) == 1:
        return first, np.interp(at, place, value)
    after = np.clip(np.searchsorted(place, at, side="right"), 1, len(place) - 1)
    wide = np.maximum(place[after] - place[after - 1], 1e-12)
    share = np.clip((at - place[after - 1]) / wide, 0.0, 1.0)
    return first, value[after - 1] + (value[after] - value[after - 1]) * (3.0 - 2.0 * share) * share**2


def render_wave(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """(first sample, values) of a wave whose amplitude and frequency go in lines from keyframe to keyframe."""
    first, at = _sample_ticks(effect, ticks)
    if len(effect.position) == 0:
        return first, np.zeros(0)
    known = np.isfinite(effect.amplitude)
    amplitude = np.interp(at, effect.position[known], effect.amplitude[known]) if known.any() else np.ones(len(at))
    tones = np.isfinite(effect.frequency)
    cycles = np.full(len(at), effect.phase / (2.0 * np.pi))
    if tones.any():
        place = effect.position[tones] / ticks.timescale
        tone = np.clip(effect.frequency[tones], effect.low_hz, effect.high_hz)
        cycles = cycles + _integrate_frequency(at / ticks.timescale, place, tone)
    return first, amplitude * _WAVEFORMS.get(effect.shape, _sine)(cycles)


def render_transient(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """(first sample, values) of clicks: two periods of a sine at each keyframe."""
    first, at = _sample_ticks(effect, ticks)
    values = np.zeros(len(at))
    for place, amplitude in zip(effect.position, effect.amplitude, strict=True):
        inside = slice(*np.searchsorted(at, (place, place + TRANSIENT_S * ticks.timescale)))
        turn = (at[inside] - place) / (TRANSIENT_S * ticks.timescale)
        values[inside] += np.nan_to_num(amplitude) * np.sin(4.0 * np.pi * turn)
    return first, values


BAND_RENDERERS: dict[str, Callable[[EffectKeyframes, TickGrid], tuple[int, Float]]] = {
    "Curve": render_curve,
    "VectorialWave": render_wave,
    "Transient": render_transient,
}


def _sample_ticks(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """First sample of an effect within the grid, and the ticks after its start of all its samples."""
    # In whole numbers: a tick of a float grid may fall short of a keyframe that it stands on.
    first = max(0, -((-effect.start * ticks.rate) // ticks.timescale))
    stop = min(ticks.count, int(effect.end * ticks.rate // ticks.timescale) + 1)
    at = np.arange(first, max(first, stop), dtype=np.float64) * ticks.timescale / ticks.rate - effect.start
    return min(first, ticks.count), at


def _integrate_frequency(time: Float, keyframe_time: Float, keyframe_frequency: Float) -> Float:
    """Cycles from 0 to time of a frequency that goes in lines through (place, tone), and stays before and after."""
    knots = np.concatenate([[0.0], keyframe_time]) if keyframe_time[0] > 0.0 else keyframe_time
    tones = (
        np.concatenate([[keyframe_frequency[0]], keyframe_frequency]) if keyframe_time[0] > 0.0 else keyframe_frequency
    )
    area = np.concatenate([[0.0], np.cumsum(np.diff(knots) * (tones[1:] + tones[:-1]) / 2.0)])
    index = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(knots) - 1)
    here = np.interp(time, knots, tones)
    return np.asarray(area[index] + (time - knots[index]) * (tones[index] + here) / 2.0)


def _sine(cycles: Float) -> Float:
    return np.asarray(np.sin(2.0 * np.pi * cycles))


_WAVEFORMS: dict[str, Callable[[Float], Float]] = {
    "Sine": _sine,
    "Square": lambda cycles: 1.0 - 2.0 * np.round(cycles - np.floor(cycles)),
    "Triangle": lambda cycles: 1.0 - 4.0 * np.abs(np.round(cycles - 0.25) - (cycles - 0.25)),
    "SawToothUp": lambda cycles: 2.0 * (cycles - np.floor(cycles + 0.5)),
    "SawToothDown": lambda cycles: 2.0 * (np.floor(cycles + 0.5) - cycles),
}
