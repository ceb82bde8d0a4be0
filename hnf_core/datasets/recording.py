"""What every data set is turned into: what a hand did, and what was felt.

What every data set can be asked.

Finding a material by a name that a person types.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..errors import FileError, MaterialError


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


@dataclass(frozen=True)
class ActionRange:
    """Limits (low, high), all above 0, that wandering_action takes: where a texture's data really lie.

    angle_rad: directions that differ in the data; a full circle where the data do not know direction.
    """

    speed_m_s: tuple[float, float]
    force_n: tuple[float, float]
    angle_rad: tuple[float, float] = (0.0, 2.0 * np.pi)


class DataSet(Protocol):
    """Names are matched without case, blanks and underscores; an unknown one raises MaterialError with near ones."""

    @property
    def materials(self) -> tuple[str, ...]:
        """Sorted names. Raises FileError where the folder holds nothing of the data set."""
        ...

    def recordings(self, name: str) -> list[Recording]:
        """Everything recorded of a material, empty where the data set holds models only."""
        ...

    def process(self, name: str) -> TextureProcess | None:
        """What can be stroked anew; None where there are recordings only."""
        ...

    def action_range(self, name: str) -> ActionRange: ...

    def image(self, name: str) -> Path | None:
        """A photograph of the material, where there is one."""
        ...


def compute_action_range(recordings: Sequence[Recording]) -> ActionRange:
    """What recorded strokes cover: 5th to 95th percentile of speed and force while in contact and moving.

    Raises FileError where there is no such moment.
    """
    speed = np.concatenate([recording.action.speed for recording in recordings] or [np.zeros(0)])
    force = np.concatenate([recording.action.force for recording in recordings] or [np.zeros(0)])
    touching = (force > 0.0) & (speed > 0.0)
    if not touching.any():
        where = recordings[0].source if recordings else ""
        raise FileError("nothing is touched in it while moving.", where=where, remedy="Choose another material.")
    speeds, forces = (np.percentile(each[touching], [5.0, 95.0]) for each in (speed, force))
    return ActionRange((float(speeds[0]), float(speeds[1])), (float(forces[0]), float(forces[1])))


def normalise_name(name: str) -> str:
    """Lower case, letters and digits only: "ABS_plastic" and "ABS Plastic" are one material."""
    return re.sub(r"[\W_]+", "", name.lower())


def match_name(name: str, materials: Iterable[str], where: str) -> str:
    """The material of that plain name. Raises MaterialError that lists near ones."""
    by_plain = {normalise_name(material): material for material in materials}
    found = by_plain.get(normalise_name(name))
    if found is not None:
        return found
    close = get_close_matches(normalise_name(name), by_plain, 5, 0.5)
    listed = [by_plain[each] for each in close] or sorted(by_plain.values())[:8]
    raise MaterialError(
        f"no material is called {name!r}.",
        where=where,
        remedy=f"{'Near ones' if close else 'There are'}: {', '.join(listed)}." if listed else "It has none.",
    )
