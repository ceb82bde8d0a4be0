"""Learning one material for another program: what `hnf train field` does, told step by step to a function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import HnfError
from ..field.weights import save_field
from ..progress import Progress

STAGE_GATHERING, STAGE_TRAINING = "gathering recordings", "epoch"
"""Stages, in their order."""


@dataclass(frozen=True)
class LearnRequest:
    """kind, folder: of the data set (datasets.catalogue), "" = no folder. material: as the data set calls it. seconds:
    of strokes to synthesise, where it holds models. epochs: at most so many."""

    kind: str
    folder: str
    material: str
    seconds: float
    epochs: int


def learn_material(request: LearnRequest, out: Path, report_progress: Callable[[Progress], None]) -> None:
    """Train, and write the weights at out. A killed run goes on from the checkpoint beside it when the same lesson is
    asked for again. The last of the steps that show() is told of is the saving.

    Raises HnfError, also where a package is missing.
    """
    from ..datasets.registry import LICENCES, get_training_recordings, open_dataset

    steps = request.epochs + 1
    report_progress(Progress(STAGE_GATHERING, 0, 1))
    data = open_dataset(request.kind, Path(request.folder) if request.folder else None)
    data.process(request.material)  # a wrong name is told before torch is loaded
    try:
        from .from_recordings import TrainingOverrides, train_from_recordings
    except ImportError as error:
        raise HnfError(
            f"this Python cannot train ({error}).", remedy="Check it in the add-on's preferences."
        ) from error
    recordings = get_training_recordings(data, request.material, request.seconds, seed=0)
    report_progress(Progress(STAGE_TRAINING, 0, steps))
    trained, _ = train_from_recordings(
        recordings, request.kind, LICENCES[request.kind], 0, TrainingOverrides(epochs=request.epochs),
        out.with_name(f"{out.name}.checkpoint"), lambda done, _total, _loss: report_progress(Progress(STAGE_TRAINING,
        done, steps)),
    )  # fmt: skip
    save_field(out, trained.field)
