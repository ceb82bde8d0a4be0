"""Signals that the tests of exports share."""

from __future__ import annotations

import numpy as np

from hnf_core.export.options import ExportOptions
from hnf_core.signal import Signal

FACTS = {"stroke": "rub-fast", "material": "Grès ☕", "probe": "pen", "field": "abc"}
OPTIONS = ExportOptions()
ENVELOPES = ("haptic", "ahap")
"""Formats that keep strength and frequency over time."""
EXACT = ("wav", "csv", "npz")
"""Formats that keep every bit."""
WORDS = ("wav", "wav8k", "wav48k", "haptic", "ahap", "android", "csv", "npz")


def signal_of(samples: np.ndarray, rate: float = 10_000.0, seed: int = 7) -> Signal:
    return Signal(np.asarray(samples, dtype=np.float32), rate, seed, dict(FACTS))


def tone(hertz: float = 160.0, amplitude: float = 6.0, seconds: float = 0.5, rate: float = 10_000.0) -> Signal:
    time = np.arange(round(seconds * rate)) / rate
    return signal_of(amplitude * np.sin(2.0 * np.pi * hertz * time + 0.3), rate)


def texture(seconds: float = 1.0, rate: float = 10_000.0, seed: int = 0, level: float = 3.0) -> Signal:
    """Noise from 60 to 400 Hz that swells and fades, as a rub does."""
    count = round(seconds * rate)
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    hertz = np.fft.rfftfreq(count, 1.0 / rate)
    noise = np.fft.irfft(spectrum * ((hertz > 60.0) & (hertz < 400.0)), count)
    swell = 0.6 + 0.4 * np.sin(2.0 * np.pi * 3.0 * np.arange(count) / rate)
    return signal_of(level * swell * noise / noise.std(), rate)
