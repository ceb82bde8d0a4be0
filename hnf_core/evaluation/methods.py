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
from .strokes import Diet


@dataclass(frozen=True)
class Budget:
    """epochs, steps: of the methods trained by gradient, None = their own. weights: of the shared field."""

    epochs: int | None = None
    steps: int | None = None
    weights: Path | None = None


@dataclass(frozen=True)
class Entry:
    """key: for --methods. diet: what it learns from. make: the method itself (imports torch only then). most: materials
    of a run on which it takes part; None = all. learns: False where recordings are not needed. shows: key of the
    entry whose fit this one shows in another form, so that it is trained once."""

    key: str
    diet: Diet
    make: Callable[[Budget], Method]
    most: int | None = None
    learns: bool = True
    needs_token: bool = False
    shows: str = ""


def entries() -> tuple[Entry, ...]:
    return (
        Entry("field", "wandering", lambda budget: TrainedField(epochs=budget.epochs)),
        Entry("shared", "wandering", lambda budget: _shared(budget, "natural"), learns=False, needs_token=True),
        Entry("ar", "wandering", _ar),
        Entry("gacm", "wandering", lambda budget: _gacm(budget, False)),
        Entry("gacm-improved", "wandering", lambda budget: _gacm(budget, True)),
        Entry("playback", "wandering", _playback),
        Entry(
            "hnf",
            "circular",
            lambda budget: TrainedField("HNF with carriers, circular strokes only", epochs=budget.epochs),
        ),
        Entry(
            "hnf-plus",
            "circular and primitives",
            lambda budget: TrainedField("HNF+ with carriers, circles and eight primitives", epochs=budget.epochs),
        ),
        Entry("hnf-literal", "circular", _literal, most=3),
        Entry(
            "field-expected",
            "wandering",
            lambda budget: TrainedField("field, per material", "expected magnitude", budget.epochs),
            shows="field",
        ),
        Entry(
            "shared-expected", "wandering", lambda budget: _shared(budget, "expected magnitude"), learns=False,
            needs_token=True, shows="shared",
        ),
    )  # fmt: skip


def chosen(keys: Sequence[str] | None) -> tuple[Entry, ...]:
    """The entries of these keys, all for None. Raises UsageError that lists the keys."""
    every = {entry.key: entry for entry in entries()}
    unknown = [key for key in keys or () if key not in every]
    if unknown:
        raise UsageError(f"no method is called {', '.join(unknown)}.", remedy=f"Choose among {', '.join(every)}.")
    return tuple(every[key] for key in dict.fromkeys(keys or every))


@lru_cache(maxsize=4)
def _field(path: Path | None):  # type: ignore[no-untyped-def]
    return load_field(path)


def _shared(budget: Budget, form: Form) -> Method:
    return SharedField(_field(budget.weights), form=form)


def _ar(budget: Budget) -> Method:
    from ..baselines.piecewise_ar import PiecewiseAr

    return PiecewiseAr()


def _playback(budget: Budget) -> Method:
    from ..baselines.playback import Playback

    return Playback()


def _gacm(budget: Budget, improved: bool) -> Method:
    from ..baselines.gacm import STEPS, GacmAlone

    return GacmAlone(improved, STEPS if budget.steps is None else budget.steps)


def _literal(budget: Budget) -> Method:
    from ..baselines.literal import LiteralHnf

    return LiteralHnf() if budget.epochs is None else LiteralHnf(epochs=budget.epochs)
