"""What every data set can be asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import FileError
from .recording import Recording, TextureProcess


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
