"""Recordings, and the interface of texture data sets: what a hand did, and the acceleration that it felt.

Every reader of this package converts its data to `Recording`; `DataSet` is the interface of all of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..action.action import MAX_HAND_SPEED_M_S, Action
from ..errors import FileError, MaterialError


@dataclass(frozen=True)
class Recording:
    """One stroke of one material.

    Attributes
    ----------
    action : Action
        u(t), from the same instant as the samples.
    samples : ndarray of float64, shape (n,)
        Acceleration [m/s²], one axis or three fused by DFT321.
    sample_rate : float
        Sample rate [Hz].
    material : str
        Name in the data set.
    source : str
        File or process, for messages.
    known : frozenset of str
        Quantities of "direction", "speed", "force" that were recorded; others are assumed.
    notes : tuple of str
        Assumptions of the reader.
    measured_rate : float or None
        Rate of the sensor, if the samples were brought from it to a higher one [Hz]: nothing is known above half of it.
    measure_raw_action : callable or None
        Returns the action as its sensors recorded it, at the rate of the samples and with the vibration in it; None
        where no sensor did.

    Raises
    ------
    FileError
        If samples are not finite, or not as long as the action (to one action sample).
    """

    action: Action
    samples: NDArray[np.float64]
    sample_rate: float
    material: str
    source: str
    known: frozenset[str] = frozenset({"direction", "speed", "force"})
    notes: tuple[str, ...] = ()
    measure_raw_action: Callable[[], Action] | None = None
    measured_rate: float | None = None

    def __post_init__(self) -> None:
        duration = len(self.samples) / self.sample_rate if self.sample_rate > 0.0 else 0.0
        if self.samples.ndim != 1 or not np.isfinite(self.samples).all():
            raise FileError("its samples are not finite numbers.", where=self.source, remedy="Get the file again.")
        if abs(duration - self.action.duration_s) > 1.5 / self.action.rate:
            raise FileError(
                f"{duration:.3f} s of samples beside {self.action.duration_s:.3f} s of action.",
                where=self.source,
                remedy="Its sample rate or length is not what the file says.",
            )

    @property
    def duration_s(self) -> float:
        """Duration of the samples [s]."""
        return len(self.samples) / self.sample_rate


LOUDEST_RMS_M_S2 = 300.0
"""RMS from which an acceleration's unit is doubted [m/s²], some 30 times gravity."""


def find_doubts(recordings: Iterable[Recording]) -> list[str]:
    """Return what readers assumed of recordings, and what is hardly in the unit it is taken for; one text for each."""
    doubts: dict[str, None] = {}
    for recording in recordings:
        doubts |= dict.fromkeys(recording.notes)
        rms = float(np.sqrt(np.mean(np.square(recording.samples))))
        fastest = float(np.max(recording.action.speed, initial=0.0))
        if rms > LOUDEST_RMS_M_S2:
            doubts[f"{recording.source}: {rms:.0f} m/s² RMS: is its acceleration in m/s²?"] = None
        if "speed" in recording.known and fastest > MAX_HAND_SPEED_M_S:
            doubts[f"{recording.source}: its speed reaches {fastest:.4g} m/s: is it, or its x and y, in mm?"] = None
    return list(doubts)


class TextureProcess(Protocol):
    """Interface of materials that can be stroked any number of times: a simulated surface, a published texture model.

    A new seed is a new draw of the same process (noise, or another position on the surface); evaluation uses it as an
    oracle.
    """

    @property
    def name(self) -> str:
        """Name of the material."""
        ...

    def record(self, actions: Sequence[Action], seed: int) -> list[Recording]:
        """Return one recording at 10 kHz per action; all actions of a call must be equally long."""
        ...


@dataclass(frozen=True)
class ActionRange:
    """Ranges (low, high), above 0, of the actions in a texture's data, as `make_random_smooth_action` takes them.

    Attributes
    ----------
    speed_m_s : tuple of float
        Speed [m/s].
    force_n : tuple of float
        Normal force [N].
    angle_rad : tuple of float
        Directions [rad]; a full circle if the data are independent of direction.
    """

    speed_m_s: tuple[float, float]
    force_n: tuple[float, float]
    angle_rad: tuple[float, float] = (0.0, 2.0 * np.pi)


class DataSet(Protocol):
    """Interface of texture data sets.

    Names are compared without case, blanks and underscores; an unknown one raises MaterialError with close matches.
    """

    @property
    def materials(self) -> tuple[str, ...]:
        """Sorted names of the materials; raises FileError if the folder holds nothing of the data set."""
        ...

    def recordings(self, name: str) -> list[Recording]:
        """Return all recordings of a material, empty if the data set has models only."""
        ...

    def process(self, name: str) -> TextureProcess | None:
        """Return a process that can be stroked anew; None if there are recordings only."""
        ...

    def action_range(self, name: str) -> ActionRange:
        """Return the range of actions in a material's data."""
        ...

    def image(self, name: str) -> Path | None:
        """Return a photograph of the material, or None."""
        ...


def compute_action_range(recordings: Sequence[Recording]) -> ActionRange:
    """Return the 5th to 95th percentile of speed and force while in contact and moving.

    Raises FileError if there is no such moment.
    """
    speed = np.concatenate([recording.action.speed for recording in recordings] or [np.zeros(0)])
    force = np.concatenate([recording.action.force for recording in recordings] or [np.zeros(0)])
    touching = (force > 0.0) & (speed > 0.0)
    if not touching.any():
        where = recordings[0].source if recordings else ""
        raise FileError("nothing is touched in it while moving.", where=where, remedy="Choose another material.")
    speeds, forces = (np.percentile(values[touching], [5.0, 95.0]) for values in (speed, force))
    return ActionRange((float(speeds[0]), float(speeds[1])), (float(forces[0]), float(forces[1])))


def normalise_name(name: str) -> str:
    """Reduce a name to lower-case letters and digits: "ABS_plastic" and "ABS Plastic" are the same material."""
    return re.sub(r"[\W_]+", "", name.lower())


def match_name(name: str, materials: Iterable[str], where: str) -> str:
    """Return the material with the same normalised name; raise MaterialError with close matches if there is none."""
    by_plain = {normalise_name(material): material for material in materials}
    matched = by_plain.get(normalise_name(name))
    if matched is not None:
        return matched
    close_keys = get_close_matches(normalise_name(name), by_plain, 5, 0.5)
    listed = [by_plain[key] for key in close_keys] or sorted(by_plain.values())[:8]
    raise MaterialError(
        f"no material is called {name!r}.",
        where=where,
        remedy=f"{'Near ones' if close_keys else 'There are'}: {', '.join(listed)}." if listed else "It has none.",
    )
