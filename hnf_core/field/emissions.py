"""F_Θ for whoever has to know it: of one stroke, or of several in common batches.

A short stroke has too few states to keep a processor busy, and every batch has a price of its own. What a state gives
does not depend on those beside it (kernel/layers.py), so a stroke is the same to the last bit alone and among others.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import TypeVar

import numpy as np

from .field import Emission, Field, evaluate
from .linear_contact import Condition
from .timeline import find_distinct_mechanics

T = TypeVar("T")
Request = TypeVar("Request")
Response = TypeVar("Response")

EvaluationRequests = Generator[Condition, Emission, T]
"""Yields states, is sent what is emitted there, and returns what it makes of all that."""
Evaluate = Callable[[Field, Condition], Emission]
"""evaluate, or what stands for it."""

BATCH_STATES = 512
"""States in a batch: enough for every core, and 6 MB on the way."""


def drive_requests(respond: Callable[[Request], Response], requests: Generator[Request, Response, T]) -> T:
    """What asking returns, each of its questions answered by answer."""
    try:
        question = next(requests)
        while True:
            question = requests.send(respond(question))
    except StopIteration as done:
        returned: T = done.value
        return returned


def evaluate_requests(field: Field, requests: EvaluationRequests[T], evaluator: Evaluate = evaluate) -> T:
    """What asking returns, answered with F_Θ or what stands for it."""
    return drive_requests(lambda condition: evaluate_batched(field, [condition], evaluator)[0], requests)


def evaluate_requests_together(field: Field, requests: Sequence[EvaluationRequests[T]]) -> list[T]:
    """What each returns. They go on in step: whatever all of them ask for is evaluated together."""
    returned: dict[int, T] = {}
    given: dict[int, Emission | None] = dict.fromkeys(range(len(requests)))
    while given:
        asked: dict[int, Condition] = {}
        for index, each in given.items():
            try:
                asked[index] = next(requests[index]) if each is None else requests[index].send(each)
            except StopIteration as done:
                returned[index] = done.value
        given = dict(zip(asked, evaluate_batched(field, list(asked.values())), strict=True))
    return [returned[index] for index in range(len(requests))]


def evaluate_batched(field: Field, conditions: Sequence[Condition], evaluator: Evaluate = evaluate) -> list[Emission]:
    """What F_Θ gives at the states of each."""
    parts: list[list[Emission]] = [[] for _ in conditions]
    for probe in dict.fromkeys(each.probe for each in conditions):
        alike = [index for index, each in enumerate(conditions) if each.probe == probe]
        for batch in _split_batches([(index, len(conditions[index].speed)) for index in alike]):
            given, begin = (
                evaluator(field, _concatenate_conditions([(conditions[index], rows) for index, rows in batch])),
                0,
            )
            for index, rows in batch:
                end = begin + rows.stop - rows.start
                parts[index].append(given.rows(slice(begin, end)))
                begin = end
    return [each[0] if len(each) == 1 else concatenate_emissions(each) for each in parts]


def _split_batches(asked: Sequence[tuple[int, int]]) -> list[list[tuple[int, slice]]]:
    """Who asks for how many states → batches of AT_ONCE at most, each with whose states are in it and which."""
    batches: list[list[tuple[int, slice]]] = []
    room = 0
    for index, count in asked:
        for low in range(0, max(count, 1), BATCH_STATES):
            rows = slice(low, min(low + BATCH_STATES, count))
            if not batches or rows.stop - rows.start > room:
                batches.append([])
                room = BATCH_STATES
            batches[-1].append((index, rows))
            room -= rows.stop - rows.start
    return batches


def _concatenate_conditions(parts: Sequence[tuple[Condition, slice]]) -> Condition:
    """These states of conditions with one probe, one after another."""
    if len(parts) == 1 and parts[0][1] == slice(0, len(parts[0][0].speed)):
        return parts[0][0]
    mechanics, of_row = find_distinct_mechanics([mechanics for each, _ in parts for mechanics in each.mechanics])
    first = np.cumsum([0, *(len(each.mechanics) for each, _ in parts)])
    material = [each.material[rows] + begin for (each, rows), begin in zip(parts, first, strict=False)]
    tokens, direction, speed, force, contact = (
        np.concatenate([getattr(each, name)[rows] for each, rows in parts])
        for name in ("tokens", "direction", "speed", "force", "contact")
    )
    of_state, probe = of_row[np.concatenate(material)], parts[0][0].probe
    return Condition(tokens, mechanics, of_state, direction, speed, force, contact, probe)


def concatenate_emissions(parts: Sequence[Emission]) -> Emission:
    return Emission(np.concatenate([each.alpha for each in parts]), np.concatenate([each.sigma_dt for each in parts]))
