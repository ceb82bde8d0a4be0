"""Train a field on one material of a data set, with progress reports: `hnf train field` for other programs."""

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
    """Parameters of a training run.

    Attributes
    ----------
    kind
        Kind of data set, by its name in datasets.registry.
    folder
        Folder of the data set, "" for none.
    material
        Name of the material in the data set.
    seconds
        Duration of the recordings to simulate [s], if the data set holds models and no recordings.
    epochs
        Largest number of epochs.
    """

    kind: str
    folder: str
    material: str
    seconds: float
    epochs: int


def learn_material(request: LearnRequest, out: Path, report_progress: Callable[[Progress], None]) -> None:
    """Train on one material of a data set and write the weights.

    A killed run continues from the checkpoint beside `out` when the same request is made again. The last progress
    report comes when the weights are saved.

    Parameters
    ----------
    request
        What to train on.
    out
        Path of the weights.
    report_progress
        Called at the start and after every epoch.

    Raises
    ------
    HnfError
        If the data cannot be used, or a package is missing.
    """
    from ..datasets.registry import LICENCES, get_training_recordings, open_dataset

    report_progress(Progress(STAGE_GATHERING, 0, 1))
    data = open_dataset(request.kind, Path(request.folder) if request.folder else None)
    process = data.process(request.material)  # Refuses a wrong name before torch is loaded.
    try:
        from .from_recordings import COMPARED_EPOCHS, TrainingOverrides, train_from_recordings
    except ImportError as error:
        raise HnfError(
            f"this Python cannot train ({error}).", remedy="Check it in the add-on's preferences."
        ) from error
    recordings = get_training_recordings(data, request.material, request.seconds, seed=0)
    report_progress(Progress(STAGE_TRAINING, 0, request.epochs + 1))
    trained, _ = train_from_recordings(
        recordings, request.kind, LICENCES[request.kind], 0, TrainingOverrides(epochs=request.epochs),
        out.with_name(f"{out.name}.checkpoint"),
        lambda done, total, _loss: report_progress(Progress(STAGE_TRAINING, done, total + 1)),
        # A quick try is not made three times as long to find the best form.
        compare=process is None and request.epochs > COMPARED_EPOCHS,
    )  # fmt: skip
    save_field(out, trained.field)
