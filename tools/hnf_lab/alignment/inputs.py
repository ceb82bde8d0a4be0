"""Tuples of appearance and touch for the encoders, from the project's own pairs or from published data sets.

`ImagePairs` gives the image of a place and the touch image of a sensor at the same place. `Tuples` adds sensor, label
and group. Within a training set no place is touched by both sensors. `open_source` opens the data named on the command
line.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

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
from hnf_core.datasets.vision_touch import FilePairs, VisionTouchPair, crop_centre_square, resize_by_area
from hnf_core.errors import FileError, UsageError
from hnf_core.simulation.material_classes import list_classes
from hnf_core.tactile.optics import SENSORS, Sensor
from hnf_core.tactile.views import VIEW_PIXELS
from hnf_lab.alignment.hatt_touch import HattTouchFolder

from ..encoder.variation import perturb_sensor
from .hatt_touch import iterate_readable

Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]

NOISE = 0.0003
"""Standard deviation of the noise of a touch image, full scale 1.

It is one of 256 steps, averaged over some 170 frames of a still contact. Half of the generated membranes have slopes
below 0.006, which a single frame would not show.
"""
PAIR_FLOOR, RECORDED_FLOOR = 0.002, 0.02
"""Contrast of generated and of recorded touch images below which they enter the network linearly.

Above, they enter as a logarithm, since contrasts of silk and gravel differ by a factor of a hundred. The noise of a
recorded frame is below the second value.
"""


class ImagePairs(Protocol):
    """Images and touch images of N places.

    Attributes
    ----------
    turns
        Number of rotations and reflections under which the touch is still one that a sensor could give.
    floor
        Touch contrast below which it enters linearly, above as a logarithm.
    """

    @property
    def turns(self) -> int: ...

    @property
    def floor(self) -> float: ...

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        """Return (k, P, P, 3) square root of linear colour, 0–255."""
        ...

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        """Return (k, P, P, 3) linear touch images minus that of the untouched sensor."""
        ...


@dataclass(frozen=True)
class GeneratedImagePairs:
    """Generated pairs under any sensor of PAIR_SENSORS, with lamps and noise varied at every call."""

    pairs: Pairs
    turns: int = 8
    floor: float = PAIR_FLOOR

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        return np.stack(
            [apply_symmetry(self.pairs.rgb[row], symmetry) for row, symmetry in zip(rows, turn, strict=True)]
        )

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        return np.stack(
            [
                render_touch(
                    self.pairs.slopes[row, sensor_index].astype(np.float32),
                    SENSORS[PAIR_SENSORS[sensor_index]],
                    symmetry,
                    rng,
                )
                for row, sensor_index, symmetry in zip(rows, sensor, turn, strict=True)
            ]
        )


@dataclass(frozen=True)
class RecordedImagePairs:
    """Recorded pairs: one touch of a place by the sensor that touched it.

    They are never rotated, since a rotated recording would have rotated lamps.

    Attributes
    ----------
    images
        (N, P, P, 3) uint8, square root of linear colour.
    touch_images
        (N, P, P, 3) float16, background subtracted.
    """

    images: NDArray[np.uint8]
    touch_images: NDArray[np.float16]
    turns: int = 1
    floor: float = RECORDED_FLOOR

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        return self.images[rows]

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        return self.touch_images[rows].astype(np.float32)


def render_touch(slopes: Float32, sensor: Sensor, turn: int, rng: np.random.Generator) -> Float32:
    """Render the (P, P, 3) touch image of rotated slopes under a perturbed sensor, background subtracted.

    Shading follows hnf_core.tactile.optics.shade, in float32. slopes: (2, P, P) membrane slopes ∂h/∂x and ∂h/∂y.
    """
    varied_sensor = perturb_sensor(sensor, rng)
    gx, gy = apply_symmetry_to_slopes(slopes, turn)
    upright = 1.0 / np.sqrt(1.0 + gx**2 + gy**2)
    normal_change = np.stack([-gx * upright, -gy * upright, upright - 1.0], axis=-1)
    image = normal_change @ varied_sensor.shading.T.astype(np.float32)
    return np.asarray(image + NOISE * rng.standard_normal(image.shape, dtype=np.float32), dtype=np.float32)


def apply_symmetry(image: NDArray[Any], turn: int) -> NDArray[Any]:
    """Return an image (P, P, …), mirrored left to right if turn ≥ 4, then rotated left by turn % 4 quarters."""
    return np.rot90(image[:, ::-1] if turn >= 4 else image, turn % 4)


def apply_symmetry_to_slopes(slopes: Float32, turn: int) -> tuple[Float32, Float32]:
    """Return the slopes of the height field transformed by apply_symmetry; vectors rotate as well."""
    gx, gy = apply_symmetry(slopes[0], turn), apply_symmetry(slopes[1], turn)
    if turn >= 4:
        gx = -gx
    for _ in range(turn % 4):
        gx, gy = -gy, gx
    return gx, gy


NO_LABEL = -1
"""Label of tuples without a class."""


@dataclass(frozen=True)
class Tuples:
    """n tuples over one store of images.

    Attributes
    ----------
    row
        (n,) rows of the images.
    sensor
        (n,) indices in PAIR_SENSORS.
    label
        (n,) indices in classes, or NO_LABEL.
    group
        (n,) material instance or place; tuples of one group are not independent and must not be split.
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
        """Return the tuples with these indices or where the mask is true."""
        return replace(
            self, row=self.row[chosen], sensor=self.sensor[chosen], label=self.label[chosen], group=self.group[chosen]
        )

    def select_sensor(self, name: str) -> Tuples:
        """Return the tuples of one sensor. Raises UsageError if there are none."""
        selected = self.select(self.sensor == PAIR_SENSORS.index(name))
        if not len(selected):
            raise UsageError(f"there is no {name} picture in these data.", remedy="Choose the other sensor.")
        return selected


def make_training_tuples(pairs: Pairs, classes: Sequence[str]) -> Tuples:
    """Make training tuples; tiles of each class are assigned to the sensors in turn.

    So a place is touched by one sensor only, and DIGIT patches show other places of the same materials. Tiles of no
    class have no label.
    """
    next_sensor: dict[str, int] = {}
    sensor_of_tile = np.empty(pairs.tiles, dtype=np.int64)
    for tile, name in enumerate(pairs.class_name):
        sensor_of_tile[tile] = next_sensor.get(name, 0) % len(PAIR_SENSORS)
        next_sensor[name] = next_sensor.get(name, 0) + 1
    return _make_tuples(pairs, np.arange(len(pairs)), sensor_of_tile[pairs.tile_index], classes)


def make_test_tuples(pairs: Pairs, sensor: str, classes: Sequence[str]) -> Tuples:
    """Make test tuples: every view of a tile with a class in `classes`, under one sensor."""
    known = np.array([name in classes for name in pairs.class_name])
    rows = np.flatnonzero(known[pairs.tile_index])
    return _make_tuples(pairs, rows, np.full(len(rows), PAIR_SENSORS.index(sensor)), classes)


def _make_tuples(pairs: Pairs, rows: Rows, sensor: Rows, classes: Sequence[str]) -> Tuples:
    index = {name: number for number, name in enumerate(classes)}
    label = np.array([index.get(name, NO_LABEL) for name in pairs.class_name], dtype=np.int64)
    group_index = {key: number for number, key in enumerate(dict.fromkeys(_make_group_keys(pairs)))}
    group = np.array([group_index[key] for key in _make_group_keys(pairs)], dtype=np.int64)
    tile = pairs.tile_index[rows]
    return Tuples(GeneratedImagePairs(pairs), rows, sensor, label[tile], group[tile], tuple(classes))


def _make_group_keys(pairs: Pairs) -> list[tuple[str, int, int]]:
    """Return class, instance, and the tile's own seed if it belongs to no instance."""
    return [
        (name, int(instance), int(seed) if instance < 0 else -1)
        for name, instance, seed in zip(pairs.class_name, pairs.instance_seed, pairs.tile_seed, strict=True)
    ]


def make_recorded_tuples(pairs: Iterable[VisionTouchPair], classes: Sequence[str], pixels: int = VIEW_PIXELS) -> Tuples:
    """Make tuples of recordings: centred squares resized to `pixels`, background subtracted from each touch.

    If the untouched sensor was not recorded, the mean of the touch image is subtracted. Pairs are read one at a time,
    so only the small images stay in memory.

    Raises
    ------
    UsageError
        If there are no pairs.
    """
    index = {name: number for number, name in enumerate(classes)}
    places: dict[str, int] = {}
    images, touch_images, sensor, label, group = [], [], [], [], []
    for pair in pairs:
        images.append(encode_rgb(resize_by_area(crop_centre_square(pair.rgb), pixels)))
        touch_images.append(resize_by_area(crop_centre_square(_subtract_background(pair)), pixels).astype(np.float16))
        sensor.append(PAIR_SENSORS.index(pair.sensor))
        label.append(index.get(pair.label or "", NO_LABEL))
        group.append(places.setdefault(pair.where, len(places)))
    if not images:
        raise UsageError("there are no vision–touch pairs here.")
    return Tuples(
        RecordedImagePairs(np.stack(images), np.stack(touch_images)),
        np.arange(len(images)),
        np.array(sensor, dtype=np.int64),
        np.array(label, dtype=np.int64),
        np.array(group, dtype=np.int64),
        tuple(classes),
    )


def _subtract_background(pair: VisionTouchPair) -> NDArray[np.float32]:
    untouched = pair.touch.mean(axis=(0, 1)) if pair.background is None else pair.background
    return np.asarray(pair.touch - untouched, dtype=np.float32)


FOLDER_COUNTS = MappingProxyType({"pairs": 1, "tarf": 1, "touch-and-go": 1, "hatt": 2})
"""Number of folders of each kind of data; HaTT has photographs and GelSight images of its textures."""
TRAINING_CLASSES = tuple(name for name in list_classes() if name not in UNSEEN_CLASSES)
COMPARED_CLASSES = (
    "oak-wood", "pine-wood", "varnished-wood", "rough-sawn-wood", "smooth-metal", "brushed-metal", "cast-metal",
    "rusty-metal", "brass", "granite", "marble", "slate", "sandstone", "cotton-canvas", "denim", "corduroy",
    "velvet", "silk", "wool-knit", "felt", "copy-paper", "cardboard", "smooth-plastic", "textured-plastic",
    "ribbed-plastic", "soft-foam", "loop-carpet", "glazed-tile", "leather", "rubber", "clear-glass",
)  # fmt: skip
"""The 31 classes that the library had when alignment was first measured, for figures that compare with those."""


@dataclass(frozen=True)
class HeldOutTuples:
    """Test tuples.

    Attributes
    ----------
    known
        Sensor → tuples of new instances or places of known classes.
    unseen
        Sensor → tuples of classes not used in training; may be empty.
    disjoint
        Sensor → mask of the known tuples such that no place is touched by both sensors, for cross-sensor retrieval;
        None
        with a single sensor.
    """

    known: Mapping[str, Tuples]
    unseen: Mapping[str, Tuples]
    disjoint: Mapping[str, NDArray[np.bool_]] | None


class Source(Protocol):
    """A data source. messages: what was read and omitted, complete after everything was read."""

    @property
    def messages(self) -> Sequence[str]: ...

    def load_training(self) -> Tuples:
        """Load the training tuples. Raises FileError."""
        ...

    def load_held_out(self) -> HeldOutTuples:
        """Load the test tuples, of places not in the training tuples. Raises FileError."""
        ...


def open_source(sets: Sequence[Sequence[str]]) -> Source:
    """Open data sources given as words KIND FOLDER…, or as a FOLDER of the project's own pairs.

    Several published sets may be combined, since GelSight and DIGIT data come from different sets.

    Raises
    ------
    UsageError
        If the number of folders is wrong or own pairs are combined with other sets.
    """
    named_sets = [tuple(words) if words[0] in FOLDER_COUNTS else ("pairs", *words) for words in sets]
    for kind, *folders in named_sets:
        if len(folders) != FOLDER_COUNTS[kind]:
            raise UsageError(
                f"--data {kind} takes {FOLDER_COUNTS[kind]} folder(s), not {len(folders)}.",
                remedy=f"Kinds are {', '.join(FOLDER_COUNTS)}; quote a path with blanks.",
            )
    kinds = [kind for kind, *_ in named_sets]
    if "pairs" in kinds:
        if len(named_sets) > 1:
            raise UsageError("the project's own pairs stand alone.", remedy="Give --data once.")
        return GeneratedSource(Path(named_sets[0][1]))
    return RecordedSource(tuple((kind, tuple(map(Path, folders))) for kind, *folders in named_sets))


@dataclass(frozen=True)
class GeneratedSource:
    """Pairs written to a folder by tools/make_tactile_pairs.py; other classes than `classes` have no label."""

    folder: Path
    classes: tuple[str, ...] = TRAINING_CLASSES

    @property
    def messages(self) -> Sequence[str]:
        return ("generated pairs of this project",)

    def load_training(self) -> Tuples:
        return make_training_tuples(load_pairs(self.folder, TRAIN), self.classes)

    def load_held_out(self) -> HeldOutTuples:
        pairs = load_pairs(self.folder, HELD_OUT_INSTANCES)
        unseen_pairs = load_pairs(self.folder, HELD_OUT_CLASSES)
        known = {sensor: make_test_tuples(pairs, sensor, self.classes) for sensor in PAIR_SENSORS}
        patch = pairs.patch[pairs.tile_index]
        return HeldOutTuples(
            known=known,
            unseen={sensor: make_test_tuples(unseen_pairs, sensor, UNSEEN_CLASSES) for sensor in PAIR_SENSORS},
            disjoint={sensor: patch[known[sensor].row] == index for index, sensor in enumerate(PAIR_SENSORS)},
        )


@dataclass(frozen=True)
class RecordedSource:
    """The user's copies of published sets: (kind, folders)."""

    sets: tuple[tuple[str, tuple[Path, ...]], ...]
    messages: list[str] = field(default_factory=list)

    def load_training(self) -> Tuples:
        sources = [pairs for source in self.sets for pairs in _list_pairs(*source, "train")]
        return self._read_tuples(sources, _collect_labels(sources))

    def load_held_out(self) -> HeldOutTuples:
        known_labels = _collect_labels([pairs for source in self.sets for pairs in _list_pairs(*source, "train")])
        tuples = self._read_tuples(
            [pairs for source in self.sets for pairs in _list_pairs(*source, "test")], known_labels
        )
        used_sensors = [index for index in range(len(PAIR_SENSORS)) if (tuples.sensor == index).any()]
        known = {PAIR_SENSORS[index]: tuples.select_sensor(PAIR_SENSORS[index]) for index in used_sensors}
        named = {sensor: each.label >= 0 for sensor, each in known.items()}
        both = len(named) == len(PAIR_SENSORS) and all(each.any() for each in named.values())
        return HeldOutTuples(known, {}, named if both else None)

    def _read_tuples(self, sources: Sequence[FilePairs], class_names: Sequence[str]) -> Tuples:
        skipped: list[FileError] = []
        tuples = make_recorded_tuples(
            (pair for source in sources for pair in iterate_readable(source, skipped)), class_names
        )
        self.messages.extend(note for source in sources for note in source.notes)
        if skipped:
            self.messages.append(f"{len(skipped)} pairs could not be read, the first: {skipped[0]}")
        return tuples


def _list_pairs(kind: str, folders: Sequence[Path], split: str) -> list[FilePairs]:
    """Return the pairs of one set for a split; validation pairs are used for training.

    HaTT has one photograph per material: every fifth touch image is for the test, with an image that was in training.
    """
    if kind == "hatt":
        pairs = HattTouchFolder(folders[0], folders[1]).pairs
        chosen = (entry for index, entry in enumerate(pairs.entries) if (index % 5 == 4) == (split == "test"))
        return [replace(pairs, entries=tuple(chosen))]
    data = TarfFolder(folders[0]) if kind == "tarf" else TouchAndGoFolder(folders[0])
    return [data.split(name) for name in (("train", "val") if split == "train" else ("test",))]


def _collect_labels(sources: Sequence[FilePairs]) -> tuple[str, ...]:
    return tuple(sorted({label for source in sources for label in source.labels if label is not None}))


def select_labelled(tuples: Tuples, max_count: int, seed: int) -> Tuples:
    """Return at most `max_count` labelled tuples, drawn without replacement, in their order."""
    rows = np.flatnonzero(tuples.label >= 0)
    drawn = np.random.default_rng(seed).permutation(rows)[:max_count]
    return tuples.select(np.sort(drawn))
