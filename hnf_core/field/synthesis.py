"""Synthesise strokes: one, one again after a change of force, or one over materials with their own fields.

`synthesise` evaluates the field within a tolerance and renders its carriers at 10 kHz in blocks, each computable alone;
another output rate is a resampling of the same signal, never another model. `render_incremental` renders a stroke that
differs in force or contact again, only where samples change, and equals a complete rendering to the last bit.
`split_by_field` and `blend` combine the fields of several materials: each field synthesises the whole stroke, and
signals are cross-faded within 5 ms where the material changes, with weights that sum to 1, so that what they have in
common (the press of the hand) is unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..kernel.loader import single_blas_thread_without_kernel
from ..signal import Signal
from .carrier_rendering import REACH_SAMPLES
from .carriers import MODEL_RATE_HZ, WORD_MASK
from .contact.contact_filter import LEAD_SAMPLES, TAIL_SAMPLES
from .contact.contact_motion import render_motion_axes
from .contact.stick_slip import SlipResponse
from .contact.taps import TapResponse
from .field import Emission, Evaluator, Field, evaluate, is_same_field
from .force_noise import get_force_noise
from .linear_contact import (
    FORCE_FLOOR_N,
    SPEED_FLOOR_M_S,
    Condition,
    compute_axis_power,
    extend_to_tones,
    time_band_power,
)
from .noise_cache import prefetch_noise
from .prepare import PreparedStroke, is_audible, prepare_stroke, split_blocks
from .range_check import check_ceiling, check_ranges
from .render import render_block, render_samples
from .resampling import resample
from .stroke import SAMPLES_PER_STATE, StrokeInput, Synthesis, resample_action
from .weights import read_trained_material

Float = NDArray[np.float64]


def synthesise(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    sample_rate: float = MODEL_RATE_HZ,
    tolerance: float | None = None,
) -> Synthesis:
    """Synthesise the vibration of a stroke; the same seed gives the same bytes.

    Parameters
    ----------
    field
        The field.
    stroke
        The stroke; values outside the training ranges are synthesised as they are, and named in the warnings.
    seed
        Seed of the carriers' noise.
    sample_rate
        Sample rate of the output [Hz].
    tolerance
        Largest RMS error due to interpolated amplitudes, relative to the RMS of the stroke; a warning says where it is
        not kept. None for DEFAULT_TOLERANCE, without a warning.

    Returns
    -------
    Synthesis
        Acceleration [m/s²], confidence and warnings.

    Raises
    ------
    StrokeError
        If the action has no duration.
    UsageError
        If the sample rate is not between 1 Hz and 10 MHz.
    """
    prepared, samples = render_stroke(field, stroke, seed, tolerance)
    return make_result(field, stroke, prepared, samples, sample_rate, tolerance)


def tolerance_warning(residual_power: float, tolerance: float | None) -> tuple[str, ...]:
    """Return a warning if adaptive evaluation did not reach its tolerance; () otherwise.

    residual_power: error power over the signal's power. tolerance: largest RMS error over RMS that was asked for, None
    if none was.
    """
    if tolerance is None or residual_power <= tolerance**2 * (1.0 + 1e-9):
        return ()
    return (
        f"the tolerance of {20.0 * np.log10(tolerance):.0f} dB is not kept: the field changes faster along this stroke "
        f"than it is followed, which is to within about {10.0 * np.log10(residual_power):.0f} dB.",
    )


def render_stroke(
    field: Field, stroke: StrokeInput, seed: int, tolerance: float | None = None, evaluator: Evaluator = evaluate
) -> tuple[PreparedStroke, Float]:
    """Prepare and render a stroke, (count,) [m/s²], with its carriers drawn while F_Θ is evaluated."""
    with prefetch_noise(field.config, seed, resample_action(stroke)[0]):
        prepared = prepare_stroke(field, stroke, seed=seed, tolerance=tolerance, evaluator=evaluator)
    return prepared, render_samples(prepared)


def make_result(
    field: Field,
    stroke: StrokeInput,
    prepared: PreparedStroke,
    samples: Float,
    sample_rate: float = MODEL_RATE_HZ,
    tolerance: float | None = None,
) -> Synthesis:
    """Build the result from samples (count,) at 10 kHz, with confidence and warnings.

    tolerance: of adaptive evaluation; a warning is added if it was exceeded.
    """
    output, rate_warnings = resample(samples, MODEL_RATE_HZ, sample_rate)
    confidence, warnings = check_ranges(field, stroke, prepared.action)
    warnings += check_ceiling(field.config, prepared.loudest)
    if stroke.profile is not None and prepared.motion is None:
        warnings += ("This field has no arc-length carriers: the height profile is left out.",)
    provenance = {"probe": stroke.action.probe, "field": field.identity, "model_rate_hz": f"{MODEL_RATE_HZ:g}"}
    signal = Signal(output.astype(np.float32), float(sample_rate), prepared.seed, provenance)
    warnings += (*rate_warnings, *tolerance_warning(prepared.residual_power, tolerance))
    if tolerance is not None and prepared.sampled is None:
        warnings += ("The tolerance has no say over this stroke: the field is evaluated at every state.",)
    return Synthesis(signal, confidence, warnings)


AXES = ("along the stroke", "across it", "along the normal")
"""Axes of `synthesise_axes`, in order."""
_AXIS_SEED_STEP = 0x9E37_79B9_7F4A_7C15
"""Difference of the seeds of two axes, whose carriers are independent."""


def synthesise_axes(
    field: Field, stroke: StrokeInput, *, seed: int, sample_rate: float = MODEL_RATE_HZ
) -> tuple[Synthesis, Synthesis, Synthesis]:
    """Synthesise the acceleration along the stroke, across it and along the normal.

    Parameters
    ----------
    field
        The field, with the linear contact and arc carriers.
    stroke
        Action and surface.
    seed
        Seed of the carriers.
    sample_rate
        Output sample rate [Hz].

    Returns
    -------
    tuple of Synthesis
        One per axis of AXES.

    Raises
    ------
    StrokeError
        If the action has no duration.
    UsageError
        If the field has no linear contact, or for an impossible sample rate.

    Notes
    -----
    The field gives the power of all axes, as DFT321 combines them; it is divided as the linear contact and friction's
    force noise divide theirs. So the power spectra of the three add up to that of `synthesise`. Pressing acts along the
    normal, a measured relief along the normal and the stroke.
    """
    if not field.config.physics or not field.config.carriers.arc_count:
        raise UsageError("these weights do not tell the axes apart.", remedy="Leave --axes out.")

    action, token_index = resample_action(stroke)

    def synthesise_axis(axis: int) -> Synthesis:
        def evaluate_axis(model: Field, condition: Condition) -> Emission:
            emission = evaluate(model, condition)
            shares = compute_axis_shares(model, condition)[axis]
            shares = extend_to_tones(shares, condition, model.config.carriers)
            return Emission(emission.alpha * np.sqrt(shares)[:, None, :], emission.sigma_dt)

        axis_seed = (seed + axis * _AXIS_SEED_STEP) & WORD_MASK
        prepared = prepare_stroke(field, stroke, seed=axis_seed, evaluator=evaluate_axis)
        if axis != len(AXES) - 1:
            prepared = replace(
                prepared,
                force=np.full_like(prepared.force, prepared.force[0]),
                course=replace(prepared.course, taps=()),
            )
        if axis != 0:
            prepared = replace(prepared, course=replace(prepared.course, slips=()))
        if prepared.motion is not None:
            along, normal = render_motion_axes(stroke, action, token_index, prepared.carriers)
            prepared = replace(prepared, motion=(along, np.zeros_like(along), normal)[axis])
        return make_result(field, stroke, prepared, render_samples(prepared), sample_rate)

    return synthesise_axis(0), synthesise_axis(1), synthesise_axis(2)


def compute_axis_shares(field: Field, condition: Condition) -> Float:
    """Compute the share (3, n, K) of each axis of AXES in the power of every carrier at n states; they add up to 1."""
    carriers, speed = field.config.carriers, np.maximum(condition.speed, SPEED_FLOOR_M_S)
    arc = compute_axis_power(condition, carriers)
    power = np.empty((len(AXES), len(speed), carriers.count))
    power[:, :, carriers.arc_slice] = arc
    power[:, :, carriers.time_slice] = [time_band_power(each, speed, carriers) for each in arc]
    if field.config.force_noise:
        force = np.maximum(condition.force, FORCE_FLOOR_N)
        for index, mechanics in enumerate(condition.mechanics):
            rows = np.flatnonzero(condition.material == index)
            if len(rows):
                power[0, rows] += get_force_noise(mechanics, condition.probe, carriers).compute_power(
                    speed[rows], force[rows]
                )
    if condition.along_share is not None:
        power[0] *= condition.along_share[:, None]
    power += _LEAST_AXIS_POWER
    return np.asarray(power / power.sum(axis=0))


_LEAST_AXIS_POWER = 1e-20
"""Power added to every axis, so that shares are defined where nothing vibrates [(m/s²)²]."""


@dataclass(frozen=True)
class FieldStroke:
    """Stroke as one of several fields synthesises it.

    mask: (n,) 1 at action samples on materials that use the field, else 0; None if that is everywhere.
    """

    field: Field
    stroke: StrokeInput
    mask: Float | None = None


def split_by_field(field: Field, stroke: StrokeInput) -> tuple[FieldStroke, ...]:
    """Split a stroke by the fields of its materials; `field` serves all materials without one.

    A material's field gets the token and mechanics it was trained with, and no height profile, because the recorded
    relief is part of what it learned. Raises WeightsError if such a field names no material.
    """
    fields, field_index = _find_distinct_fields(stroke.fields)
    if not fields:
        return (FieldStroke(field, stroke),)
    touched = field_index[stroke.token_index]
    present = [index for index in range(-1, len(fields)) if (touched == index).any()]
    return tuple(
        FieldStroke(
            field if index < 0 else fields[index],
            replace(stroke, fields=())
            if index < 0
            else _restore_training_inputs(fields[index], stroke, field_index == index),
            None if len(present) == 1 else (touched == index).astype(np.float64),
        )
        for index in present
    )


def blend(strokes: Sequence[FieldStroke], results: Sequence[Synthesis]) -> Synthesis:
    """Combine the results of split_by_field, each where its material is touched; all with one seed and sample rate."""
    if len(strokes) == 1:
        return results[0]
    first = results[0].signal
    time_s = np.arange(len(first.samples)) / first.sample_rate
    samples, weight, confidence = np.zeros(len(first.samples)), 0.0, 0.0
    for part, result in zip(strokes, results, strict=True):
        if part.mask is None:
            raise ValueError("a part without a mask covers the whole stroke")
        state_time_s = np.arange(len(part.mask)) / part.stroke.action.rate
        samples += np.interp(time_s, state_time_s, part.mask) * result.signal.samples
        state_count = float(part.mask.sum())
        weight, confidence = weight + state_count, confidence + state_count * result.confidence
    fields = "+".join(result.signal.provenance["field"] for result in results)
    signal = Signal(
        samples.astype(np.float32), first.sample_rate, first.seed, {**first.provenance, "field": fields}
    )  # fmt: skip
    warnings = tuple(dict.fromkeys(warning for result in results for warning in result.warnings))
    return Synthesis(signal, confidence / weight, warnings)


def synthesise_by_field(field: Field, stroke: StrokeInput, *, seed: int) -> Synthesis:
    """Synthesise a stroke with the fields of its materials. Raises the errors of synthesise and split_by_field."""
    parts = split_by_field(field, stroke)
    return blend(parts, [synthesise(part.field, part.stroke, seed=seed) for part in parts])


def _find_distinct_fields(fields: Sequence[Field | None]) -> tuple[list[Field], NDArray[np.int32]]:
    """Return the distinct fields in order of first occurrence, and the index (M,) of each material's, −1 for none."""
    distinct: list[Field] = []
    field_index = np.full(len(fields), -1, dtype=np.int32)
    for row, field in enumerate(fields):
        if field is None:
            continue
        known = [index for index, earlier in enumerate(distinct) if is_same_field(field, earlier)]
        if not known:
            distinct.append(field)
        field_index[row] = known[0] if known else len(distinct) - 1
    return distinct, field_index


def _restore_training_inputs(field: Field, stroke: StrokeInput, rows: NDArray[np.bool_]) -> StrokeInput:
    """Return the stroke with the token and mechanics that the field was trained with, on some materials.

    rows: (M,) True for those materials.
    """
    material = read_trained_material(field, "the field of a material")
    tokens = np.where(rows[:, None], material.token, stroke.tokens).astype(np.float32)
    mechanics = tuple(
        material.mechanics if is_own else mechanics for is_own, mechanics in zip(rows, stroke.mechanics, strict=True)
    )  # fmt: skip
    return replace(stroke, tokens=tokens, mechanics=mechanics, profile=None, fields=())


_SPLINE_STATES = 2
"""States on either side that a sample of the pressing force depends on."""


class Superseded(Exception):  # Not named an error, because a newer request is none.  # noqa: N818
    """Raised to abandon a synthesis whose result is no longer needed."""


@dataclass(frozen=True)
class RenderedStroke:
    """Synthesised stroke that a later rendering can start from.

    samples: (count,) float64 [m/s²] at the model rate. rendered_count: samples that were rendered anew for it; the
    others were copied from an earlier rendering.
    """

    field: Field
    stroke: StrokeInput
    prepared: PreparedStroke
    samples: Float
    synthesis: Synthesis
    rendered_count: int


def render_incremental(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    earlier: RenderedStroke | None = None,
    superseded: Callable[[], bool] = lambda: False,
) -> RenderedStroke:
    """Synthesise a stroke, reusing an earlier one where possible; the signal is that of synthesise, byte for byte.

    superseded: called between blocks; True raises Superseded. Also raises the errors of synthesise.
    """
    start = earlier if earlier is not None and is_same_path(earlier, field, stroke, seed) else None
    # A stroke that reuses an earlier one needs few carriers that are not cached.
    with nullcontext() if start is not None else prefetch_noise(field.config, seed, resample_action(stroke)[0]):
        prepared = prepare_stroke(field, stroke, seed=seed, earlier=None if start is None else start.prepared)
    samples = np.empty(prepared.count) if start is None else start.samples.copy()
    blocks = split_blocks(prepared.count)
    if start is not None:
        blocks = find_changed_blocks(start.prepared, prepared)
    with single_blas_thread_without_kernel():
        for first, count in blocks:
            if superseded():
                raise Superseded
            samples[first : first + count] = render_block(prepared, first, count)
    synthesis = make_result(field, stroke, prepared, samples)
    return RenderedStroke(field, stroke, prepared, samples, synthesis, sum(count for _, count in blocks))


def is_same_path(earlier: RenderedStroke, field: Field, stroke: StrokeInput, seed: int) -> bool:
    """Return True if two strokes differ in force and contact alone."""
    old = earlier.stroke
    if not is_same_field(earlier.field, field) or earlier.prepared.seed != seed or stroke.mechanics != old.mechanics:
        return False
    a, b = stroke.action, old.action
    if (a.rate, a.probe, len(a.speed)) != (b.rate, b.probe, len(b.speed)):
        return False
    pairs: list[tuple[NDArray[Any], NDArray[Any]]] = [
        (a.direction, b.direction), (a.speed, b.speed), (a.position, b.position), (stroke.tokens, old.tokens),
        (stroke.token_index, old.token_index),
    ]  # fmt: skip
    if stroke.profile is not None and old.profile is not None:
        scales = [
            (profile.step_m, profile.origin_m, profile.resolved_wavelength_m)
            for profile in (stroke.profile, old.profile)
        ]
        if scales[0] != scales[1]:
            return False
        pairs.append((stroke.profile.height, old.profile.height))
        seams = [np.zeros(0) if each.seam is None else each.seam for each in (stroke.profile, old.profile)]
        pairs.append((seams[0], seams[1]))
    elif stroke.profile is not old.profile:
        return False
    return all(first is second or np.array_equal(first, second) for first, second in pairs)


def find_changed_blocks(old: PreparedStroke, new: PreparedStroke) -> list[tuple[int, int]]:
    """Return (start, length) [samples] of the blocks in which two strokes with the same path may differ."""
    pressing = old.force != new.force
    audible = old.audible != new.audible
    if new.motion is not None and old.motion is not None:
        audible = audible | (old.motion != new.motion)
        pressing = np.zeros_like(pressing)
    for before, after in ((old.course.taps, new.course.taps), (old.course.slips, new.course.slips)):
        _mark_changed(audible, before, after)
    blocks = []
    for start, count in split_blocks(new.count):
        # The contact's response reaches TAIL_SAMPLES back and LEAD_SAMPLES ahead, and its spline some states more.
        low = (start - TAIL_SAMPLES) // SAMPLES_PER_STATE - _SPLINE_STATES
        far = slice(max(low, 0), (start + count + LEAD_SAMPLES) // SAMPLES_PER_STATE + _SPLINE_STATES + 1)
        is_changed = audible[start : start + count].any() or (
            is_audible(new.audible[start : start + count])
            and (pressing[far].any() or _amplitudes_differ(old, new, start, count))
        )
        if is_changed:
            blocks.append((start, count))
    return blocks


def _mark_changed(
    changed: NDArray[np.bool_],
    before: Sequence[TapResponse | SlipResponse],
    after: Sequence[TapResponse | SlipResponse],
) -> None:
    """Set `changed` (count,) where responses that are added to the signal differ, in place."""
    for responses, others in ((before, after), (after, before)):
        samples = {each.start: each.samples for each in others}
        for each in responses:
            other = samples.get(each.start)
            if other is None or not np.array_equal(each.samples, other):
                changed[max(each.start, 0) : max(each.start + len(each.samples), 0)] = True


def _amplitudes_differ(old: PreparedStroke, new: PreparedStroke, start: int, count: int) -> bool:
    """Return True if amplitudes that samples start … start + count − 1 are rendered from differ between two strokes."""
    low, high, parts = start - REACH_SAMPLES, start + count + REACH_SAMPLES, []
    for prepared in (old, new):
        rows = slice(
            max(int(np.searchsorted(prepared.knots, low, side="right")) - 1, 0),
            int(np.searchsorted(prepared.knots, high)) + 1,
        )
        tones = prepared.tone_amplitude
        parts.append((prepared.knots[rows], prepared.amplitude[rows], np.zeros(0) if tones is None else tones[rows]))
    return not all(np.array_equal(one, other) for one, other in zip(*parts, strict=True))
