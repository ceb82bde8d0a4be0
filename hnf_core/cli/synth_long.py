"""`hnf synth` of a stroke of minutes or hours, or at megahertz: written as it is made, in the memory of one minute."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..export.wav import write_wav_stream
from ..field.carriers import MODEL_RATE_HZ
from ..field.extrapolation import at_ceiling, examine
from ..field.field import Field
from ..field.long_stroke import PORTION, Portion, portions
from ..field.resampling import conversion, rate_warnings, resample_stream
from ..field.stroke import StrokeInput
from ..field.synthesis import fallen_short
from ..field.timeline import sample_count, states_of
from ..signal import Signal
from .progress import Progress, ProgressBar

LONG_S = 120.0
MOST_WHOLE = 2**24
"""Seconds and output samples up to which a signal is one piece, which takes a few hundred MB at most."""


@dataclass(frozen=True)
class Written:
    """What is told of a signal that is no longer in memory; fields as `hnf synth --json` names them."""

    sample_rate: float
    duration_s: float
    rms: float
    peak: float
    confidence: float
    warnings: tuple[str, ...]


def is_long(duration_s: float, rate: float) -> bool:
    """Whether a signal of this duration at `rate` Hz is to be written as it is made."""
    return duration_s > LONG_S or duration_s * rate > MOST_WHOLE


class _Meter:
    """What passes through, summed up."""

    def __init__(self) -> None:
        self.loudest, self.missed, self.square, self.peak = 0.0, 0.0, 0.0, 0.0

    def samples(self, pieces: Iterator[Portion], total: int) -> Iterator[NDArray[np.float64]]:
        bar, done = ProgressBar(), 0
        for piece in pieces:
            self.loudest, self.missed = max(self.loudest, piece.loudest), max(self.missed, piece.missed)
            yield piece.samples
            done += len(piece.samples)
            bar.show(Progress("of the signal is written", done // int(MODEL_RATE_HZ), total // int(MODEL_RATE_HZ)))
        bar.close()

    def written(self, blocks: Iterator[NDArray[np.float64]]) -> Iterator[NDArray[np.float32]]:
        for block in blocks:
            out = block.astype(np.float32)
            self.square += float(np.sum(np.square(out, dtype=np.float64)))
            self.peak = max(self.peak, float(np.max(np.abs(out), initial=0.0)))
            yield out


def write_long(
    path: Path, field: Field, stroke: StrokeInput, *, seed: int, rate: float, facts: Mapping[str, str],
    tolerance: float | None = None, portion: int = PORTION,
) -> Written:  # fmt: skip
    """Synthesise stroke into a WAV at path; the samples are those of synthesise() within 1e-6 of their RMS, or, with a
    tolerance, as near to the field's as that says.

    facts: more provenance. portion: samples made at once. Raises what synthesise() and write_wav() raise, of a signal
    too long for a WAV before anything is made; an earlier file at path is then unharmed.
    """
    action, _ = states_of(stroke)
    total, convert, meter = sample_count(action), conversion(MODEL_RATE_HZ, rate), _Meter()
    made = meter.samples(portions(field, stroke, seed=seed, length=portion, tolerance=tolerance), total)
    count = total if rate == MODEL_RATE_HZ else convert.count(total)
    origin = {"probe": action.probe, "field": field.identity, "model_rate_hz": f"{MODEL_RATE_HZ:g}"}
    head = Signal(np.zeros(0, dtype=np.float32), rate, seed, {**origin, **facts})
    write_wav_stream(path, head, count, meter.written(resample_stream(made, total, MODEL_RATE_HZ, rate)))
    confidence, warnings = examine(field, stroke, action)
    warnings += (*at_ceiling(field.config, meter.loudest), *rate_warnings(rate), *fallen_short(meter.missed, tolerance))
    rms = float(np.sqrt(meter.square / count)) if count else 0.0
    return Written(rate, count / rate, rms, meter.peak, confidence, warnings)
