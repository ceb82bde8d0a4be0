"""Actuator-ready WAV: 16-bit PCM at a device's rate, with the acceleration that its full scale stands for.

A count of 32767 is full_scale_m_s2, as on every wire of `hnf_core/actuators`; the file's LIST/INFO (ICMT) holds the
factor from a sample (−1 … 1) back to m/s², so that `read_wav` gives accelerations again. Rounded, not dithered: silence
stays silence, and equal signals give equal bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import FileError
from ..field.resampling import resample
from ..files import write_bytes
from ..signal import Signal
from .options import ExportOptions, ImportOptions
from .samples import get_finite_samples
from .shares import format_clipped
from .wav import UNITS, encode_info_chunk, read_wav, write_wav

FULL_SCALE_COUNTS = 32767
UNSTATED_UNITS = "as stored"
"""What read_wav says of a file without a unit."""
_PCM16_DIVISOR = 32768.0
"""What a 16-bit sample is divided by to lie within −1 … 1."""
_MAX_COPY_BYTES = 2**32 - 2**16


def write_native_wav(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """float32 in m/s² at the signal's own rate: nothing is lost."""
    write_wav(path, signal)
    return ()


def make_copy_writer(rate_hz: int) -> Callable[[Path, Signal, ExportOptions], tuple[str, ...]]:
    """The writer of copies at rate_hz."""

    def write(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
        return write_pcm16_wav(path, signal, float(rate_hz), options)

    return write


def write_pcm16_wav(path: Path, signal: Signal, rate_hz: float, options: ExportOptions) -> tuple[str, ...]:
    """Write signal at rate_hz as PCM; what was lost, in words. Below 0.9 of the lower Nyquist frequency the resampler
    (`field/resampling.py`) keeps amplitudes within 0.01 dB.

    Raises FileError where a sample is not finite, the file would exceed 4 GB, or the disk refuses.
    """
    samples = get_finite_samples(signal, str(path)).astype(np.float64)
    resampled, warnings = resample(samples, signal.sample_rate, rate_hz)
    share = resampled / options.full_scale_m_s2
    counts = np.clip(np.rint(share * FULL_SCALE_COUNTS), -FULL_SCALE_COUNTS, FULL_SCALE_COUNTS).astype("<i2")
    if counts.nbytes > _MAX_COPY_BYTES:
        raise FileError(f"{signal.duration_s:.0f} s are more than a WAV can hold (4 GB).", where=str(path))
    scale = options.full_scale_m_s2 * _PCM16_DIVISOR / FULL_SCALE_COUNTS
    head = struct.pack("<4sIHHIIHH", b"fmt ", 16, 1, 1, int(rate_hz), int(rate_hz) * 2, 2, 16)
    body = b"WAVE" + head + encode_info_chunk(replace(signal, sample_rate=rate_hz), scale)
    body += b"data" + struct.pack("<I", counts.nbytes)
    write_bytes(path, b"RIFF" + struct.pack("<I", len(body) + counts.nbytes) + body + counts.tobytes())
    step = options.full_scale_m_s2 / FULL_SCALE_COUNTS
    words: tuple[str, ...] = (f"Everything finer than half a step of {step:.3g} m/s² (16 bit).",)
    if rate_hz < signal.sample_rate:
        words += (f"Frequencies above {0.45 * rate_hz:.0f} Hz fade; above {0.5 * rate_hz:.0f} Hz there are none.",)
    clipped = int(np.count_nonzero(np.abs(share) > 1.0 + 0.5 / FULL_SCALE_COUNTS))
    return words + warnings + format_clipped(clipped, options)


def read_wav_with_units(path: Path) -> Signal:
    """A WAV that states its unit. Raises FileError for one that does not, and for what read_wav refuses."""
    signal = read_wav(path)
    if signal.provenance.get("units") == UNSTATED_UNITS:
        raise FileError(
            "states no unit, so that nobody knows how strong it is.",
            where=str(path),
            remedy=f"Say it once: hnf import {path.name} --full-scale 30 --out IN_M_S2.wav, and export that.",
        )
    return signal


def read_wav_scaled(path: Path, options: ImportOptions) -> Signal:
    """A WAV of this project as it was; any other one times options.full_scale_m_s2.

    Raises FileError for a file that states no unit where options give no full scale, and for what read_wav refuses.
    """
    signal = read_wav(path)
    if signal.provenance.get("units") != UNSTATED_UNITS:
        return signal
    if options.full_scale_m_s2 is None:
        raise FileError(
            "states no unit, so that nobody knows how strong it is.",
            where=str(path),
            remedy=f"Say how many {UNITS} a sample of 1.0 stands for: --full-scale 30 (1 for a float file in m/s²).",
        )
    with np.errstate(over="ignore"):
        samples = (signal.samples.astype(np.float64) * options.full_scale_m_s2).astype(np.float32)
    if not np.isfinite(samples).all():
        raise FileError("its samples are beyond all measure.", where=str(path), remedy="Give a smaller full scale.")
    facts = {**signal.provenance, "units": UNITS, "scale": f"1 = {options.full_scale_m_s2:g} m/s² (told)"}
    return Signal(samples, signal.sample_rate, signal.seed, facts)
