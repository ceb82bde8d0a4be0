"""`hnf synth` of a stroke of minutes or hours, or at megahertz: written as it is made, in the memory of one minute."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..export.wav import write_wav_stream
from ..field.carriers import MODEL_RATE_HZ
from ..field.extrapolation import check_ceiling, check_ranges
from ..field.field import Field
from ..field.long_stroke import CHUNK_SAMPLES, RenderedChunk, render_chunks
from ..field.resampling import plan_conversion, rate_warnings, resample_stream
from ..field.stroke import StrokeInput
from ..field.synthesis import tolerance_warning
from ..field.timeline import resample_action, sample_count
from ..signal import Signal
from .progress import Progress, ProgressBar

MAX_IN_MEMORY_S = 120.0
MAX_IN_MEMORY_SAMPLES = 2**24
"""Seconds and output samples up to which a signal is one piece, which takes a few hundred MB at most."""


@dataclass(frozen=True)
class WrittenSignal:
    """What is told of a signal that is no longer in memory; fields as `hnf synth --json` names them."""

    sample_rate: float
    duration_s: float
    rms: float
    peak: float
    confidence: float
    warnings: tuple[str, ...]


def is_long(duration_s: float, rate: float) -> bool:
    """Whether a signal of this duration at `rate` Hz is to be written as it is made."""
    return duration_s > MAX_IN_MEMORY_S or duration_s * rate > MAX_IN_MEMORY_SAMPLES


class _SignalMeter:
    """What passes through, summed up."""

    def __init__(self) -> None:
        self.max_amplitude, self.max_residual, self.square, self.peak = 0.0, 0.0, 0.0, 0.0

    def iterate_samples(self, chunks: Iterator[RenderedChunk], total: int) -> Iterator[NDArray[np.float64]]:
        bar, done = ProgressBar(), 0
        for piece in chunks:
            self.max_amplitude, self.max_residual = (
                max(self.max_amplitude, piece.loudest),
                max(self.max_residual, piece.residual_power),
            )
            yield piece.samples
            done += len(piece.samples)
            bar.show(Progress("of the signal is written", done // int(MODEL_RATE_HZ), total // int(MODEL_RATE_HZ)))
        bar.close()

    def convert_blocks(self, blocks: Iterator[NDArray[np.float64]]) -> Iterator[NDArray[np.float32]]:
        for block in blocks:
            out = block.astype(np.float32)
            self.square += float(np.sum(np.square(out, dtype=np.float64)))
            self.peak = max(self.peak, float(np.max(np.abs(out), initial=0.0)))
            yield out


def write_in_chunks(
    path: Path, field: Field, stroke: StrokeInput, *, seed: int, rate: float, facts: Mapping[str, str],
    tolerance: float | None = None, chunk_samples: int = CHUNK_SAMPLES,
) -> WrittenSignal:  # fmt: skip
    """Synthesise stroke into a WAV at path; the samples are those of synthesise() within 1e-6 of their RMS, or, with a
    tolerance, as near to the field's as that says.

    facts: more provenance. portion: samples made at once. Raises what synthesise() and write_wav() raise, of a signal
    too long for a WAV before anything is made; an earlier file at path is then unharmed.
    """
    action, _ = resample_action(stroke)
    total, convert, meter = sample_count(action), plan_conversion(MODEL_RATE_HZ, rate), _SignalMeter()
    made = meter.iterate_samples(
        render_chunks(field, stroke, seed=seed, length=chunk_samples, tolerance=tolerance), total
    )
    count = total if rate == MODEL_RATE_HZ else convert.count_outputs(total)
    origin = {"probe": action.probe, "field": field.identity, "model_rate_hz": f"{MODEL_RATE_HZ:g}"}
    head = Signal(np.zeros(0, dtype=np.float32), rate, seed, {**origin, **facts})
    write_wav_stream(path, head, count, meter.convert_blocks(resample_stream(made, total, MODEL_RATE_HZ, rate)))
    confidence, warnings = check_ranges(field, stroke, action)
    warnings += (
        *check_ceiling(field.config, meter.max_amplitude),
        *rate_warnings(rate),
        *tolerance_warning(meter.max_residual, tolerance),
    )
    rms = float(np.sqrt(meter.square / count)) if count else 0.0
    return WrittenSignal(rate, count / rate, rms, meter.peak, confidence, warnings)
