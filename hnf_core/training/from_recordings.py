"""Train a field from recordings of one material: choose the architecture, fit it, and describe it in its metadata.

Where that is not known beforehand, the data choose: past states and the token of the library's material of that name
are taken where they lower the loss of the validation windows.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.recording import Recording
from ..errors import MaterialError, UsageError, pluralize
from ..field.carriers import Carriers
from ..field.field import FieldConfig
from ..material.contact_model import UNKNOWN_MECHANICS, Mechanics
from ..material.library import LibraryMaterial, get_material
from ..material.ranking import find_material
from ..material.token import TOKEN_DIM
from ..metrics.spectra import BIN_COUNT, WINDOW_SAMPLES
from .train_material import ProgressCallback, Schedule, TrainingResult, train_material
from .windows import FINE_BINS

Float = NDArray[np.float64]

FINE_BIN_HZ = 10.0
PAST_STATE_COUNT = 5
COMPARED_EPOCHS = 10
"""Epochs after which forms of the field are compared; the one that validates best is then trained to the end."""
ARC_KINDS = ("own", "cluster", "simulated")
"""Data sets with tones whose frequency follows the speed, if the speed was recorded.

The models of HaTT hold none: each is a filter that changes with speed, and arc carriers would only duplicate it.
"""


@dataclass(frozen=True)
class TrainingOverrides:
    """Training settings given by the user; None for the value that is chosen to suit the data.

    Attributes
    ----------
    form
        "carriers", or "published" for the paper's literal model, loss and schedule.
    actions
        "raw" to train the published form on the actions as sensors recorded them, else at the bandwidth of a hand.
    augment
        True to add the recordings played backward, as if the hand had moved the other way.
    """

    hidden: int | None = None
    layers: int | None = None
    states: int | None = None
    accumulation: Literal["past", "heads"] | None = None
    epochs: int | None = None
    form: Literal["carriers", "published"] = "carriers"
    actions: Literal["raw", "low-passed"] = "low-passed"
    augment: bool = False

    @property
    def fixes_states(self) -> bool:
        """True if the user said how many states there are, or how they are summed."""
        return self.states is not None or self.accumulation is not None


@dataclass(frozen=True)
class Attempt:
    """A form of the field that is tried: its name, architecture, and what is known of the material."""

    name: str
    config: FieldConfig
    token: NDArray[np.float32] | None = None
    mechanics: Mechanics = UNKNOWN_MECHANICS


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
    *,
    added: Sequence[Recording] = (),
    compare: bool = False,
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
    added
        Further strokes, for training alone.
    compare
        Try also past states and the token of the library's material of that name, and keep what validates best.

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
    attempts = _list_attempts(recordings, kind, overrides, compare=compare)
    if overrides.augment and not any(attempt.config.directed for attempt in attempts):
        raise UsageError(
            "--augment turns directions around, and none was recorded.",
            remedy="Leave it out, or record x and y of the tip, which give the direction.",
        )
    make = Schedule.published if overrides.form == "published" else Schedule
    schedule = make() if overrides.epochs is None else make(overrides.epochs)
    compared = dataclasses.replace(schedule, epochs=min(schedule.epochs, COMPARED_EPOCHS))
    best, losses = attempts[0], list[float]()
    total = schedule.epochs + (len(attempts) * compared.epochs if len(attempts) > 1 else 0)

    def train(attempt: Attempt, schedule: Schedule, path: Path | None, before: int) -> TrainingResult:
        return train_material(
            recordings, attempt.config, seed, schedule=schedule, token=attempt.token, mechanics=attempt.mechanics,
            checkpoint=path, watch=watch and (lambda done, _, loss: watch(before + done, total, loss)), added=added,
            raw=overrides.actions == "raw", add_reversed=overrides.augment, keep_checkpoint=True,
        )  # fmt: skip

    paths = [checkpoint and checkpoint.with_suffix(f".{number}.checkpoint") for number in range(len(attempts))]
    for number, attempt in enumerate(attempts if len(attempts) > 1 else ()):
        if attempt.token is not None:  # tried last, with as many states as have won
            attempt = dataclasses.replace(
                attempt, config=dataclasses.replace(attempt.config, states=best.config.states)
            )
        result = train(attempt, compared, paths[number], number * compared.epochs)
        losses.append(float(result.history[:, 2].min()))
        best = attempt if losses[-1] == min(losses) else best
    trained = train(best, schedule, checkpoint, total - schedule.epochs)
    for path in (checkpoint, *paths):
        if path is not None:
            path.unlink(missing_ok=True)
    notes = sorted({note for recording in recordings for note in recording.notes})
    notes += ["each training window backward too, in the opposite direction"] if overrides.augment else []
    seconds = [sum(recorded.duration_s for recorded in strokes) for strokes in (recordings, added)]
    config = trained.field.config
    record = {
        "material": name,
        "training_data": f"{seconds[0]:.0f} s of {kind} strokes"
        + (f", {seconds[1]:.0f} s of primitives added" if added else ""),
        "seed": seed,
        "settings": _format_settings(overrides, config, schedule),
        "choice": _format_choice(attempts, losses, best, compared.epochs) if losses else "",
        "epochs": len(trained.history),
        "parameters": int(sum(np.prod(shape) for shape in config.shapes().values())),
        "test": None if trained.test is None else dataclasses.asdict(trained.test),
        "notes": notes,
    }
    metadata = {
        "material": _format_material(name, best.token, best.mechanics),
        "training_data": "; ".join([str(record["training_data"]), *notes]),
        "seed": str(seed),
        "metrics": json.dumps(record["test"]),
        "licence": licence,
        "settings": str(record["settings"]),
        "choice": str(record["choice"]),
        "actions": overrides.actions,
    }
    return dataclasses.replace(trained, field=dataclasses.replace(trained.field, metadata=metadata)), record


def _list_attempts(
    recordings: Sequence[Recording], kind: str, overrides: TrainingOverrides, *, compare: bool
) -> list[Attempt]:
    """Return the form to train or, to be compared, N = 1, past states and the material's token, in this order."""
    token, mechanics = _find_token_and_mechanics(kind, recordings[0].material)
    if overrides.form == "published":
        return [Attempt("published", _override(FieldConfig.published(), overrides), token, mechanics)]
    has_speed = any("speed" in recording.known for recording in recordings)
    chosen = choose_config(recordings, arc=has_speed and kind in ARC_KINDS, token_known=token is not None)
    if not compare:
        return [Attempt("chosen", _override(chosen, overrides), token, mechanics)]
    attempts = [
        Attempt(
            f"N = {states}{' past states' if states > 1 else ''}",
            _override(dataclasses.replace(chosen, states=states), overrides),
        )
        for states in ((chosen.states,) if overrides.fixes_states else (1, PAST_STATE_COUNT))
    ]
    try:
        known: LibraryMaterial = find_material(recordings[0].material)[0]
    except MaterialError:
        return attempts
    config = choose_config(recordings, arc=False, token_known=True)
    return [
        *attempts,
        Attempt(f"token of {known.name}", _override(config, overrides), known.token, known.mechanics),
    ]


def _override(config: FieldConfig, overrides: TrainingOverrides) -> FieldConfig:
    """Return an architecture with what the user gave of it."""
    given = {name: getattr(overrides, name) for name in ("hidden", "layers", "states", "accumulation")}
    return dataclasses.replace(config, **{name: value for name, value in given.items() if value is not None})


def _format_settings(overrides: TrainingOverrides, config: FieldConfig, schedule: Schedule) -> str:
    """Describe how a field was trained, for its metadata and the printed line."""
    size = f"N = {config.states}{' heads' if config.alpha_heads > 1 else ''}, L = {config.layers}, H = {config.hidden}"
    if overrides.form != "published":
        return size
    return (
        f"published form: {size}, L_mag over C = {schedule.batch} windows of {WINDOW_SAMPLES} samples, "
        f"K = {BIN_COUNT}, 1 kHz low-pass, Adam {schedule.learning_rate:g} with a cosine, "
        f"{pluralize(schedule.epochs, 'epoch')}, split 8/1/1, {overrides.actions} actions"
    )


def _format_choice(attempts: Sequence[Attempt], losses: Sequence[float], best: Attempt, epochs: int) -> str:
    """Say which attempt was taken, with the loss of the validation windows of each."""
    figures = ", ".join(f"{attempt.name} {loss:.4f}" for attempt, loss in zip(attempts, losses, strict=True))
    states = f" with N = {best.config.states}" if best.token is not None else ""
    return f"took {best.name}{states} (loss of the validation windows after {pluralize(epochs, 'epoch')}: {figures})"


def _find_token_and_mechanics(kind: str, name: str) -> tuple[NDArray[np.float32] | None, Mechanics]:
    """Return the library's token and mechanics of the material `name` if the data set of this kind uses its names.

    For other kinds of data sets: None, and mechanics that are unknown.
    """
    if kind != "simulated":
        return None, UNKNOWN_MECHANICS
    material = get_material(name)
    return material.token, material.mechanics


def _format_material(name: str, token: NDArray[np.float32] | None, mechanics: Mechanics) -> str:
    values = [0.0] * TOKEN_DIM if token is None else [float(value) for value in token]
    return json.dumps({"name": name, "token": values, "mechanics": dataclasses.asdict(mechanics)})
