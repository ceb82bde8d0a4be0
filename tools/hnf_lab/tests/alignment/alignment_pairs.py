"""A folder of generated pairs small enough for a test: a class is a direction of grooves, as deep as they look."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from synthetic_pairs import synthetic_pairs

from hnf_core.datasets.tactile_pairs import (
    HELD_OUT_CLASSES,
    HELD_OUT_INSTANCES,
    TRAIN,
    UNSEEN_CLASSES,
    Pairs,
    encode_rgb,
    get_shard_path,
    save_shard,
)
from hnf_core.simulation.material_classes import list_classes

MET = tuple(name for name in list_classes() if name not in UNSEEN_CLASSES)


def grooved_pairs(tiles: int, names: tuple[str, ...], seed: int) -> Pairs:
    """Two tiles of each piece, four views of each tile; classes by turns; the last tile is of no class."""
    rng = np.random.default_rng(seed)
    number = np.arange(tiles) // 2 % len(names)
    rows, columns = np.mgrid[:64, :64]
    slopes, looks = [], []
    for tile in np.repeat(np.arange(tiles), 4):
        angle = np.pi * number[tile] / len(names)
        along = np.cos(angle) * columns - np.sin(angle) * rows
        wave = rng.uniform(0.05, 0.6) * np.cos(2 * np.pi * along / rng.uniform(6, 9) + rng.uniform(0, 6.28))
        slopes.append([[np.cos(angle) * wave, np.sin(angle) * wave]] * 2)
        looks.append(np.repeat((0.4 + 0.6 * wave)[..., None], 3, axis=-1))
    pairs = synthetic_pairs(4 * tiles, seed)
    return replace(
        pairs,
        rgb=encode_rgb(np.array(looks)),
        slopes=np.array(slopes, dtype=np.float16),
        class_name=(*(names[each] for each in number[:-1]), ""),
        instance_seed=np.append(np.arange(tiles - 1) // 2, -1),
        patch=np.arange(tiles) % 2,
    )


def write_pairs(folder: Path, tiles: int = 24) -> None:
    for split, names, seed in (
        (TRAIN, MET[:3], 0), (HELD_OUT_INSTANCES, MET[:3], 1), (HELD_OUT_CLASSES, UNSEEN_CLASSES[:2], 2)
    ):  # fmt: skip
        save_shard(get_shard_path(folder, split, 0), grooved_pairs(tiles, names, seed), shard_count=1, key="test")
