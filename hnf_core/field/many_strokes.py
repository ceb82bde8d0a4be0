"""Many strokes of one field: F_Θ of all in common batches, and the carriers of each drawn while another is rendered."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext

from .blocks import rendered
from .carriers import MODEL_RATE_HZ
from .emissions import emissions
from .field import Field, kernel_for
from .noise_ahead import noise_ahead
from .prepared import asked_for, prepare
from .stroke import StrokeInput, Synthesis
from .synthesis import synthesise, to_synthesis
from .timeline import condition_of, states_of

STATES_TOGETHER = 4096
"""Of the strokes that are asked about at once, where one alone does not have more: 10 MB on the way."""


def synthesise_many(
    field: Field, strokes: Sequence[StrokeInput], *, seeds: Sequence[int], sample_rate: float = MODEL_RATE_HZ
) -> Iterator[Synthesis]:
    """synthesise() of each stroke with its seed, in their order and to the last bit.

    Raises ValueError where there is not one seed a stroke, and what synthesise() raises.
    """
    if len(strokes) != len(seeds):
        raise ValueError(f"{len(strokes)} strokes with {len(seeds)} seeds")
    if kernel_for(field) is None:  # numpy's bytes depend on what is asked for at once
        return (
            synthesise(field, stroke, seed=seed, sample_rate=sample_rate)
            for stroke, seed in zip(strokes, seeds, strict=True)
        )
    return _in_batches(field, strokes, seeds, sample_rate)


def _in_batches(
    field: Field, strokes: Sequence[StrokeInput], seeds: Sequence[int], sample_rate: float
) -> Iterator[Synthesis]:
    for some in _together(strokes):
        group, drawn_from = strokes[some], seeds[some]
        states = [states_of(stroke) for stroke in group]
        conditions = [condition_of(stroke, *each) for stroke, each in zip(group, states, strict=True)]
        with noise_ahead(field.config, drawn_from[0], states[0][0]):
            given = emissions(field, conditions, [asked_for(field, each) for each in conditions])
        for at, (stroke, emitted) in enumerate(zip(group, given, strict=True)):
            following = min(at + 1, len(group) - 1)
            draws = drawn_from[following] != drawn_from[at]
            with noise_ahead(field.config, drawn_from[following], states[following][0]) if draws else nullcontext():
                prepared = prepare(field, stroke, seed=drawn_from[at], emitted=emitted)
                samples = rendered(prepared)
            yield to_synthesis(field, stroke, prepared, samples, sample_rate)


def _together(strokes: Sequence[StrokeInput]) -> Iterator[slice]:
    """Neighbours, up to STATES_TOGETHER."""
    begin = states = 0
    for at, stroke in enumerate(strokes):
        count = len(stroke.action.speed)
        if at > begin and states + count > STATES_TOGETHER:
            yield slice(begin, at)
            begin, states = at, 0
        states += count
    if begin < len(strokes):
        yield slice(begin, len(strokes))
