"""Who takes part: every method by a short key, what it learns from, and on how many materials it is affordable."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ..baselines.method import Form, Method
from ..errors import UsageError
from ..field.weights import load_field
from .field_methods import SharedField, TrainedField
from .strokes import TrainingStrokes


@dataclass(frozen=True)
class Budget:
    """epochs, steps: of the methods trained by gradient, None = their own. weights: of the shared field."""

    epochs: int | None = None
    steps: int | None = None
    weights: Path | None = None


@dataclass(frozen=True)
class MethodEntry:
    """key: for --methods. diet: what it learns from. make: the method itself (imports torch only then). most: materials
    of a run on which it takes part; None = all. learns: False where recordings are not needed. shows: key of the
    entry whose fit this one shows in another form, so that it is trained once."""

    key: str
    training_strokes: TrainingStrokes
    build: Callable[[Budget], Method]
    max_materials: int | None = None
    needs_recordings: bool = True
    needs_token: bool = False
    reuses: str = ""


def list_entries() -> tuple[MethodEntry, ...]:
    return (
        MethodEntry("field", "wandering", lambda budget: TrainedField(epochs=budget.epochs)),
        MethodEntry("shared", "wandering", lambda budget: _make_shared(budget, "natural"), needs_recordings=False, needs_token=True),
        MethodEntry("ar", "wandering", _make_piecewise_ar),
        MethodEntry("gacm", "wandering", lambda budget: _make_gacm(budget, False)),
        MethodEntry("gacm-improved", "wandering", lambda budget: _make_gacm(budget, True)),
        MethodEntry("playback", "wandering", _make_nearest_neighbour),
        MethodEntry(
            "hnf",
            "circular",
            lambda budget: TrainedField("HNF with carriers, circular strokes only", epochs=budget.epochs),
        ),
        MethodEntry(
            "hnf-plus",
            "circular and primitives",
            lambda budget: TrainedField("HNF+ with carriers, circles and eight primitives", epochs=budget.epochs),
        ),
        MethodEntry("hnf-literal", "circular", _make_published_hnf, max_materials=3),
        MethodEntry(
            "field-expected",
            "wandering",
            lambda budget: TrainedField("field, per material", "expected magnitude", budget.epochs),
            reuses="field",
        ),
        MethodEntry(
            "shared-expected", "wandering", lambda budget: _make_shared(budget, "expected magnitude"), needs_recordings=False,
            needs_token=True, reuses="shared",
        ),
    )  # fmt: skip


def select_entries(keys: Sequence[str] | None) -> tuple[MethodEntry, ...]:
    """The entries of these keys, all for None. Raises UsageError that lists the keys."""
    every = {entry.key: entry for entry in list_entries()}
    unknown = [key for key in keys or () if key not in every]
    if unknown:
        raise UsageError(f"no method is called {', '.join(unknown)}.", remedy=f"Choose among {', '.join(every)}.")
    return tuple(every[key] for key in dict.fromkeys(keys or every))


@lru_cache(maxsize=4)
def _load_field_cached(path: Path | None):  # type: ignore[no-untyped-def]
    return load_field(path)


def _make_shared(budget: Budget, form: Form) -> Method:
    return SharedField(_load_field_cached(budget.weights), form=form)


def _make_piecewise_ar(budget: Budget) -> Method:
    from ..baselines.piecewise_ar import PiecewiseAr

    return PiecewiseAr()


def _make_nearest_neighbour(budget: Budget) -> Method:
    from ..baselines.playback import NearestNeighbour

    return NearestNeighbour()


def _make_gacm(budget: Budget, improved: bool) -> Method:
    from ..baselines.gacm import STEPS, GacmSingleMaterial

    return GacmSingleMaterial(improved, STEPS if budget.steps is None else budget.steps)


def _make_published_hnf(budget: Budget) -> Method:
    from ..baselines.literal import PublishedHnf

    return PublishedHnf() if budget.epochs is None else PublishedHnf(epochs=budget.epochs)
