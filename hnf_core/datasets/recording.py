"""What every data set is turned into: what a hand did, and what was felt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..errors import FileError


@dataclass(frozen=True)
class Recording:
    """One stroke of one material.

    action: u(t) from the same instant as the samples. samples: (n,) float64 a(t) in m/s², one axis, or three fused by
    DFT321 over the whole recording. sample_rate: Hz. material: its name in the data set. source: file or process.
    known: which of "direction", "speed", "force" were really recorded; the others hold a stated assumption.
    notes: what the loader assumed, in words.
    Raises FileError where samples are not finite or do not last as long as the action (to one action sample).
    """

    action: Action
    samples: NDArray[np.float64]
    sample_rate: float
    material: str
    source: str
    known: frozenset[str] = frozenset({"direction", "speed", "force"})
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        lasts = len(self.samples) / self.sample_rate if self.sample_rate > 0.0 else 0.0
        if self.samples.ndim != 1 or not np.isfinite(self.samples).all():
            raise FileError("its samples are not finite numbers.", where=self.source, remedy="Get the file again.")
        if abs(lasts - self.action.duration_s) > 1.5 / self.action.rate:
            raise FileError(
                f"{lasts:.3f} s of samples beside {self.action.duration_s:.3f} s of action.",
                where=self.source,
                remedy="Its sample rate or length is not what the file says.",
            )

    @property
    def duration_s(self) -> float:
        return len(self.samples) / self.sample_rate


class TextureProcess(Protocol):
    """Something that can be stroked as often as one likes: a simulated surface, a published texture model.

    A new seed is a new draw of the same process (noise, or another place on the surface): the oracle of evaluation.
    """

    @property
    def name(self) -> str: ...

    def record(self, actions: Sequence[Action], seed: int) -> list[Recording]:
        """One recording at 10 kHz per action. All actions of one call must be equally long."""
        ...
