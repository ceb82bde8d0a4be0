"""What encoders are trained on and judged by: the project's own pairs, or copies of published sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...datasets.hatt_touch import HattTouchFolder
from ...datasets.tactile_pairs import (
    HELD_OUT_CLASSES,
    HELD_OUT_INSTANCES,
    PAIR_SENSORS,
    TRAIN,
    UNSEEN_CLASSES,
    load_pairs,
)
from ...datasets.tarf import TarfFolder
from ...datasets.touch_and_go import TouchAndGoFolder
from ...datasets.vision_touch import FilePairs, readable
from ...errors import FileError, UsageError
from ...simulation.classes import classes
from .tuples import Tuples, dealt, recorded, under

KINDS = MappingProxyType({"pairs": 1, "tarf": 1, "touch-and-go": 1, "hatt": 2})
"""How many folders each kind of data has: HaTT's photographs and the GelSight images of its textures."""
MET = tuple(name for name in classes() if name not in UNSEEN_CLASSES)


@dataclass(frozen=True)
class Judged:
    """known: sensor → tuples of new pieces or places; unseen: of classes that encoders have not met, empty where there
    are none. apart: for bridging, sensor → which of its known tuples to take, so that no place is touched by both; None
    where only one sensor touched."""

    known: Mapping[str, Tuples]
    unseen: Mapping[str, Tuples]
    apart: Mapping[str, NDArray[np.bool_]] | None


class Source(Protocol):
    """told: in words, what was read and what had to be left out; complete once everything was read."""

    @property
    def told(self) -> Sequence[str]: ...

    def learn(self) -> Tuples:
        """Raises FileError."""
        ...

    def judge(self) -> Judged:
        """Of places that `learn` has not. Raises FileError."""
        ...


def open_source(sets: Sequence[Sequence[str]]) -> Source:
    """sets: words KIND FOLDER…, or a FOLDER of the project's own pairs. Published sets may stand together, as GelSight
    and DIGIT come from different ones. Raises UsageError."""
    named = [tuple(words) if words[0] in KINDS else ("pairs", *words) for words in sets]
    for kind, *folders in named:
        if len(folders) != KINDS[kind]:
            raise UsageError(
                f"--data {kind} takes {KINDS[kind]} folder(s), not {len(folders)}.",
                remedy=f"Kinds are {', '.join(KINDS)}; quote a path with blanks.",
            )
    kinds = [kind for kind, *_ in named]
    if "pairs" in kinds:
        if len(named) > 1:
            raise UsageError("the project's own pairs stand alone.", remedy="Give --data once.")
        return GeneratedSource(Path(named[0][1]))
    return RecordedSource(tuple((kind, tuple(map(Path, folders))) for kind, *folders in named))


@dataclass(frozen=True)
class GeneratedSource:
    """Pairs that tools/make_tactile_pairs.py has put into a folder."""

    folder: Path

    @property
    def told(self) -> Sequence[str]:
        return ("generated pairs of this project",)

    def learn(self) -> Tuples:
        return dealt(load_pairs(self.folder, TRAIN), MET)

    def judge(self) -> Judged:
        pairs = load_pairs(self.folder, HELD_OUT_INSTANCES)
        strangers = load_pairs(self.folder, HELD_OUT_CLASSES)
        known = {sensor: under(pairs, sensor, MET) for sensor in PAIR_SENSORS}
        patch = pairs.patch[pairs.tile_index]
        return Judged(
            known=known,
            unseen={sensor: under(strangers, sensor, UNSEEN_CLASSES) for sensor in PAIR_SENSORS},
            apart={sensor: patch[known[sensor].row] == side for side, sensor in enumerate(PAIR_SENSORS)},
        )


@dataclass(frozen=True)
class RecordedSource:
    """Users' copies of published sets: (kind, folders)."""

    sets: tuple[tuple[str, tuple[Path, ...]], ...]
    told: list[str] = field(default_factory=list)

    def learn(self) -> Tuples:
        parts = [part for one in self.sets for part in _parts(*one, "train")]
        return self._read(parts, _labels(parts))

    def judge(self) -> Judged:
        met = _labels([part for one in self.sets for part in _parts(*one, "train")])
        tuples = self._read([part for one in self.sets for part in _parts(*one, "test")], met)
        touched = [make for make in range(len(PAIR_SENSORS)) if (tuples.sensor == make).any()]
        known = {PAIR_SENSORS[make]: tuples.of_sensor(PAIR_SENSORS[make]) for make in touched}
        named = {sensor: each.label >= 0 for sensor, each in known.items()}
        both = len(named) == len(PAIR_SENSORS) and all(each.any() for each in named.values())
        return Judged(known, {}, named if both else None)

    def _read(self, parts: Sequence[FilePairs], met: Sequence[str]) -> Tuples:
        skipped: list[FileError] = []
        tuples = recorded((pair for part in parts for pair in readable(part, skipped)), met)
        self.told.extend(note for part in parts for note in part.notes)
        if skipped:
            self.told.append(f"{len(skipped)} pairs could not be read, the first: {skipped[0]}")
        return tuples


def _parts(kind: str, folders: Sequence[Path], split: str) -> list[FilePairs]:
    """The pairs of one set for a split; what is for validation is learned from too. HaTT has one photograph of each
    material: of its touch images every fifth is for the test, and the look is one that was learned from."""
    if kind == "hatt":
        pairs = HattTouchFolder(folders[0], folders[1]).pairs
        chosen = (entry for place, entry in enumerate(pairs.entries) if (place % 5 == 4) == (split == "test"))
        return [replace(pairs, entries=tuple(chosen))]
    data = TarfFolder(folders[0]) if kind == "tarf" else TouchAndGoFolder(folders[0])
    return [data.split(name) for name in (("train", "val") if split == "train" else ("test",))]


def _labels(parts: Sequence[FilePairs]) -> tuple[str, ...]:
    return tuple(sorted({label for part in parts for label in part.labels if label is not None}))


def labelled(tuples: Tuples, most: int, seed: int) -> Tuples:
    """At most so many of those with a label, drawn without replacement, in their order."""
    rows = np.flatnonzero(tuples.label >= 0)
    drawn = np.random.default_rng(seed).permutation(rows)[:most]
    return tuples.take(np.sort(drawn))
