"""A copy for ears: as loud as a player goes without clipping, by one gain that the file states.

A signal in m/s² leaves the −1 … 1 that players take for full scale, and they cut it off hard. Such a copy is for no
actuator: how strong a touch is shows in its gain alone, and two copies are not to be compared by their loudness.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..field.resampling import resample
from ..signal import Signal
from .options import MAX_FULL_SCALE_M_S2, MIN_FULL_SCALE_M_S2, ExportOptions
from .samples import get_finite_samples
from .wav_copies import write_pcm16_wav

LISTEN_FORMAT = "listen"
LISTEN_RATE_HZ = 48_000.0
LISTEN_PEAK_DBFS = -1.0
"""What converters and players need to spare."""


def fit_full_scale(signal: Signal, options: ExportOptions) -> ExportOptions:
    """options with the full scale, m/s², that brings the signal's peak to PEAK_DBFS; as they are for silence.

    Raises FileError where a sample is not finite.
    """
    samples = get_finite_samples(signal, LISTEN_FORMAT).astype(np.float64)
    loudest = float(np.abs(resample(samples, signal.sample_rate, LISTEN_RATE_HZ)[0]).max(initial=0.0))
    if loudest == 0.0:
        return options
    full_scale = loudest * 10.0 ** (-LISTEN_PEAK_DBFS / 20.0)
    return replace(options, full_scale_m_s2=min(max(full_scale, MIN_FULL_SCALE_M_S2), MAX_FULL_SCALE_M_S2))


def write_listening_copy(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write the copy, 48 kHz and 16 bit; what was lost, in words. Raises FileError as write_copy does."""
    own = fit_full_scale(signal, options)
    gain = f"One gain for the whole file: 1 stands for {own.full_scale_m_s2:.3g} m/s². For ears, not for an actuator."
    return (gain, *write_pcm16_wav(path, signal, LISTEN_RATE_HZ, own))
