"""A stroke over materials of which some bring a field of their own: each field hears the whole stroke, and at each
moment the one speaks whose material is touched.

At a border one fades into the other between two action samples (5 ms), with shares that sum to 1: what all of them
hear alike, such as the press of the hand, passes unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..signal import Signal
from .field import Field, is_same_field
from .stroke import StrokeInput, Synthesis
from .synthesis import synthesise
from .weights import read_trained_material

Float = NDArray[np.float64]


@dataclass(frozen=True)
class FieldStroke:
    """What one field is given of a stroke. share: (n,) 0 or 1 at each action sample, whether its material is touched;
    None = everywhere."""

    field: Field
    stroke: StrokeInput
    mask: Float | None = None


def split_by_field(field: Field, stroke: StrokeInput) -> tuple[FieldStroke, ...]:
    """field, for all materials without one of their own, and each that a material brings, where they are touched.

    A field of its own is asked as it was trained: with its own token and mechanics, and without a height under the
    path, for the relief that was recorded is in what it learned. Raises WeightsError where it names no material.
    """
    own, of_row = _find_distinct_fields(stroke.fields)
    if not own:
        return (FieldStroke(field, stroke),)
    touched = of_row[stroke.token_index]
    found = [index for index in range(-1, len(own)) if (touched == index).any()]
    return tuple(
        FieldStroke(
            field if index < 0 else own[index],
            replace(stroke, fields=()) if index < 0 else _restore_training_inputs(own[index], stroke, of_row == index),
            None if len(found) == 1 else (touched == index).astype(np.float64),
        )
        for index in found
    )


def blend(strokes: Sequence[FieldStroke], results: Sequence[Synthesis]) -> Synthesis:
    """What the parts gave, each where its material is touched. made: of each part, at one seed and sample rate."""
    if len(strokes) == 1:
        return results[0]
    first = results[0].signal
    time_s = np.arange(len(first.samples)) / first.sample_rate
    samples, weight, confidence = np.zeros(len(first.samples)), 0.0, 0.0
    for part, one in zip(strokes, results, strict=True):
        if part.mask is None:
            raise ValueError("a part that is everywhere leaves no room for another")
        at = np.arange(len(part.mask)) / part.stroke.action.rate
        samples += np.interp(time_s, at, part.mask) * one.signal.samples
        lasting = float(part.mask.sum())
        weight, confidence = weight + lasting, confidence + lasting * one.confidence
    fields = "+".join(one.signal.provenance["field"] for one in results)
    signal = Signal(
        samples.astype(np.float32), first.sample_rate, first.seed, {**first.provenance, "field": fields}
    )  # fmt: skip
    warnings = tuple(dict.fromkeys(warning for one in results for warning in one.warnings))
    return Synthesis(signal, confidence / weight, warnings)


def synthesise_by_field(field: Field, stroke: StrokeInput, *, seed: int) -> Synthesis:
    """synthesise(), with what the stroke's materials bring. Raises what that and parts_of() raise."""
    parts = split_by_field(field, stroke)
    return blend(parts, [synthesise(part.field, part.stroke, seed=seed) for part in parts])


def _find_distinct_fields(fields: Sequence[Field | None]) -> tuple[list[Field], NDArray[np.int32]]:
    """Each field once, in the order in which they are met, and (M,) which of them each material brings, −1 = none."""
    own: list[Field] = []
    of_row = np.full(len(fields), -1, dtype=np.int32)
    for row, each in enumerate(fields):
        if each is None:
            continue
        known = [index for index, other in enumerate(own) if is_same_field(each, other)]
        if not known:
            own.append(each)
        of_row[row] = known[0] if known else len(own) - 1
    return own, of_row


def _restore_training_inputs(field: Field, stroke: StrokeInput, rows: NDArray[np.bool_]) -> StrokeInput:
    material = read_trained_material(field, "the field of a material")
    tokens = np.where(rows[:, None], material.token, stroke.tokens).astype(np.float32)
    mechanics = tuple(
        material.mechanics if own else each for own, each in zip(rows, stroke.mechanics, strict=True)
    )  # fmt: skip
    return replace(stroke, tokens=tokens, mechanics=mechanics, profile=None, fields=())
