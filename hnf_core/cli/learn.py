"""Learning one material for another program: what `hnf train field` does, told step by step to a function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import HnfError
from ..field.weights import save_field
from .progress import Progress

GATHERING, TRAINING = "gathering recordings", "epoch"
"""Stages, in their order."""


@dataclass(frozen=True)
class Lesson:
    """kind, folder: of the data set (datasets.catalogue), "" = no folder. material: as the data set calls it. seconds:
    of strokes to synthesise, where it holds models. epochs: at most so many."""

    kind: str
    folder: str
    material: str
    seconds: float
    epochs: int


def learn(lesson: Lesson, out: Path, show: Callable[[Progress], None]) -> None:
    """Train, and write the weights at out. A killed run goes on from the checkpoint beside it when the same lesson is
    asked for again. The last of the steps that show() is told of is the saving.

    Raises HnfError, also where a package is missing.
    """
    from ..datasets.catalogue import LICENCES, open_dataset
    from ..datasets.training_strokes import training_recordings

    steps = lesson.epochs + 1
    show(Progress(GATHERING, 0, 1))
    data = open_dataset(lesson.kind, Path(lesson.folder) if lesson.folder else None)
    data.process(lesson.material)  # a wrong name is told before torch is loaded
    try:
        from ..training.own_material import Choices, train_own
    except ImportError as error:
        raise HnfError(
            f"this Python cannot train ({error}).", remedy="Check it in the add-on's preferences."
        ) from error
    recordings = training_recordings(data, lesson.material, lesson.seconds, seed=0)
    show(Progress(TRAINING, 0, steps))
    trained, _ = train_own(
        recordings, lesson.kind, LICENCES[lesson.kind], 0, Choices(epochs=lesson.epochs),
        out.with_name(f"{out.name}.checkpoint"), lambda done, _total, _loss: show(Progress(TRAINING, done, steps)),
    )  # fmt: skip
    save_field(out, trained.field)
