"""Paired views that the project makes itself: look and macro depth → height and membrane, on disk and in memory.

One tile (20 mm of one piece of a material, photographed once) gives one view at each of the four pitches
(tactile.views); datasets.pair_tiles makes them, datasets.pair_shards writes them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError
from ..files import write_bytes
from ..safetensors_io import dump_tensors, load_tensors
from ..simulation.material_classes import get_category, list_classes
from ..tactile.views import PITCHES_M

FORMAT = "hnf-tactile-pairs-1"
TRAIN, HELD_OUT_INSTANCES, HELD_OUT_CLASSES = SPLITS = ("train", "held-out-instances", "held-out-classes")
PAIR_SENSORS = ("gelsight", "digit")
"""The second axis of Pairs.slopes, names in tactile.optics.SENSORS."""
UNSEEN_CLASSES = tuple({get_category(name): name for name in list_classes()}.values())
"""The last class of every category in the table: met in held-out-classes only, as the field's held-out weights do."""
_REMEDY = "Make the pairs again: tools/make_tactile_pairs.py continues where it stopped."


@dataclass(frozen=True)
class Pairs:
    """n views of t tiles; frame: column → +x, row → −y; ∂/∂y with y up. What has a length is in units of the view's
    pitch, so that slopes, heights and depths of all four pitches are one problem.

    rgb: (n, 64, 64, 3) uint8, round(255 √linear): linear_rgb reads it. depth: (n, 64, 64) float16 macro depth less its
    mean, growing away from the viewer as a camera's depth does. height: (n, 64, 64) float16 less its mean. slopes:
    (n, 2, 2, 64, 64) float16 of the membrane, [PAIR_SENSORS][∂h/∂x, ∂h/∂y], gel and slope limit at native pitch,
    then decimated. pitch_index: (n,) in PITCHES_M. tile_index: (n,) row of the tile's properties below.

    class_name: per tile, "" for a random surface. instance_seed: (t,) of simulation.classes.instance (−1: random).
    tile_seed: (t,) of its heights. patch: (t,) 0 or 1, which tile of the instance: two patches of one instance differ
    by tile seed, light and camera only. token: (t, TOKEN_DIM) float32, the band descriptor on the whole tile.
    mechanics: (t, 3) float32 stiffness N/m, damping ratio, friction (NaN: unknown). turn: (t,) 0–7: quarter turns
    counter-clockwise, + 4 where mirrored (left and right) before. unlit: (t,) bool, a base-colour texture without any
    light.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float16]
    height: NDArray[np.float16]
    slopes: NDArray[np.float16]
    pitch_index: NDArray[np.int64]
    tile_index: NDArray[np.int64]
    class_name: tuple[str, ...]
    instance_seed: NDArray[np.int64]
    tile_seed: NDArray[np.int64]
    patch: NDArray[np.int64]
    token: NDArray[np.float32]
    mechanics: NDArray[np.float32]
    turn: NDArray[np.int64]
    unlit: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.rgb)

    @property
    def tiles(self) -> int:
        return len(self.class_name)

    @property
    def pitch_m(self) -> NDArray[np.float64]:
        """(n,) metres per pixel."""
        return np.asarray(PITCHES_M)[self.pitch_index]


_ARRAYS = tuple(field.name for field in fields(Pairs) if field.name != "class_name")


def decode_rgb(encoded: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Linear colour 0–1 of Pairs.rgb."""
    return np.asarray(np.square(encoded.astype(np.float32) / np.float32(255.0)))


def encode_rgb(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Pairs.rgb of linear colour, cut to 0–1."""
    return np.asarray(np.rint(255.0 * np.sqrt(np.clip(linear, 0.0, 1.0))), dtype=np.uint8)


def concatenate_pairs(chunks: list[Pairs]) -> Pairs:
    """One after the other; tile_index moves along. Raises UsageError where there is none."""
    if not chunks:
        raise UsageError("there are no pairs to join.")
    arrays = {name: np.concatenate([getattr(part, name) for part in chunks]) for name in _ARRAYS}
    first = np.cumsum([0, *(part.tiles for part in chunks[:-1])])
    arrays["tile_index"] = arrays["tile_index"] + np.repeat(first, [len(part) for part in chunks])
    return Pairs(class_name=tuple(name for part in chunks for name in part.class_name), **arrays)


def get_shard_path(folder: Path, split: str, index: int) -> Path:
    """Where one shard lies. Raises UsageError for an unknown split."""
    if split not in SPLITS:
        raise UsageError(f"no split is called {split!r}.", remedy=f"Choose one of {', '.join(SPLITS)}.")
    return folder / split / f"{index:04d}.safetensors"


def save_shard(path: Path, pairs: Pairs, *, shard_count: int, key: str) -> None:
    """Write one shard atomically; equal pairs give equal bytes. shards: how many its split has. key: of the recipe
    that made it, so that shards of different recipes never mix. Raises FileError."""
    metadata = {"format": FORMAT, "shards": str(shard_count), "key": key, "class_name": json.dumps(pairs.class_name)}
    tensors = {name: np.ascontiguousarray(getattr(pairs, name)) for name in _ARRAYS}
    write_bytes(path, dump_tensors(tensors, metadata))


def load_shard(path: Path) -> tuple[Pairs, int, str]:
    """The pairs of one shard, how many shards its split has, and the recipe's key. Raises FileError."""
    try:
        tensors, metadata = load_tensors(path.read_bytes())
        if metadata.get("format") != FORMAT:
            raise ValueError(f"format {metadata.get('format')!r}, not {FORMAT!r}")
        arrays = {name: tensors[name] for name in _ARRAYS}
        pairs = Pairs(class_name=tuple(json.loads(metadata["class_name"])), **arrays)
        shards, key = int(metadata["shards"]), metadata["key"]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise FileError(f"no readable shard of tactile pairs ({error}).", where=str(path), remedy=_REMEDY) from error
    return pairs, shards, key


def load_pairs(folder: Path, split: str, *, partial: bool = False) -> Pairs:
    """A whole split in memory (about 60 kB a view).

    partial: take what is there already, else every shard must be. Raises FileError where shards are missing, damaged
    or of different recipes, UsageError for an unknown split.
    """
    paths = sorted(get_shard_path(folder, split, 0).parent.glob("[0-9]*.safetensors"))
    if not paths:
        raise FileError("no tactile pairs here.", where=str(folder / split), remedy=_REMEDY)
    read = [load_shard(path) for path in paths]
    recipes = {(shards, key) for _, shards, key in read}
    if len(recipes) > 1:
        raise FileError("shards of different recipes.", where=str(folder / split), remedy="Empty the folder first.")
    shards = read[0][1]
    if not partial and len(paths) != shards:
        raise FileError(f"{len(paths)} of {shards} shards.", where=str(folder / split), remedy=_REMEDY)
    return concatenate_pairs([pairs for pairs, _, _ in read])
