"""Many strokes of one field: F_Θ of all in common batches, and the carriers of each drawn while another is rendered."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext

from .blocks import render_samples
from .carriers import MODEL_RATE_HZ
from .emissions import evaluate_requests_together
from .field import Field, find_kernel
from .noise_ahead import prefetch_noise
from .prepared import request_prepared_stroke
from .stroke import StrokeInput, Synthesis
from .synthesis import make_result_within_tolerance, synthesise
from .timeline import resample_action

GROUP_STATES = 4096
"""Of the strokes that are asked about at once, where one alone does not have more: 10 MB on the way."""


def synthesise_many(
    field: Field,
    strokes: Sequence[StrokeInput],
    *,
    seeds: Sequence[int],
    sample_rate: float = MODEL_RATE_HZ,
    tolerance: float | None = None,
) -> Iterator[Synthesis]:
    """synthesise() of each stroke with its seed, in their order and to the last bit.

    Raises ValueError where there is not one seed a stroke, and what synthesise() raises.
    """
    if len(strokes) != len(seeds):
        raise ValueError(f"{len(strokes)} strokes with {len(seeds)} seeds")
    if find_kernel(field) is None:  # numpy's bytes depend on what is asked for at once
        return (
            synthesise(field, stroke, seed=seed, sample_rate=sample_rate, tolerance=tolerance)
            for stroke, seed in zip(strokes, seeds, strict=True)
        )
    return _synthesise_in_batches(field, strokes, seeds, sample_rate, tolerance)


def _synthesise_in_batches(
    field: Field, strokes: Sequence[StrokeInput], seeds: Sequence[int], sample_rate: float, tolerance: float | None
) -> Iterator[Synthesis]:
    for some in _group_strokes(strokes):
        group, drawn_from = strokes[some], seeds[some]
        asking = [
            request_prepared_stroke(field, stroke, seed=seed, tolerance=tolerance)
            for stroke, seed in zip(group, drawn_from, strict=True)
        ]
        with prefetch_noise(field.config, drawn_from[0], resample_action(group[0])[0]):
            prepared = evaluate_requests_together(field, asking)
        for stroke, one, following in zip(group, prepared, [*prepared[1:], prepared[-1]], strict=True):
            draws = following.seed != one.seed
            with prefetch_noise(field.config, following.seed, following.action) if draws else nullcontext():
                samples = render_samples(one)
            yield make_result_within_tolerance(field, stroke, one, samples, sample_rate, tolerance)


def _group_strokes(strokes: Sequence[StrokeInput]) -> Iterator[slice]:
    """Neighbours, up to STATES_TOGETHER."""
    begin = states = 0
    for at, stroke in enumerate(strokes):
        count = len(stroke.action.speed)
        if at > begin and states + count > GROUP_STATES:
            yield slice(begin, at)
            begin, states = at, 0
        states += count
    if begin < len(strokes):
        yield slice(begin, len(strokes))
