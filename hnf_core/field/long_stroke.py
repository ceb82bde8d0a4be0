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
from .audible import AFTER_CONTACT_S, BEFORE_CONTACT_S, BLOCK
from .blocks import rendered
from .contact_filter import LEAD, TAIL
from .field import Field
from .hops import HOP
from .noise_ahead import noise_ahead
from .prepared import STATES_AT_ONCE, memory, prepare
from .stroke import StrokeInput
from .timeline import SAMPLES_PER_STATE, sample_count, states_of

Float = NDArray[np.float64]

STEP = math.lcm(BLOCK, HOP, STATES_AT_ONCE * SAMPLES_PER_STATE)
"""Samples: portions are cut where blocks and groups of states both begin."""
PORTION = 6 * STEP
"""61 s: F_Θ's amplitudes take 25 MB of it."""
_AROUND = 4
"""States to either side that splines and the reading of a band look at."""


@dataclass(frozen=True)
class Portion:
    """samples: (m,) float64 m/s² at the model rate, following those of the portion before. loudest: the field's largest
    amplitude in it, m/s². missed: see Prepared."""

    samples: Float
    loudest: float
    missed: float


def portions(
    field: Field, stroke: StrokeInput, *, seed: int, length: int = PORTION, begin: int = 0,
    tolerance: float | None = None,
) -> Iterator[Portion]:  # fmt: skip
    """synthesise() at the model rate, portion by portion: together within 1e-6 of its RMS (places are counted from
    another zero, and rounded to float32), in memory that does not grow with the stroke.

    length: samples of a portion. begin: the sample to begin at; what comes before it is not computed. Both whole
    numbers of STEP. tolerance: as of prepare(), of the power of each portion: where one begins, amplitudes may step by
    as much. Raises StrokeError for an action without duration, UsageError for another length, or for a stroke
    with a height profile, which is one piece.
    """
    if length <= 0 or length % STEP or begin < 0 or begin % STEP:
        raise UsageError(f"a portion of {length} samples from {begin} on: both must be whole numbers of {STEP}.")
    if stroke.profile is not None:
        raise UsageError(
            "a stroke with a height profile cannot be cut into portions.", remedy="Synthesise it whole, or without it."
        )
    action, token_index = states_of(stroke)
    count = sample_count(action)
    for start in range(begin, count, length):
        stop = min(start + length, count)
        rows = _rows(field, start, stop, len(action.speed))
        origin = rows.start * SAMPLES_PER_STATE
        piece = StrokeInput(_states(action, rows), stroke.tokens, stroke.mechanics, token_index[rows])
        with noise_ahead(field.config, seed, piece.action, origin):
            prepared = replace(prepare(field, piece, seed=seed, tolerance=tolerance), origin=origin)
        samples = rendered(prepared, start - origin, stop - origin)
        yield Portion(samples, float(prepared.loudest.max(initial=0.0)), prepared.missed)


def _rows(field: Field, start: int, stop: int, states: int) -> slice:
    """The states that samples start … stop − 1 follow from."""
    before = max(math.ceil(TAIL / SAMPLES_PER_STATE), memory(field), math.ceil(AFTER_CONTACT_S * ACTION_RATE_HZ))
    after = max(math.ceil(LEAD / SAMPLES_PER_STATE), math.ceil(BEFORE_CONTACT_S * ACTION_RATE_HZ))
    first = start // SAMPLES_PER_STATE - before - memory(field) - _AROUND
    last = -(-stop // SAMPLES_PER_STATE) + after + _AROUND
    return slice(
        max(first // STATES_AT_ONCE * STATES_AT_ONCE, 0),
        min(-(-last // STATES_AT_ONCE) * STATES_AT_ONCE, states),
    )


def _states(action: Action, rows: slice) -> Action:
    names = ("direction", "speed", "force", "position", "contact")
    return replace(action, **{name: getattr(action, name)[rows] for name in names})
