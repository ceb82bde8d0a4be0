"""Methods on materials that can be stroked anew: each learns from its own diet, judged on strokes it never met."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..baselines.method import FittedMaterial, MaterialRecordings, Method
from ..datasets.dataset import ActionRange
from ..datasets.recording import Recording, TextureProcess
from ..errors import HnfError
from ..material.mechanics import UNKNOWN_MECHANICS, Mechanics
from ..metrics.spectra import welch
from .field_methods import FittedField
from .methods import Budget, MethodEntry
from .reference import RATE_HZ, Reference, make_references
from .report import BEST_NAME, ORACLE_NAME, Cell, Column, Row
from .score import score_best, score_expected_magnitude, score_natural
from .strokes import TrainingStrokes, Trial, make_training_actions, make_trials

Float = NDArray[np.float64]
ProgressCallback = Callable[[str], None]
T = TypeVar("T")


@dataclass(frozen=True)
class EvaluationSizes:
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
class EvaluatedMaterial:
    """A material under evaluation. known: which parts of u(t) its recordings may claim to know."""

    process: TextureProcess
    limits: ActionRange
    token: NDArray[np.float32] | None = None
    mechanics: Mechanics = UNKNOWN_MECHANICS
    category: str = ""
    known: frozenset[str] = frozenset({"direction", "speed", "force"})


@dataclass(frozen=True)
class MaterialResult:
    """A material's references by kind of stroke, and what every method made of them."""

    references: dict[str, list[Reference]]
    cells: dict[str, dict[str, list[Cell]]]
    seconds: dict[str, float]
    fitted: dict[str, FittedMaterial]
    notes: tuple[str, ...]


def evaluate_material(
    subject: EvaluatedMaterial,
    entries: Sequence[MethodEntry],
    sizes: EvaluationSizes,
    budget: Budget,
    seed: int,
    watch: ProgressCallback,
) -> MaterialResult:
    """All entries on one material. One that fails is named in the notes and does not cost the others."""
    name = subject.process.name
    watch(f"{name}: the true process")
    planned = make_trials(subject.limits, sizes.seconds, seed)
    drawn = make_references(
        subject.process, [(each.name, each.action) for each in planned], 77 + seed, sizes.realisations, sizes.renders
    )
    cells = {
        "oracle": _group_by_kind(planned, [_make_natural_cell(each.oracle, each) for each in drawn]),
        "best": _group_by_kind(planned, [Cell(each.material, each.stroke, score_best(each)) for each in drawn]),
    }
    seconds, notes = {"oracle": 0.0, "best": 0.0}, []
    fitted: dict[str, FittedMaterial] = {}
    diets: dict[TrainingStrokes, tuple[Recording, ...]] = {}
    for entry in entries:
        if entry.needs_token and subject.token is None:
            continue
        watch(f"{name}: {entry.key}")
        try:
            if entry.needs_recordings and entry.reuses not in fitted and entry.training_strokes not in diets:
                diets[entry.training_strokes] = record_training_strokes(
                    subject, entry.training_strokes, sizes.training_s, seed
                )
            began = time.monotonic()
            method = entry.build(budget)
            fitted[entry.key] = _fit_method(entry, method, subject, diets.get(entry.training_strokes, ()), fitted, seed)
            made = score_method(method, fitted[entry.key], drawn, sizes.renders, seed)
            cells[entry.key] = _group_by_kind(planned, made)
            seconds[entry.key] = time.monotonic() - began
        except (HnfError, ValueError) as error:
            notes.append(f"{entry.key} on {name}: {error}")
    return MaterialResult(_group_by_kind(planned, drawn), cells, seconds, fitted, tuple(notes))


def record_training_strokes(
    subject: EvaluatedMaterial, training_strokes: TrainingStrokes, seconds: float, seed: int
) -> tuple[Recording, ...]:
    """What a method learns from: the true process on its diet."""
    actions = make_training_actions(training_strokes, subject.limits, seconds, seed)
    out: list[Recording] = []
    for group, length in enumerate(sorted({len(action.speed) for action in actions})):
        same = [action for action in actions if len(action.speed) == length]
        out += subject.process.record(same, 500_000 + 1000 * seed + group)
    return tuple(replace(each, known=subject.known) for each in out)


def make_column(key: str, title: str, note: str, kinds: Sequence[str], results: Sequence[MaterialResult],
           entries: Sequence[MethodEntry], budget: Budget) -> Column:  # fmt: skip
    """One column of the table from judged materials: limits first, then every entry that took part."""
    rows = []
    for row_key in ("oracle", "best", *(entry.key for entry in entries)):
        cells = [cell for each in results for kind in kinds for cell in each.cells.get(row_key, {}).get(kind, [])]
        if not cells:
            continue
        method = next((entry.build(budget) for entry in entries if entry.key == row_key), None)
        name = method.name if method else {"oracle": ORACLE_NAME, "best": BEST_NAME}[row_key]
        form = method.form if method else {"oracle": "natural", "best": "expected magnitude"}[row_key]
        spent = sum(each.seconds.get(row_key, 0.0) for each in results)
        rows.append(Row(row_key, name, form, tuple(cells), spent))  # type: ignore[arg-type]
    return Column(key, title, note, tuple(rows))


def _fit_method(
    entry: MethodEntry,
    method: Method,
    subject: EvaluatedMaterial,
    recordings: tuple[Recording, ...],
    fitted: dict[str, FittedMaterial],
    seed: int,
) -> FittedMaterial:
    shown = fitted.get(entry.reuses)
    if isinstance(shown, FittedField):
        return replace(shown, form=method.form)
    specimen = MaterialRecordings(subject.process.name, recordings, subject.token, subject.mechanics, subject.category)
    return method.fit(specimen, seed)


def score_method(
    method: Method, fitted: FittedMaterial, drawn: Sequence[Reference], renders: int, seed: int
) -> list[Cell]:
    """One cell per reference."""
    rendered = [fitted.render([each.action for each in drawn], seed + 1 + again) for again in range(renders)]
    out = []
    for index, reference in enumerate(drawn):
        signals = [each[index] for each in rendered]
        if method.form == "natural":
            out.append(_make_natural_cell(signals, reference))
        else:
            out.append(Cell(reference.material, reference.stroke, score_expected_magnitude(signals, reference)))
    return out


def _make_natural_cell(signals: Sequence[Float], reference: Reference) -> Cell:
    density = np.asarray(np.mean([welch(each, RATE_HZ)[1] for each in signals], axis=0))
    return Cell(reference.material, reference.stroke, score_natural(signals, reference), density)


def _group_by_kind(planned: Sequence[Trial], values: Sequence[T]) -> dict[str, list[T]]:
    out: dict[str, list[T]] = {}
    for trial, thing in zip(planned, values, strict=True):
        out.setdefault(trial.kind, []).append(thing)
    return out
