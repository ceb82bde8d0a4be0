"""Our own field as a method: trained on one material, or one field for all by its token; natural and for benchmarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..baselines.method import FittedMaterial, Form, MaterialRecordings
from ..errors import UsageError
from ..field.field import Field
from ..field.many_strokes import synthesise_many
from ..field.stroke import uniform_stroke
from ..material.mechanics import Mechanics
from ..material.token import TOKEN_DIM
from .expected_magnitude import synthesise_expected_magnitude

Float = NDArray[np.float64]
_SEEDS_PER_CALL = 1000


@dataclass(frozen=True)
class FittedField:
    """A field and the material it is asked about."""

    field: Field
    token: NDArray[np.float32]
    mechanics: Mechanics
    form: Form = "natural"

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """By the product's own synthesis; action i of a call has a seed of its own."""
        strokes = [uniform_stroke(action, self.token, self.mechanics) for action in actions]
        if self.form == "expected magnitude":
            return [synthesise_expected_magnitude(self.field, stroke) for stroke in strokes]
        first = _SEEDS_PER_CALL * seed
        made = synthesise_many(self.field, strokes, seeds=range(first, first + len(strokes)))
        return [each.signal.samples.astype(np.float64) for each in made]


@dataclass(frozen=True)
class TrainedField:
    """Method: the field trained on one material's recordings, as `hnf train field` does. epochs: None = the trainer's
    own schedule."""

    name: str = "field, per material"
    form: Form = "natural"
    epochs: int | None = None

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        from ..training.material import Schedule, train_material
        from ..training.own_material import choose_config

        recordings = list(specimen.recordings)
        config = choose_config(recordings, arc=specimen.token is not None, token_known=specimen.token is not None)
        schedule = Schedule() if self.epochs is None else Schedule(epochs=self.epochs)
        trained = train_material(
            recordings, config, seed, schedule=schedule, token=specimen.token, mechanics=specimen.mechanics
        )
        token = np.zeros(TOKEN_DIM, dtype=np.float32) if specimen.token is None else specimen.token
        return FittedField(trained.field, token, specimen.mechanics, self.form)


@dataclass(frozen=True)
class SharedField:
    """Method: one field for all materials, given this one's token and mechanics only. It learns nothing from the
    recordings, and may or may not have met the material in training: its weights say."""

    field: Field
    name: str = "field, shared"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Raises UsageError for a material without a token."""
        del seed
        if specimen.token is None:
            raise UsageError(
                f"'{specimen.name}' has no token.", remedy="The shared field needs one; leave it out here."
            )
        return FittedField(self.field, specimen.token, specimen.mechanics, self.form)
