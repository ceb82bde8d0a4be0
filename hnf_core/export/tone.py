"""Envelopes back to acceleration: what a device that knows only strength and frequency plays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from .envelope import Envelope
from .samples import MAX_RENDERED_SAMPLES

CARRIER_DESCRIPTION = "a sine whose phase is the integral of the frequency envelope; the seed draws where it starts"
EMPHASIS_DURATION_S = 0.015
"""Length of a click, under a Hann window; the tone gives way to it. As long as Lofelt's tests of its emphasis on
Android (`core/datamodel/src/emphasis.rs`); its level is the emphasis's own."""


def render_envelope(envelope: Envelope, rate_hz: float, seed: int, *, where: str = "envelope") -> NDArray[np.float32]:
    """(n,) m/s², n = round(duration · rate_hz): amplitude(t) sin(φ₀ + 2π ∫ frequency dt), φ₀ from seed, and the clicks.

    Raises FileError where it would be longer than LONGEST_SAMPLES or a frequency reaches rate_hz / 2.
    """
    if not envelope.duration_s * rate_hz <= MAX_RENDERED_SAMPLES:
        raise FileError(
            f"{envelope.duration_s:g} s at {rate_hz:g} Hz are more than can be rendered.",
            where=where,
            remedy=f"At most {MAX_RENDERED_SAMPLES / rate_hz:.0f} s at this rate.",
        )
    highest = max([float(envelope.frequency.max()), *(each.frequency_hz for each in envelope.emphases)])
    if highest >= 0.5 * rate_hz:
        raise FileError(
            f"{rate_hz:g} Hz cannot hold its {highest:g} Hz.", where=where, remedy=f"Give more than {2 * highest:g} Hz."
        )
    time = np.arange(round(envelope.duration_s * rate_hz)) / rate_hz
    hertz = np.interp(time, envelope.time, envelope.frequency)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (hertz[1:] + hertz[:-1]))]) if len(hertz) else hertz
    start = np.random.default_rng(abs(seed)).uniform(0.0, 2.0 * np.pi)
    samples = np.interp(time, envelope.time, envelope.amplitude) * np.sin(start + 2.0 * np.pi * turned / rate_hz)
    for each in envelope.emphases:
        first = max(0, int(np.ceil((each.time_s - 0.5 * EMPHASIS_DURATION_S) * rate_hz)))
        near = slice(first, int((each.time_s + 0.5 * EMPHASIS_DURATION_S) * rate_hz) + 1)
        away = time[near] - each.time_s
        share = np.square(np.cos(np.pi * away / EMPHASIS_DURATION_S))
        burst = each.amplitude * np.cos(2.0 * np.pi * each.frequency_hz * away)
        samples[near] += share * (burst - samples[near])
    return np.asarray(samples, dtype=np.float32)
