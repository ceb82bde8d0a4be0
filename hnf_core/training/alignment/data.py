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
from ...datasets.vision_touch import FilePairs, iterate_readable
from ...errors import FileError, UsageError
from ...simulation.classes import list_classes
from .tuples import Tuples, make_recorded_tuples, make_test_tuples, make_training_tuples

FOLDER_COUNTS = MappingProxyType({"pairs": 1, "tarf": 1, "touch-and-go": 1, "hatt": 2})
"""How many folders each kind of data has: HaTT's photographs and the GelSight images of its textures."""
TRAINING_CLASSES = tuple(name for name in list_classes() if name not in UNSEEN_CLASSES)


@dataclass(frozen=True)
class HeldOutTuples:
    """known: sensor → tuples of new pieces or places; unseen: of classes that encoders have not met, empty where there
    are none. apart: for bridging, sensor → which of its known tuples to take, so that no place is touched by both; None
    where only one sensor touched."""

    known: Mapping[str, Tuples]
    unseen: Mapping[str, Tuples]
    disjoint: Mapping[str, NDArray[np.bool_]] | None


class Source(Protocol):
    """told: in words, what was read and what had to be left out; complete once everything was read."""

    @property
    def messages(self) -> Sequence[str]: ...

    def load_training(self) -> Tuples:
        """Raises FileError."""
        ...

    def load_held_out(self) -> HeldOutTuples:
        """Of places that `learn` has not. Raises FileError."""
        ...


def open_source(sets: Sequence[Sequence[str]]) -> Source:
    """sets: words KIND FOLDER…, or a FOLDER of the project's own pairs. Published sets may stand together, as GelSight
    and DIGIT come from different ones. Raises UsageError."""
    named = [tuple(words) if words[0] in FOLDER_COUNTS else ("pairs", *words) for words in sets]
    for kind, *folders in named:
        if len(folders) != FOLDER_COUNTS[kind]:
            raise UsageError(
                f"--data {kind} takes {FOLDER_COUNTS[kind]} folder(s), not {len(folders)}.",
                remedy=f"Kinds are {', '.join(FOLDER_COUNTS)}; quote a path with blanks.",
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
    def messages(self) -> Sequence[str]:
        return ("generated pairs of this project",)

    def load_training(self) -> Tuples:
        return make_training_tuples(load_pairs(self.folder, TRAIN), TRAINING_CLASSES)

    def load_held_out(self) -> HeldOutTuples:
        pairs = load_pairs(self.folder, HELD_OUT_INSTANCES)
        strangers = load_pairs(self.folder, HELD_OUT_CLASSES)
        known = {sensor: make_test_tuples(pairs, sensor, TRAINING_CLASSES) for sensor in PAIR_SENSORS}
        patch = pairs.patch[pairs.tile_index]
        return HeldOutTuples(
            known=known,
            unseen={sensor: make_test_tuples(strangers, sensor, UNSEEN_CLASSES) for sensor in PAIR_SENSORS},
            disjoint={sensor: patch[known[sensor].row] == side for side, sensor in enumerate(PAIR_SENSORS)},
        )


@dataclass(frozen=True)
class RecordedSource:
    """Users' copies of published sets: (kind, folders)."""

    sets: tuple[tuple[str, tuple[Path, ...]], ...]
    messages: list[str] = field(default_factory=list)

    def load_training(self) -> Tuples:
        parts = [part for one in self.sets for part in _list_pairs(*one, "train")]
        return self._read_tuples(parts, _collect_labels(parts))

    def load_held_out(self) -> HeldOutTuples:
        met = _collect_labels([part for one in self.sets for part in _list_pairs(*one, "train")])
        tuples = self._read_tuples([part for one in self.sets for part in _list_pairs(*one, "test")], met)
        touched = [make for make in range(len(PAIR_SENSORS)) if (tuples.sensor == make).any()]
        known = {PAIR_SENSORS[make]: tuples.select_sensor(PAIR_SENSORS[make]) for make in touched}
        named = {sensor: each.label >= 0 for sensor, each in known.items()}
        both = len(named) == len(PAIR_SENSORS) and all(each.any() for each in named.values())
        return HeldOutTuples(known, {}, named if both else None)

    def _read_tuples(self, sources: Sequence[FilePairs], class_names: Sequence[str]) -> Tuples:
        skipped: list[FileError] = []
        tuples = make_recorded_tuples(
            (pair for part in sources for pair in iterate_readable(part, skipped)), class_names
        )
        self.messages.extend(note for part in sources for note in part.notes)
        if skipped:
            self.messages.append(f"{len(skipped)} pairs could not be read, the first: {skipped[0]}")
        return tuples


def _list_pairs(kind: str, folders: Sequence[Path], split: str) -> list[FilePairs]:
    """The pairs of one set for a split; what is for validation is learned from too. HaTT has one photograph of each
    material: of its touch images every fifth is for the test, and the look is one that was learned from."""
    if kind == "hatt":
        pairs = HattTouchFolder(folders[0], folders[1]).pairs
        chosen = (entry for place, entry in enumerate(pairs.entries) if (place % 5 == 4) == (split == "test"))
        return [replace(pairs, entries=tuple(chosen))]
    data = TarfFolder(folders[0]) if kind == "tarf" else TouchAndGoFolder(folders[0])
    return [data.split(name) for name in (("train", "val") if split == "train" else ("test",))]


def _collect_labels(sources: Sequence[FilePairs]) -> tuple[str, ...]:
    return tuple(sorted({label for part in sources for label in part.labels if label is not None}))


def select_labelled(tuples: Tuples, max_count: int, seed: int) -> Tuples:
    """At most so many of those with a label, drawn without replacement, in their order."""
    rows = np.flatnonzero(tuples.label >= 0)
    drawn = np.random.default_rng(seed).permutation(rows)[:max_count]
    return tuples.select(np.sort(drawn))
