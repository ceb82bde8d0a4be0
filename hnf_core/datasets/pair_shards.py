"""Tactile pairs written in shards: in parallel, from a seed, taken up again where a run was stopped."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from ..errors import FileError, UsageError
from ..files import content_hash
from .pair_tiles import PairSizes, TileRequest, list_tile_requests, make_tile
from .tactile_pairs import (
    HELD_OUT_CLASSES,
    HELD_OUT_INSTANCES,
    TRAIN,
    concatenate_pairs,
    get_shard_path,
    load_shard,
    save_shard,
)

TILES_PER_SHARD = 50
RECIPE_VERSION = 1
"""Counts changes of what a tile's order makes; shards of another recipe are made again."""
WRITE_ORDER = (HELD_OUT_INSTANCES, HELD_OUT_CLASSES, TRAIN)
"""What trainings check themselves against comes first: it is small."""


@dataclass(frozen=True)
class Shard:
    """One file's work. shards: how many its split has."""

    path: Path
    requests: tuple[TileRequest, ...]
    shard_count: int
    key: str


def compute_recipe_key(split: str, sizes: PairSizes, seed: int, tiles_per_shard: int = TILES_PER_SHARD) -> str:
    """Equal for shards that belong together."""
    return content_hash(repr((RECIPE_VERSION, split, sizes, seed, tiles_per_shard)))


def list_shards(
    folder: Path, split: str, sizes: PairSizes, seed: int, tiles_per_shard: int = TILES_PER_SHARD
) -> tuple[Shard, ...]:
    """The shards of a split, in order."""
    wanted = list_tile_requests(split, sizes, seed)
    starts = range(0, len(wanted), tiles_per_shard)
    key = compute_recipe_key(split, sizes, seed, tiles_per_shard)
    return tuple(
        Shard(get_shard_path(folder, split, index), wanted[start : start + tiles_per_shard], len(starts), key)
        for index, start in enumerate(starts)
    )


def is_complete(shard: Shard) -> bool:
    """Whether the file is there, whole, and of this recipe."""
    if not shard.path.is_file():
        return False
    try:
        pairs, shards, key = load_shard(shard.path)
    except FileError:
        return False
    return (pairs.tiles, shards, key) == (len(shard.requests), shard.shard_count, shard.key)


def write_shard(shard: Shard) -> Path:
    """Make the tiles and write the file atomically. The same shard gives the same bytes."""
    for left in shard.path.parent.glob(f".{shard.path.stem}-*"):
        left.unlink(missing_ok=True)  # of a run that was killed while it wrote
    save_shard(
        shard.path,
        concatenate_pairs([make_tile(order) for order in shard.requests]),
        shard_count=shard.shard_count,
        key=shard.key,
    )
    return shard.path


def write_pairs(
    folder: Path,
    sizes: PairSizes,
    seed: int,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    tiles_per_shard: int = TILES_PER_SHARD,
) -> int:
    """Write whatever of the three splits is not there yet; returns how many shards were written.

    Bytes do not depend on workers, nor on how often the run was stopped. told(done, total): after every shard.
    Raises UsageError where a split's folder holds shards beyond those of this recipe, FileError where the disk refuses.
    """
    everything = [shard for split in WRITE_ORDER for shard in list_shards(folder, split, sizes, seed, tiles_per_shard)]
    _reject_foreign_shards(everything)
    missing = [shard for shard in everything if not is_complete(shard)]
    done = len(everything) - len(missing)
    on_progress(done, len(everything))
    for _ in _write_shards(missing, workers):
        done += 1
        on_progress(done, len(everything))
    return len(missing)


def _write_shards(shards: Sequence[Shard], workers: int) -> Iterator[Path]:
    if workers <= 1:
        yield from map(write_shard, shards)
        return
    # One thread each: BLAS threads of several processes only get in each other's way.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(write_shard, shard) for shard in shards]):
            yield future.result()


def _reject_foreign_shards(shards: Sequence[Shard]) -> None:
    expected = {shard.path for shard in shards}
    for folder in sorted({shard.path.parent for shard in shards}):
        strangers = sorted(set(folder.glob("[0-9]*.safetensors")) - expected)
        if strangers:
            raise UsageError(
                f"{len(strangers)} shards of another recipe ({strangers[0].name}).",
                where=str(folder),
                remedy="Empty the folder, or choose another one.",
            )
