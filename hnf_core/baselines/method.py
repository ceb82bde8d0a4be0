"""What a rival and our own field have in common, so that one table can hold them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.recording import Recording
from ..material.mechanics import UNKNOWN_MECHANICS, Mechanics

Float = NDArray[np.float64]

Form = Literal["natural", "expected magnitude"]
"""natural: a signal to feel, one draw of a random process. expected magnitude: a signal whose |X_k| is the expected
one in every window, for benchmarks only. The two are never compared with each other."""


@dataclass(frozen=True)
class MaterialRecordings:
    """One material as a method may see it: what was felt on it, and what a sensor image and the library say of it.

    token: (TOKEN_DIM,) E(I), None where there is no picture. category: its class, empty where there is none.
    """

    name: str
    recordings: tuple[Recording, ...]
    token: NDArray[np.float32] | None = None
    mechanics: Mechanics = UNKNOWN_MECHANICS
    category: str = ""


class FittedMaterial(Protocol):
    """One material, learned."""

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """a(t) in m/s² at 10 kHz for each action, (round(duration_s · 10 000),) float64. Another seed, another draw;
        the same seed, the same bytes."""
        ...


class Method(Protocol):
    """A way to learn one material from recordings of it."""

    @property
    def name(self) -> str:
        """As the table prints it; a reconstruction of somebody else's method says so here."""
        ...

    @property
    def form(self) -> Form: ...

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Learn from specimen.recordings (all at one sample rate). Deterministic with a seed."""
        ...


class FittedSharedModel(Protocol):
    """Many materials, learned as one model."""

    def for_material(self, token: NDArray[np.float32], mechanics: Mechanics) -> FittedMaterial:
        """The model's opinion of a material, which need not be among those it was fitted to."""
        ...


class SharedMethod(Protocol):
    """A way to learn many materials at once, with the token as condition."""

    @property
    def name(self) -> str: ...

    @property
    def form(self) -> Form: ...

    def fit(self, specimens: Sequence[MaterialRecordings], seed: int) -> FittedSharedModel: ...
