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
from .timeline import distinct

T = TypeVar("T")
Question = TypeVar("Question")
Answer = TypeVar("Answer")

Asking = Generator[Condition, Emission, T]
"""Yields states, is sent what is emitted there, and returns what it makes of all that."""
Evaluate = Callable[[Field, Condition], Emission]
"""evaluate, or what stands for it."""

AT_ONCE = 512
"""States in a batch: enough for every core, and 6 MB on the way."""


def answered_by(answer: Callable[[Question], Answer], asking: Generator[Question, Answer, T]) -> T:
    """What asking returns, each of its questions answered by answer."""
    try:
        question = next(asking)
        while True:
            question = asking.send(answer(question))
    except StopIteration as done:
        returned: T = done.value
        return returned


def answered(field: Field, asking: Asking[T], emission: Evaluate = evaluate) -> T:
    """What asking returns, answered with F_Θ or what stands for it."""
    return answered_by(lambda condition: emissions(field, [condition], emission)[0], asking)


def answered_together(field: Field, asking: Sequence[Asking[T]]) -> list[T]:
    """What each returns. They go on in step: whatever all of them ask for is evaluated together."""
    returned: dict[int, T] = {}
    given: dict[int, Emission | None] = dict.fromkeys(range(len(asking)))
    while given:
        asked: dict[int, Condition] = {}
        for index, each in given.items():
            try:
                asked[index] = next(asking[index]) if each is None else asking[index].send(each)
            except StopIteration as done:
                returned[index] = done.value
        given = dict(zip(asked, emissions(field, list(asked.values())), strict=True))
    return [returned[index] for index in range(len(asking))]


def emissions(field: Field, conditions: Sequence[Condition], emission: Evaluate = evaluate) -> list[Emission]:
    """What F_Θ gives at the states of each."""
    parts: list[list[Emission]] = [[] for _ in conditions]
    for probe in dict.fromkeys(each.probe for each in conditions):
        alike = [index for index, each in enumerate(conditions) if each.probe == probe]
        for batch in _batches([(index, len(conditions[index].speed)) for index in alike]):
            given, begin = emission(field, _joined([(conditions[index], rows) for index, rows in batch])), 0
            for index, rows in batch:
                end = begin + rows.stop - rows.start
                parts[index].append(given.of(slice(begin, end)))
                begin = end
    return [each[0] if len(each) == 1 else one_after_another(each) for each in parts]


def _batches(asked: Sequence[tuple[int, int]]) -> list[list[tuple[int, slice]]]:
    """Who asks for how many states → batches of AT_ONCE at most, each with whose states are in it and which."""
    batches: list[list[tuple[int, slice]]] = []
    room = 0
    for index, count in asked:
        for low in range(0, max(count, 1), AT_ONCE):
            rows = slice(low, min(low + AT_ONCE, count))
            if not batches or rows.stop - rows.start > room:
                batches.append([])
                room = AT_ONCE
            batches[-1].append((index, rows))
            room -= rows.stop - rows.start
    return batches


def _joined(parts: Sequence[tuple[Condition, slice]]) -> Condition:
    """These states of conditions with one probe, one after another."""
    if len(parts) == 1 and parts[0][1] == slice(0, len(parts[0][0].speed)):
        return parts[0][0]
    mechanics, of_row = distinct([mechanics for each, _ in parts for mechanics in each.mechanics])
    first = np.cumsum([0, *(len(each.mechanics) for each, _ in parts)])
    material = [each.material[rows] + begin for (each, rows), begin in zip(parts, first, strict=False)]
    tokens, direction, speed, force, contact = (
        np.concatenate([getattr(each, name)[rows] for each, rows in parts])
        for name in ("tokens", "direction", "speed", "force", "contact")
    )
    of_state, probe = of_row[np.concatenate(material)], parts[0][0].probe
    return Condition(tokens, mechanics, of_state, direction, speed, force, contact, probe)


def one_after_another(parts: Sequence[Emission]) -> Emission:
    return Emission(np.concatenate([each.alpha for each in parts]), np.concatenate([each.sigma_dt for each in parts]))
