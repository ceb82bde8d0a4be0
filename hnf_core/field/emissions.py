"""F_Θ at all states of several strokes, in common batches: each state once, whatever stroke it is of.

A short stroke has too few states to keep a processor busy, and every batch has a price of its own. What a state gives
does not depend on those beside it (kernel/layers.py), so a stroke is the same to the last bit alone and among others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from .field import Emission, Field, evaluate
from .linear_contact import Condition
from .timeline import distinct

Evaluate = Callable[[Field, Condition], Emission]
Rows = NDArray[np.int64]

AT_ONCE = 512
"""States in a batch: enough for every core, and 6 MB on the way."""


def emissions(
    field: Field, conditions: Sequence[Condition], wanted: Sequence[NDArray[np.bool_]], emission: Evaluate = evaluate
) -> list[Emission]:
    """What F_Θ gives at the states of each stroke, nothing where wanted (n,) has no use for it. emission: what stands
    for F_Θ."""
    config = field.config
    out = [
        Emission(
            np.zeros((len(each.speed), config.alpha_heads, config.carriers.count)),
            np.zeros((len(each.speed), config.states)),
        )
        for each in conditions
    ]
    for probe in dict.fromkeys(each.probe for each in conditions):
        alike = [index for index, each in enumerate(conditions) if each.probe == probe]
        asked = [(index, at) for index in alike for at in _batches(np.flatnonzero(wanted[index]))]
        for batch in _filled(asked):
            given, begin = emission(field, _joined([(conditions[index], at) for index, at in batch])), 0
            for index, at in batch:
                rows = slice(begin, begin + len(at))
                out[index].alpha[at], out[index].sigma_dt[at] = given.alpha[rows], given.sigma_dt[rows]
                begin = rows.stop
    return out


def _batches(at: Rows) -> list[Rows]:
    return [at[low : low + AT_ONCE] for low in range(0, len(at), AT_ONCE)]


def _filled(asked: Sequence[tuple[int, Rows]]) -> list[list[tuple[int, Rows]]]:
    """Neighbours together, up to AT_ONCE states in each."""
    batches: list[list[tuple[int, Rows]]] = []
    room = 0
    for each in asked:
        if len(each[1]) > room:
            batches.append([])
            room = AT_ONCE
        batches[-1].append(each)
        room -= len(each[1])
    return batches


def _joined(parts: Sequence[tuple[Condition, Rows]]) -> Condition:
    """These states of conditions with one probe, one after another."""
    mechanics, of_row = distinct([mechanics for each, _ in parts for mechanics in each.mechanics])
    first = np.cumsum([0, *(len(each.mechanics) for each, _ in parts)])
    material = [each.material[at] + begin for (each, at), begin in zip(parts, first, strict=False)]
    tokens, direction, speed, force, contact = (
        np.concatenate([getattr(each, name)[at] for each, at in parts])
        for name in ("tokens", "direction", "speed", "force", "contact")
    )
    of_state, probe = of_row[np.concatenate(material)], parts[0][0].probe
    return Condition(tokens, mechanics, of_state, direction, speed, force, contact, probe)
