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

from ..kernel.library import one_blas_thread_in_numpy
from .audible import blocks_of, is_heard
from .blocks import render_block
from .contact_filter import LEAD, TAIL
from .field import Field, same_field
from .modulation import states_read
from .noise_ahead import noise_ahead
from .prepared import Prepared, prepare
from .stroke import StrokeInput, Synthesis
from .synthesis import to_synthesis
from .timeline import SAMPLES_PER_STATE, states_of

Float = NDArray[np.float64]

_SPLINE_STATES = 2
"""States to either side that a sample of the pressing force is made from."""


class Superseded(Exception):  # noqa: N818  # no error: something newer was asked for
    """Raised out of a synthesis whose result nobody waits for any more."""


@dataclass(frozen=True)
class Rendered:
    """A synthesised stroke, kept to start from. samples: (count,) float64 m/s² at the model rate. rendered: samples
    that were rendered for it; the others were there."""

    field: Field
    stroke: StrokeInput
    prepared: Prepared
    samples: Float
    synthesis: Synthesis
    rendered: int


def render(
    field: Field,
    stroke: StrokeInput,
    *,
    seed: int,
    earlier: Rendered | None = None,
    superseded: Callable[[], bool] = lambda: False,
) -> Rendered:
    """Synthesise stroke, from earlier where that helps; the signal is that of synthesise(), byte for byte.

    superseded: asked between blocks. Raises Superseded when it says yes, and what synthesise() raises.
    """
    start = earlier if earlier is not None and same_path(earlier, field, stroke, seed) else None
    # What is made from earlier has its carriers, and takes few of them anew.
    with nullcontext() if start is not None else noise_ahead(field.config, seed, states_of(stroke)[0]):
        prepared = prepare(field, stroke, seed=seed, earlier=None if start is None else start.prepared)
    samples = np.empty(prepared.count) if start is None else start.samples.copy()
    blocks = blocks_of(prepared.count)
    if start is not None:
        blocks = changed_blocks(start.prepared, prepared)
    with one_blas_thread_in_numpy():
        for first, count in blocks:
            if superseded():
                raise Superseded
            samples[first : first + count] = render_block(prepared, first, count)
    synthesis = to_synthesis(field, stroke, prepared, samples)
    return Rendered(field, stroke, prepared, samples, synthesis, sum(count for _, count in blocks))


def same_path(earlier: Rendered, field: Field, stroke: StrokeInput, seed: int) -> bool:
    """Do the two differ in force and contact alone?"""
    mine, other = stroke, earlier.stroke
    if not same_field(earlier.field, field) or earlier.prepared.seed != seed or mine.mechanics != other.mechanics:
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


def changed_blocks(old: Prepared, new: Prepared) -> list[tuple[int, int]]:
    """(start, count) of the blocks in which a sample may differ; both of the same path."""
    states = len(new.force)
    texture = _rows_differ(old.amplitude, new.amplitude)
    pressing = old.force != new.force
    height = np.zeros(states, dtype=bool)
    if new.profile_amplitude is not None and old.profile_amplitude is not None:
        height = _rows_differ(old.profile_amplitude, new.profile_amplitude)
    audible = old.audible != new.audible
    blocks = []
    for start, count in blocks_of(new.count):
        near = states_read(states, start, count)
        # The contact's memory: what was pressed TAIL samples ago, and the blend of its responses now.
        low = (start - TAIL) // SAMPLES_PER_STATE - _SPLINE_STATES
        far = slice(max(low, 0), (start + count + LEAD) // SAMPLES_PER_STATE + _SPLINE_STATES + 1)
        if audible[start : start + count].any() or (
            is_heard(new.audible[start : start + count])
            and (texture[near].any() or pressing[far].any() or height[far].any())
        ):
            blocks.append((start, count))
    return blocks


def _rows_differ(old: Float, new: Float) -> NDArray[np.bool_]:
    return np.asarray((old != new).reshape(len(new), -1).any(axis=1))
