"""The oracle: the true process itself with another seed. Nothing can be better in natural form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.recording import TextureProcess
from .by_duration import render_by_duration
from .method import FittedMaterial, Form, MaterialRecordings

Float = NDArray[np.float64]

_SEED_OFFSET = 0x5EED_0000_0000
"""Far from any seed a person gives, so that the oracle is never the very draw it is compared with."""


@dataclass(frozen=True)
class FittedProcess:
    """A process as it is."""

    process: TextureProcess

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """A seed of this call is never that of a recording: it is moved into numbers of its own."""
        own = _SEED_OFFSET + 1000 * seed
        return render_by_duration(
            actions, lambda same, group: [r.samples for r in self.process.record(same, own + group)]
        )


@dataclass(frozen=True)
class OracleMethod:
    """Method: the process that made the recordings."""

    process: TextureProcess
    name: str = "oracle (true process, another seed)"
    form: Form = "natural"

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        """Nothing is learned."""
        del specimen, seed
        return FittedProcess(self.process)
