"""Vision–touch tuples of two sensors that never touched the same place."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...datasets.photographs import crop_centre_square, resize_by_area
from ...datasets.tactile_pairs import PAIR_SENSORS, Pairs, encode_rgb
from ...datasets.vision_touch import VisionTouchPair
from ...errors import UsageError
from ...tactile.views import VIEW_PIXELS
from .pictures import GeneratedImagePairs, ImagePairs, RecordedImagePairs

Rows = NDArray[np.int64]
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
