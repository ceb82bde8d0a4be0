"""Methods on materials that can be stroked anew: each learns from its own diet, judged on strokes it never met."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..baselines.method import Fitted, Method, Specimen
from ..datasets.dataset import ActionRange
from ..datasets.recording import Process, Recording
from ..errors import HnfError
from ..material.mechanics import UNKNOWN, Mechanics
from ..metrics.spectra import welch
from .field_methods import FieldFitted
from .methods import Budget, Entry
from .reference import RATE_HZ, Reference, references
from .report import BEST, ORACLE, Cell, Column, Row
from .score import score_best, score_expected_magnitude, score_natural
from .strokes import Diet, Trial, diet_actions, trials

Float = NDArray[np.float64]
Watch = Callable[[str], None]
T = TypeVar("T")


@dataclass(frozen=True)
class Sizes:
    """seconds: of each judged stroke. realisations: of the true process per stroke, for limits and long-run spectrum.
    renders: of each method, averaged (seconds × renders = 8 s is what the bars speak of). training_s: of recordings
    that a method learns from. simulated, hatt, held_out: materials of each kind. known: trained materials that stand
    beside the held-out ones; None = all."""

    seconds: float = 4.0
    realisations: int = 32
    renders: int = 2
    training_s: float = 120.0
    simulated: int = 3
    hatt: int = 3
    held_out: int = 8
    known: int | None = None


@dataclass(frozen=True)
class Subject:
    """A material under evaluation. known: which parts of u(t) its recordings may claim to know."""

    process: Process
    limits: ActionRange
    token: NDArray[np.float32] | None = None
    mechanics: Mechanics = UNKNOWN
    category: str = ""
    known: frozenset[str] = frozenset({"direction", "speed", "force"})


@dataclass(frozen=True)
class Judged:
    """A material's references by kind of stroke, and what every method made of them."""

    references: dict[str, list[Reference]]
    cells: dict[str, dict[str, list[Cell]]]
    seconds: dict[str, float]
    fitted: dict[str, Fitted]
    notes: tuple[str, ...]


def judge(subject: Subject, entries: Sequence[Entry], sizes: Sizes, budget: Budget, seed: int, watch: Watch) -> Judged:
    """All entries on one material. One that fails is named in the notes and does not cost the others."""
    name = subject.process.name
    watch(f"{name}: the true process")
    planned = trials(subject.limits, sizes.seconds, seed)
    drawn = references(
        subject.process, [(each.name, each.action) for each in planned], 77 + seed, sizes.realisations, sizes.renders
    )
    cells = {
        "oracle": _by_kind(planned, [_natural_cell(each.oracle, each) for each in drawn]),
        "best": _by_kind(planned, [Cell(each.material, each.stroke, score_best(each)) for each in drawn]),
    }
    seconds, notes = {"oracle": 0.0, "best": 0.0}, []
    fitted: dict[str, Fitted] = {}
    diets: dict[Diet, tuple[Recording, ...]] = {}
    for entry in entries:
        if entry.needs_token and subject.token is None:
            continue
        watch(f"{name}: {entry.key}")
        try:
            if entry.learns and entry.shows not in fitted and entry.diet not in diets:
                diets[entry.diet] = recorded(subject, entry.diet, sizes.training_s, seed)
            began = time.monotonic()
            method = entry.make(budget)
            fitted[entry.key] = _fit(entry, method, subject, diets.get(entry.diet, ()), fitted, seed)
            made = cells_of(method, fitted[entry.key], drawn, sizes.renders, seed)
            cells[entry.key] = _by_kind(planned, made)
            seconds[entry.key] = time.monotonic() - began
        except (HnfError, ValueError) as error:
            notes.append(f"{entry.key} on {name}: {error}")
    return Judged(_by_kind(planned, drawn), cells, seconds, fitted, tuple(notes))


def recorded(subject: Subject, diet: Diet, seconds: float, seed: int) -> tuple[Recording, ...]:
    """What a method learns from: the true process on its diet."""
    actions = diet_actions(diet, subject.limits, seconds, seed)
    out: list[Recording] = []
    for group, length in enumerate(sorted({len(action.speed) for action in actions})):
        same = [action for action in actions if len(action.speed) == length]
        out += subject.process.record(same, 500_000 + 1000 * seed + group)
    return tuple(replace(each, known=subject.known) for each in out)


def column(key: str, title: str, note: str, kinds: Sequence[str], judged: Sequence[Judged],
           entries: Sequence[Entry], budget: Budget) -> Column:  # fmt: skip
    """One column of the table from judged materials: limits first, then every entry that took part."""
    rows = []
    for row_key in ("oracle", "best", *(entry.key for entry in entries)):
        cells = [cell for each in judged for kind in kinds for cell in each.cells.get(row_key, {}).get(kind, [])]
        if not cells:
            continue
        method = next((entry.make(budget) for entry in entries if entry.key == row_key), None)
        name = method.name if method else {"oracle": ORACLE, "best": BEST}[row_key]
        form = method.form if method else {"oracle": "natural", "best": "expected magnitude"}[row_key]
        spent = sum(each.seconds.get(row_key, 0.0) for each in judged)
        rows.append(Row(row_key, name, form, tuple(cells), spent))  # type: ignore[arg-type]
    return Column(key, title, note, tuple(rows))


def _fit(
    entry: Entry,
    method: Method,
    subject: Subject,
    recordings: tuple[Recording, ...],
    fitted: dict[str, Fitted],
    seed: int,
) -> Fitted:
    shown = fitted.get(entry.shows)
    if isinstance(shown, FieldFitted):
        return replace(shown, form=method.form)
    specimen = Specimen(subject.process.name, recordings, subject.token, subject.mechanics, subject.category)
    return method.fit(specimen, seed)


def cells_of(method: Method, fitted: Fitted, drawn: Sequence[Reference], renders: int, seed: int) -> list[Cell]:
    """One cell per reference."""
    rendered = [fitted.render([each.action for each in drawn], seed + 1 + again) for again in range(renders)]
    out = []
    for index, reference in enumerate(drawn):
        signals = [each[index] for each in rendered]
        if method.form == "natural":
            out.append(_natural_cell(signals, reference))
        else:
            out.append(Cell(reference.material, reference.stroke, score_expected_magnitude(signals, reference)))
    return out


def _natural_cell(signals: Sequence[Float], reference: Reference) -> Cell:
    density = np.asarray(np.mean([welch(each, RATE_HZ)[1] for each in signals], axis=0))
    return Cell(reference.material, reference.stroke, score_natural(signals, reference), density)


def _by_kind(planned: Sequence[Trial], things: Sequence[T]) -> dict[str, list[T]]:
    out: dict[str, list[T]] = {}
    for trial, thing in zip(planned, things, strict=True):
        out.setdefault(trial.kind, []).append(thing)
    return out
