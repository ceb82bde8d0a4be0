"""Train a field from recordings of one material: choose the architecture, fit it, and describe it in its metadata."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.recording import Recording
from ..field.carriers import Carriers
from ..field.field import Field, FieldConfig
from ..material.contact_model import UNKNOWN_MECHANICS, Mechanics
from ..material.library import get_material
from ..material.token import TOKEN_DIM
from .simulated_strokes import FINE_BINS
from .train_material import ProgressCallback, Schedule, TrainingResult, train_material

Float = NDArray[np.float64]

FINE_BIN_HZ = 10.0
PAST_STATE_COUNT = 5
ARC_KINDS = ("own", "cluster", "simulated")
"""Data sets with tones whose frequency follows the speed, if the speed was recorded.

The models of HaTT hold none: each is a filter that changes with speed, and arc carriers would only duplicate it.
"""


@dataclass(frozen=True)
class TrainingOverrides:
    """Training settings given by the user; None for the value that is chosen to suit the data."""

    hidden: int | None = None
    layers: int | None = None
    states: int | None = None
    accumulation: Literal["past", "heads"] | None = None
    epochs: int | None = None


def make_fine_carriers(arc_octaves: int = 0) -> Carriers:
    """Build noise carriers in bands centred on 10, 20 … 1000 Hz, 10 Hz wide, then seven widening ones to 5 kHz."""
    fine = (np.arange(1, FINE_BINS + 1) + 0.5) * FINE_BIN_HZ
    edges = np.concatenate([[2.0], fine, fine[-1] * (5000.0 / fine[-1]) ** (np.arange(1, 8) / 7)])
    return Carriers(time_edges_hz=tuple(float(edge) for edge in edges), arc_octaves=arc_octaves)


def choose_config(recordings: Sequence[Recording], *, arc: bool, token_known: bool) -> FieldConfig:
    """Choose the architecture of the field that suits the recordings.

    The linear contact is used if the material's token is known, arc carriers (noise bands along the path) if asked for,
    direction if it was recorded, and N = 5 past states if hands stop or turn back, where they improve the result
    (docs/training.md). Otherwise N = 1 gives the same field with less work.
    """
    directed = any("direction" in recording.known for recording in recordings)
    states = PAST_STATE_COUNT if any(_has_reversals(recording.action) for recording in recordings) else 1
    if token_known:
        return FieldConfig(states=states, action_octaves=2, directed=directed)
    return FieldConfig(
        hidden=128, states=states, carriers=make_fine_carriers(Carriers().arc_octaves if arc else 0), physics=False,
        action_octaves=3, directed=directed,
    )  # fmt: skip


def _has_reversals(action: Action) -> bool:
    """Return True if the hand lifts, nearly stops (a tenth of its usual speed), or turns by over 90° within 50 ms."""
    moving = action.speed[action.contact & (action.speed > 0.0)]
    if len(moving) == 0:
        return False
    stops = bool(np.any(action.speed < 0.1 * np.median(moving)))
    lag = max(1, round(0.05 * action.rate))
    reverses = bool(np.any((action.direction[lag:] * action.direction[:-lag]).sum(axis=1) < 0.0))
    return stops or reverses or not bool(action.contact.all())


def train_from_recordings(
    recordings: Sequence[Recording],
    kind: str,
    licence: str,
    seed: int,
    overrides: TrainingOverrides,
    checkpoint: Path | None = None,
    watch: ProgressCallback | None = None,
) -> tuple[TrainingResult, dict[str, Any]]:
    """Train on recordings of one material, and describe the result.

    Parameters
    ----------
    recordings
        Recordings of one material.
    kind
        Kind of the data set they come from.
    licence
        Licence of the data set.
    seed
        Seed of the training.
    overrides
        Settings of the user.
    checkpoint
        File from which a killed run continues.
    watch
        Called after every epoch.

    Returns
    -------
    tuple
        The training result, with metadata in its field that `hnf synth --weights` needs, and a JSON-like summary of the
        run.

    Raises
    ------
    UsageError
        If the recordings are too short or of several probes.
    """
    name = recordings[0].material
    token, mechanics = _find_token_and_mechanics(kind, name)
    has_speed = any("speed" in recording.known for recording in recordings)
    config = choose_config(recordings, arc=has_speed and kind in ARC_KINDS, token_known=token is not None)
    overridden = {key: value for key, value in dataclasses.asdict(overrides).items() if value is not None}
    epochs = overridden.pop("epochs", Schedule().epochs)
    trained = train_material(
        recordings, dataclasses.replace(config, **overridden), seed, schedule=Schedule(epochs=epochs), token=token,
        mechanics=mechanics, checkpoint=checkpoint, watch=watch,
    )  # fmt: skip
    notes = sorted({note for recording in recordings for note in recording.notes})
    record = {
        "material": name,
        "training_data": f"{sum(recorded.duration_s for recorded in recordings):.0f} s of {kind} strokes",
        "seed": seed,
        "epochs": len(trained.history),
        "parameters": int(sum(np.prod(shape) for shape in trained.field.config.shapes().values())),
        "test": None if trained.test is None else dataclasses.asdict(trained.test),
        "notes": notes,
    }
    metadata = {
        "material": _format_material(name, token, mechanics),
        "training_data": "; ".join([str(record["training_data"]), *notes]),
        "seed": str(seed),
        "metrics": json.dumps(record["test"]),
        "licence": licence,
    }
    return dataclasses.replace(trained, field=_with_metadata(trained.field, metadata)), record


def _with_metadata(field: Field, metadata: Mapping[str, str]) -> Field:
    return dataclasses.replace(field, metadata=metadata)


def _find_token_and_mechanics(kind: str, name: str) -> tuple[NDArray[np.float32] | None, Mechanics]:
    """Return token and mechanics of a material from the library; None and unknown mechanics for other data."""
    if kind != "simulated":
        return None, UNKNOWN_MECHANICS
    material = get_material(name)
    return material.token, material.mechanics


def _format_material(name: str, token: NDArray[np.float32] | None, mechanics: Mechanics) -> str:
    values = [0.0] * TOKEN_DIM if token is None else [float(value) for value in token]
    return json.dumps({"name": name, "token": values, "mechanics": dataclasses.asdict(mechanics)})
