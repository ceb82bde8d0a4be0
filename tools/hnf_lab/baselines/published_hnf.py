"""Baseline: HNF as published, as `hnf train field --form published` trains it, rendered without anything added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.datasets.recording import Recording
from hnf_core.field.field import Field, FieldConfig
from hnf_core.field.prepare import prepare_stroke, reads_raw_action
from hnf_core.field.render import render_carriers
from hnf_core.field.stroke import uniform_stroke
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import TOKEN_DIM
from hnf_core.training.train_material import Schedule, train_material

from .interface import FittedMaterial, Form, MaterialRecordings

Float = NDArray[np.float64]


@dataclass(frozen=True)
class PublishedHnf:
    """The paper's model, loss and schedule.

    Attributes
    ----------
    epochs
        Epochs; 100 as published.
    seconds
        Duration of the recordings used [s]; 20 fill the paper's 200 windows.
    raw
        Train on the recordings' raw actions.
    added
        Strokes of HNF+ in addition.
    """

    config: FieldConfig = field(default_factory=FieldConfig.published)
    epochs: int = 100
    seconds: float = 20.0
    raw: bool = False
    added: tuple[Recording, ...] = ()
    name: str = "HNF, literal"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Minimise L_mag by Adam and return the epoch with the least validation loss. Deterministic.

        Raises
        ------
        UsageError
            If there are fewer than 10 windows, or no raw actions where they are asked for.
        """
        token = np.zeros(TOKEN_DIM, dtype=np.float32) if specimen.token is None else specimen.token
        trained = train_material(
            select_seconds(specimen.recordings, self.seconds), self.config, seed,
            schedule=Schedule.published(self.epochs), token=token, mechanics=specimen.mechanics, added=self.added,
            raw=self.raw,
        )  # fmt: skip
        return FittedPublishedHnf(trained.field, token, specimen.mechanics)


@dataclass(frozen=True)
class FittedPublishedHnf:
    """The model of one material. It has no randomness: every seed gives the same signal."""

    field: Field
    token: NDArray[np.float32]
    mechanics: Mechanics

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """Render by temporal rendering only, without the product's contact transients."""
        signals = []
        for action in actions:
            stroke = uniform_stroke(action, self.token, self.mechanics)
            prepared = prepare_stroke(self.field, stroke, seed=seed)
            raw = prepared.motion if reads_raw_action(self.field, stroke) else None
            signals.append(render_carriers(prepared, 0, prepared.count) if raw is None else raw)
        return signals


def select_seconds(recordings: Sequence[Recording], seconds: float) -> list[Recording]:
    """Return recordings of about `seconds` in all, spread evenly over those given; one at least."""
    wanted = round(seconds / max(float(np.mean([recording.duration_s for recording in recordings])), 1e-9))
    index = np.linspace(0, len(recordings) - 1, min(max(wanted, 1), len(recordings))).round().astype(int)
    return [recordings[row] for row in np.unique(index)]
