"""What the two encoders are shown: a look, and the same place under a touch sensor of a given make.

Vision–touch tuples of two sensors that never touched the same place.

What encoders are trained on and judged by: the project's own pairs, or copies of published sets.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.hatt_touch import HattTouchFolder
from hnf_core.datasets.tactile_pairs import (
    HELD_OUT_CLASSES,
    HELD_OUT_INSTANCES,
    PAIR_SENSORS,
    TRAIN,
    UNSEEN_CLASSES,
    Pairs,
    encode_rgb,
    load_pairs,
)
from hnf_core.datasets.tarf import TarfFolder
from hnf_core.datasets.touch_and_go import TouchAndGoFolder
from hnf_core.datasets.vision_touch import (
    FilePairs,
    VisionTouchPair,
    crop_centre_square,
    iterate_readable,
    resize_by_area,
)
from hnf_core.errors import FileError, UsageError
from hnf_core.simulation.material_classes import list_classes
from hnf_core.tactile.optics import SENSORS, Sensor, perturb_sensor
from hnf_core.tactile.views import VIEW_PIXELS

Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]

NOISE = 0.0003
"""Standard deviation of a sensor's picture, full scale 1: one of 256 steps, averaged over some 170 frames of a still
contact. Half of the generated membranes have slopes below 0.006, which one frame would not show."""
PAIR_FLOOR, RECORDED_FLOOR = 0.002, 0.02
"""Contrasts up to which a touch picture enters the network linearly, above as a logarithm: silk and gravel differ by a
hundred. A recorded frame's own noise is below the second."""


class ImagePairs(Protocol):
    """N places. turns: in how many ways a place may be turned without its touch becoming one that no sensor gives.
    floor: the contrast of touch below which it is shown linearly, above as a logarithm."""

    @property
    def turns(self) -> int: ...

    @property
    def floor(self) -> float: ...

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        """(k, P, P, 3) square root of linear colour, 0–255."""
        ...

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        """(k, P, P, 3) linear, what the touched sensor shows more than the untouched one."""
        ...


@dataclass(frozen=True)
class GeneratedImagePairs:
    """Of pairs that the project makes: any sensor of PAIR_SENSORS, each time another piece of it (lamps, noise)."""

    pairs: Pairs
    turns: int = 8
    floor: float = PAIR_FLOOR

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        return np.stack([apply_symmetry(self.pairs.rgb[row], way) for row, way in zip(rows, turn, strict=True)])

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        return np.stack(
            [
                render_touch(self.pairs.slopes[row, make].astype(np.float32), SENSORS[PAIR_SENSORS[make]], way, rng)
                for row, make, way in zip(rows, sensor, turn, strict=True)
            ]
        )


@dataclass(frozen=True)
class RecordedImagePairs:
    """Of recordings: one touch of a place, by the sensor that touched it. looks: (N, P, P, 3) uint8, square root of
    linear colour. touches: (N, P, P, 3) float16, background taken off. They are never turned: a turned recording would
    be one under turned lamps."""

    images: NDArray[np.uint8]
    touch_images: NDArray[np.float16]
    turns: int = 1
    floor: float = RECORDED_FLOOR

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        return self.images[rows]

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        return self.touch_images[rows].astype(np.float32)


def render_touch(slopes: Float32, sensor: Sensor, turn: int, rng: np.random.Generator) -> Float32:
    """(P, P, 3): the place, turned, under another piece of the sensor, less that piece's untouched picture.

    slopes: (2, P, P) of the membrane, ∂h/∂x and ∂h/∂y. As tactile.optics.shade, in float32.
    """
    piece = perturb_sensor(sensor, rng)
    gx, gy = apply_symmetry_to_slopes(slopes, turn)
    upright = 1.0 / np.sqrt(1.0 + gx**2 + gy**2)
    off = np.stack([-gx * upright, -gy * upright, upright - 1.0], axis=-1)
    picture = off @ piece.shading.T.astype(np.float32)
    return np.asarray(picture + NOISE * rng.standard_normal(picture.shape, dtype=np.float32), dtype=np.float32)


def apply_symmetry(image: NDArray[Any], turn: int) -> NDArray[Any]:
    """A picture (P, P, …), mirrored left and right where turn ≥ 4, then turned by turn % 4 quarters to the left."""
    return np.rot90(image[:, ::-1] if turn >= 4 else image, turn % 4)


def apply_symmetry_to_slopes(slopes: Float32, turn: int) -> tuple[Float32, Float32]:
    """Slopes of the height field that `turned` gives: their pictures turn, and so do they as vectors."""
    gx, gy = apply_symmetry(slopes[0], turn), apply_symmetry(slopes[1], turn)
    if turn >= 4:
        gx = -gx
    for _ in range(turn % 4):
        gx, gy = -gy, gx
    return gx, gy


NO_LABEL = -1


@dataclass(frozen=True)
class Tuples:
    """n tuples over one store of pictures.

    row: (n,) of the pictures. sensor: (n,) in PAIR_SENSORS. label: (n,) in classes, NO_LABEL where it has none.
    group: (n,) what looks alike and must not be cut apart or counted as independent: a piece of material, a place.
    """

    images: ImagePairs
    row: Rows
    sensor: Rows
    label: Rows
    group: Rows
    classes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.row)

    def select(self, chosen: NDArray[np.generic]) -> Tuples:
        """Those rows, or those where a mask is true."""
        return replace(
            self, row=self.row[chosen], sensor=self.sensor[chosen], label=self.label[chosen], group=self.group[chosen]
        )

    def select_sensor(self, name: str) -> Tuples:
        """Raises UsageError where it has none of that sensor."""
        found = self.select(self.sensor == PAIR_SENSORS.index(name))
        if not len(found):
            raise UsageError(f"there is no {name} picture in these data.", remedy="Choose the other sensor.")
        return found


def make_training_tuples(pairs: Pairs, classes: Sequence[str]) -> Tuples:
    """Tuples to learn from: the tiles of each class go to the sensors by turns, so that a place is touched by one
    sensor only and DIGIT patches are of other places of the same materials. Tiles of no class have no label."""
    turn: dict[str, int] = {}
    make = np.empty(pairs.tiles, dtype=np.int64)
    for tile, name in enumerate(pairs.class_name):
        make[tile] = turn.get(name, 0) % len(PAIR_SENSORS)
        turn[name] = turn.get(name, 0) + 1
    return _make_tuples(pairs, np.arange(len(pairs)), make[pairs.tile_index], classes)


def make_test_tuples(pairs: Pairs, sensor: str, classes: Sequence[str]) -> Tuples:
    """Tuples to be tested with: every view of a tile with a class in `classes`, under one sensor."""
    known = np.array([name in classes for name in pairs.class_name])
    rows = np.flatnonzero(known[pairs.tile_index])
    return _make_tuples(pairs, rows, np.full(len(rows), PAIR_SENSORS.index(sensor)), classes)


def _make_tuples(pairs: Pairs, rows: Rows, sensor: Rows, classes: Sequence[str]) -> Tuples:
    index = {name: number for number, name in enumerate(classes)}
    label = np.array([index.get(name, NO_LABEL) for name in pairs.class_name], dtype=np.int64)
    pieces = {piece: number for number, piece in enumerate(dict.fromkeys(_make_group_keys(pairs)))}
    group = np.array([pieces[piece] for piece in _make_group_keys(pairs)], dtype=np.int64)
    tile = pairs.tile_index[rows]
    return Tuples(GeneratedImagePairs(pairs), rows, sensor, label[tile], group[tile], tuple(classes))


def _make_group_keys(pairs: Pairs) -> list[tuple[str, int, int]]:
    """Class, instance, and the tile's own seed where it is of no instance."""
    return [
        (name, int(instance), int(seed) if instance < 0 else -1)
        for name, instance, seed in zip(pairs.class_name, pairs.instance_seed, pairs.tile_seed, strict=True)
    ]


def make_recorded_tuples(pairs: Iterable[VisionTouchPair], classes: Sequence[str], pixels: int = VIEW_PIXELS) -> Tuples:
    """Tuples of recordings: centred squares brought to `pixels`, the background taken off each touch, or its own mean
    where the untouched sensor was not recorded. Pictures are kept small, one pair at a time is kept large.

    Raises UsageError where there is none.
    """
    index = {name: number for number, name in enumerate(classes)}
    places: dict[str, int] = {}
    looks, touches, sensor, label, group = [], [], [], [], []
    for pair in pairs:
        looks.append(encode_rgb(resize_by_area(crop_centre_square(pair.rgb), pixels)))
        touches.append(resize_by_area(crop_centre_square(_subtract_background(pair)), pixels).astype(np.float16))
        sensor.append(PAIR_SENSORS.index(pair.sensor))
        label.append(index.get(pair.label or "", NO_LABEL))
        group.append(places.setdefault(pair.where, len(places)))
    if not looks:
        raise UsageError("there are no vision–touch pairs here.")
    return Tuples(
        RecordedImagePairs(np.stack(looks), np.stack(touches)),
        np.arange(len(looks)),
        np.array(sensor, dtype=np.int64),
        np.array(label, dtype=np.int64),
        np.array(group, dtype=np.int64),
        tuple(classes),
    )


def _subtract_background(pair: VisionTouchPair) -> NDArray[np.float32]:
    untouched = pair.touch.mean(axis=(0, 1)) if pair.background is None else pair.background
    return np.asarray(pair.touch - untouched, dtype=np.float32)


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
