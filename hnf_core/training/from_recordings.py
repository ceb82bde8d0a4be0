"""From recordings of one material to a field that names what it is, what it was trained on and how well."""

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
"""Data in which tones glide with the speed, where that was recorded. HaTT's models hold none: each is a filter that
changes with speed, and arc carriers would only be a second way to say the same."""


@dataclass(frozen=True)
class TrainingOverrides:
    """What a user may set; None = as the data suggest."""

    hidden: int | None = None
    layers: int | None = None
    states: int | None = None
    accumulation: Literal["past", "heads"] | None = None
    epochs: int | None = None


def make_fine_carriers(arc_octaves: int = 0) -> Carriers:
    """Time carriers centred on the bins 10, 20 … 1000 Hz, one bin wide, then seven widening bands to 5 kHz."""
    fine = (np.arange(1, FINE_BINS + 1) + 0.5) * FINE_BIN_HZ
    edges = np.concatenate([[2.0], fine, fine[-1] * (5000.0 / fine[-1]) ** (np.arange(1, 8) / 7)])
    return Carriers(time_edges_hz=tuple(float(edge) for edge in edges), arc_octaves=arc_octaves)


def choose_config(recordings: Sequence[Recording], *, arc: bool, token_known: bool) -> FieldConfig:
    """The architecture that suits what is known: the linear contact where there is a token, arc carriers where asked
    for, direction only where it was recorded, and N = 5 past states where hands stop or turn back. There accumulation
    wins (docs/training.md); elsewhere strokes tell nothing of memory, and N = 1 is the same field for less work.
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
    """Whether the hand nearly stops (a tenth of its usual speed), lifts, or reverses within 50 ms."""
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
    """Train on recordings of one material of a data set of that kind; also a record of it for people and programs.

    The field carries in its metadata what `hnf synth --weights` needs. Raises UsageError, see train_material.
    """
    name = recordings[0].material
    token, mechanics = _find_token_and_mechanics(kind, name)
    paced = any("speed" in recording.known for recording in recordings)
    config = choose_config(recordings, arc=paced and kind in ARC_KINDS, token_known=token is not None)
    chosen = {key: value for key, value in dataclasses.asdict(overrides).items() if value is not None}
    epochs = chosen.pop("epochs", Schedule().epochs)
    trained = train_material(
        recordings, dataclasses.replace(config, **chosen), seed, schedule=Schedule(epochs=epochs), token=token,
        mechanics=mechanics, checkpoint=checkpoint, watch=watch,
    )  # fmt: skip
    notes = sorted({note for recording in recordings for note in recording.notes})
    record = {
        "material": name,
        "training_data": f"{sum(each.duration_s for each in recordings):.0f} s of {kind} strokes",
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
    """Token and mechanics where they are known: of library materials."""
    if kind != "simulated":
        return None, UNKNOWN_MECHANICS
    material = get_material(name)
    return material.token, material.mechanics


def _format_material(name: str, token: NDArray[np.float32] | None, mechanics: Mechanics) -> str:
    values = [0.0] * TOKEN_DIM if token is None else [float(value) for value in token]
    return json.dumps({"name": name, "token": values, "mechanics": dataclasses.asdict(mechanics)})
