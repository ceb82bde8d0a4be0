"""From a stroke to a(t): the fast path.

The field is evaluated at the action rate, its carriers at 10 kHz, in blocks; any block is computable alone. Another
output rate is a resampling of the same signal, never another model.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..signal import Signal
from .blocks import render_samples
from .carriers import MODEL_RATE_HZ
from .emissions import Evaluate
from .extrapolation import check_ceiling, check_ranges
from .field import Field, evaluate
from .noise_ahead import prefetch_noise
from .prepared import PreparedStroke, prepare_stroke
from .resampling import resample
from .stroke import StrokeInput, Synthesis
from .timeline import resample_action

Float = NDArray[np.float64]


def synthesise(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    sample_rate: float = MODEL_RATE_HZ,
    tolerance: float | None = None,
) -> Synthesis:
    """The vibration of a stroke in m/s². The same seed gives the same bytes.

    tolerance: see prepare(). Raises StrokeError for an action without duration, UsageError for a sample rate that is
    not positive. What lies outside the field's training ranges is synthesised as it is, and named in warnings.
    """
    prepared, samples = render_stroke(field, stroke, seed, tolerance)
    return make_result_within_tolerance(field, stroke, prepared, samples, sample_rate, tolerance)


def make_result_within_tolerance(
    field: Field,
    stroke: StrokeInput,
    prepared: PreparedStroke,
    samples: Float,
    sample_rate: float,
    tolerance: float | None,
) -> Synthesis:
    """to_synthesis(), and whether the tolerance was kept."""
    made = make_result(field, stroke, prepared, samples, sample_rate)
    return replace(made, warnings=(*made.warnings, *tolerance_warning(prepared.residual_power, tolerance)))


def tolerance_warning(residual_power: float, tolerance: float | None) -> tuple[str, ...]:
    """What there is to say of a stroke that was not followed as closely as was asked for. missed: see Prepared."""
    if tolerance is None or residual_power <= tolerance**2 * (1.0 + 1e-9):
        return ()
    return (
        f"the tolerance of {20.0 * np.log10(tolerance):.0f} dB is not kept: the field changes faster along this stroke "
        f"than it is followed, which is to within about {10.0 * np.log10(residual_power):.0f} dB.",
    )


def render_stroke(
    field: Field, stroke: StrokeInput, seed: int, tolerance: float | None = None, evaluator: Evaluate = evaluate
) -> tuple[PreparedStroke, Float]:
    """prepare() and rendered(), with carriers drawn while F_Θ is evaluated."""
    with prefetch_noise(field.config, seed, resample_action(stroke)[0]):
        prepared = prepare_stroke(field, stroke, seed=seed, tolerance=tolerance, evaluator=evaluator)
    return prepared, render_samples(prepared)


def make_result(
    field: Field, stroke: StrokeInput, prepared: PreparedStroke, samples: Float, sample_rate: float = MODEL_RATE_HZ
) -> Synthesis:
    """Rendered samples (count,) as a signal, with what there is to say of it."""
    output, rate_warnings = resample(samples, MODEL_RATE_HZ, sample_rate)
    confidence, warnings = check_ranges(field, stroke, prepared.action)
    warnings += check_ceiling(field.config, float(prepared.loudest.max(initial=0.0)))
    if stroke.profile is not None and prepared.bands is None:
        warnings += ("This field has no arc-length carriers: the height profile is left out.",)
    provenance = {"probe": stroke.action.probe, "field": field.identity, "model_rate_hz": f"{MODEL_RATE_HZ:g}"}
    signal = Signal(output.astype(np.float32), float(sample_rate), prepared.seed, provenance)
    return Synthesis(signal, confidence, (*warnings, *rate_warnings))
