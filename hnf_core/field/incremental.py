"""A stroke pressed otherwise: only the samples that the change reaches are rendered again.

Equal, to the last bit, to rendering the whole stroke anew: states are evaluated and samples rendered in the same
portions, and a portion is kept only where everything it is made from is unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernel.library import single_blas_thread_without_kernel
from .audible import is_audible, split_blocks
from .blocks import render_block
from .contact_filter import LEAD_SAMPLES, TAIL_SAMPLES
from .field import Field, is_same_field
from .modulation import find_states_read
from .noise_ahead import prefetch_noise
from .prepared import PreparedStroke, prepare_stroke
from .stroke import StrokeInput, Synthesis
from .synthesis import make_result
from .timeline import SAMPLES_PER_STATE, resample_action

Float = NDArray[np.float64]

_SPLINE_STATES = 2
"""States to either side that a sample of the pressing force is made from."""


class Superseded(Exception):  # noqa: N818  # no error: something newer was asked for
    """Raised out of a synthesis whose result nobody waits for any more."""


@dataclass(frozen=True)
class RenderedStroke:
    """A synthesised stroke, kept to start from. samples: (count,) float64 m/s² at the model rate. rendered: samples
    that were rendered for it; the others were there."""

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
    """Synthesise stroke, from earlier where that helps; the signal is that of synthesise(), byte for byte.

    superseded: asked between blocks. Raises Superseded when it says yes, and what synthesise() raises.
    """
    start = earlier if earlier is not None and is_same_path(earlier, field, stroke, seed) else None
    # What is made from earlier has its carriers, and takes few of them anew.
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
    """Do the two differ in force and contact alone?"""
    mine, other = stroke, earlier.stroke
    if not is_same_field(earlier.field, field) or earlier.prepared.seed != seed or mine.mechanics != other.mechanics:
        return False
    a, b = mine.action, other.action
    if (a.rate, a.probe, len(a.speed)) != (b.rate, b.probe, len(b.speed)):
        return False
    pairs: list[tuple[NDArray[Any], NDArray[Any]]] = [
        (a.direction, b.direction), (a.speed, b.speed), (a.position, b.position), (mine.tokens, other.tokens),
        (mine.token_index, other.token_index),
    ]  # fmt: skip
    one, two = mine.profile, other.profile
    if one is not None and two is not None:
        scales = [(each.step_m, each.origin_m, each.resolved_wavelength_m) for each in (one, two)]
        if scales[0] != scales[1]:
            return False
        pairs.append((one.height, two.height))
    elif one is not two:
        return False
    return all(first is second or np.array_equal(first, second) for first, second in pairs)


def find_changed_blocks(old: PreparedStroke, new: PreparedStroke) -> list[tuple[int, int]]:
    """(start, count) of the blocks in which a sample may differ; both of the same path."""
    states = len(new.force)
    texture = _rows_differ(old.amplitude, new.amplitude)
    pressing = old.force != new.force
    height = np.zeros(states, dtype=bool)
    if new.profile_amplitude is not None and old.profile_amplitude is not None:
        height = _rows_differ(old.profile_amplitude, new.profile_amplitude)
    audible = old.audible != new.audible
    blocks = []
    for start, count in split_blocks(new.count):
        near = find_states_read(states, start, count)
        # The contact's memory: what was pressed TAIL samples ago, and the blend of its responses now.
        low = (start - TAIL_SAMPLES) // SAMPLES_PER_STATE - _SPLINE_STATES
        far = slice(max(low, 0), (start + count + LEAD_SAMPLES) // SAMPLES_PER_STATE + _SPLINE_STATES + 1)
        if audible[start : start + count].any() or (
            is_audible(new.audible[start : start + count])
            and (texture[near].any() or pressing[far].any() or height[far].any())
        ):
            blocks.append((start, count))
    return blocks


def _rows_differ(old: Float, new: Float) -> NDArray[np.bool_]:
    return np.asarray((old != new).reshape(len(new), -1).any(axis=1))
