"""A stroke of any length in the memory of a minute: cut into portions that overlap by all they remember.

A sample follows from the states around it: the contact's impulse response (TAIL, LEAD), F_Θ's memory, the fades at the
ends of contact. Each portion is prepared with that much on either side and rendered without it. The carriers go by the
stroke's own clock and place, so that no portion begins them anew. Portions and margins are whole numbers of the states
that are evaluated at once, whose number F_Θ's float32 products follow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import UsageError
from .audible import AFTER_CONTACT_S, BEFORE_CONTACT_S, BLOCK_SAMPLES
from .blocks import render_samples
from .contact_filter import LEAD_SAMPLES, TAIL_SAMPLES
from .field import Field
from .hops import HOP_SIZE
from .noise_ahead import prefetch_noise
from .prepared import CHUNK_STATES, count_memory_states, prepare_stroke
from .stroke import StrokeInput
from .timeline import SAMPLES_PER_STATE, resample_action, sample_count

Float = NDArray[np.float64]

CHUNK_STEP = math.lcm(BLOCK_SAMPLES, HOP_SIZE, CHUNK_STATES * SAMPLES_PER_STATE)
"""Samples: portions are cut where blocks and groups of states both begin."""
CHUNK_SAMPLES = 6 * CHUNK_STEP
"""61 s: F_Θ's amplitudes take 25 MB of it."""
_MARGIN_STATES = 4
"""States to either side that splines and the reading of a band look at."""


@dataclass(frozen=True)
class RenderedChunk:
    """samples: (m,) float64 m/s² at the model rate, following those of the portion before. loudest: the field's largest
    amplitude in it, m/s². missed: see Prepared."""

    samples: Float
    loudest: float
    residual_power: float


def render_chunks(
    field: Field, stroke: StrokeInput, *, seed: int, length: int = CHUNK_SAMPLES, begin: int = 0,
    tolerance: float | None = None,
) -> Iterator[RenderedChunk]:  # fmt: skip
    """synthesise() at the model rate, portion by portion: together within 1e-6 of its RMS (places are counted from
    another zero, and rounded to float32), in memory that does not grow with the stroke.

    length: samples of a portion. begin: the sample to begin at; what comes before it is not computed. Both whole
    numbers of STEP. tolerance: as of prepare(), of the power of each portion: where one begins, amplitudes may step by
    as much. Raises StrokeError for an action without duration, UsageError for another length, or for a stroke
    with a height profile, which is one piece.
    """
    if length <= 0 or length % CHUNK_STEP or begin < 0 or begin % CHUNK_STEP:
        raise UsageError(f"a portion of {length} samples from {begin} on: both must be whole numbers of {CHUNK_STEP}.")
    if stroke.profile is not None:
        raise UsageError(
            "a stroke with a height profile cannot be cut into portions.", remedy="Synthesise it whole, or without it."
        )
    action, token_index = resample_action(stroke)
    count = sample_count(action)
    for start in range(begin, count, length):
        stop = min(start + length, count)
        rows = _find_chunk_states(field, start, stop, len(action.speed))
        origin = rows.start * SAMPLES_PER_STATE
        piece = StrokeInput(_select_action_states(action, rows), stroke.tokens, stroke.mechanics, token_index[rows])
        with prefetch_noise(field.config, seed, piece.action, origin):
            prepared = replace(prepare_stroke(field, piece, seed=seed, tolerance=tolerance), origin=origin)
        samples = render_samples(prepared, start - origin, stop - origin)
        yield RenderedChunk(samples, float(prepared.loudest.max(initial=0.0)), prepared.residual_power)


def _find_chunk_states(field: Field, start: int, stop: int, states: int) -> slice:
    """The states that samples start … stop − 1 follow from."""
    before = max(
        math.ceil(TAIL_SAMPLES / SAMPLES_PER_STATE),
        count_memory_states(field),
        math.ceil(AFTER_CONTACT_S * ACTION_RATE_HZ),
    )
    after = max(math.ceil(LEAD_SAMPLES / SAMPLES_PER_STATE), math.ceil(BEFORE_CONTACT_S * ACTION_RATE_HZ))
    first = start // SAMPLES_PER_STATE - before - count_memory_states(field) - _MARGIN_STATES
    last = -(-stop // SAMPLES_PER_STATE) + after + _MARGIN_STATES
    return slice(
        max(first // CHUNK_STATES * CHUNK_STATES, 0),
        min(-(-last // CHUNK_STATES) * CHUNK_STATES, states),
    )


def _select_action_states(action: Action, rows: slice) -> Action:
    names = ("direction", "speed", "force", "position", "contact")
    return replace(action, **{name: getattr(action, name)[rows] for name in names})
