"""Shards of tactile pairs: equal bytes from every run, and complete after an interrupted one."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hnf_core.datasets.pair_generation import (
    PairSizes,
    Shard,
    is_complete,
    list_shards,
    list_tile_requests,
    make_tile,
    write_pairs,
    write_shard,
)
from hnf_core.datasets.tactile_pairs import TRAIN, concatenate_pairs, get_shard_path, load_pairs, load_shard, save_shard
from hnf_core.errors import FileError, UsageError

ROOT = Path(__file__).resolve().parents[3]
FEW = PairSizes(train=3, instances=0, unseen_instances=0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pairs")
    assert write_pairs(folder, FEW, 3, tiles_per_shard=1) == 3
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_shards_come_back_and_join(made: Path) -> None:
    pairs = load_pairs(made, TRAIN)
    assert len(pairs) == 12
    assert pairs.tile_index.tolist() == sorted(list(range(3)) * 4)
    wanted = list_tile_requests(TRAIN, FEW, 3)
    assert pairs.class_name == tuple(order.class_name for order in wanted)
    again = concatenate_pairs([make_tile(order) for order in wanted[2:]])
    assert np.array_equal(pairs.slopes[8:], again.slopes)
    assert np.array_equal(pairs.rgb[8:], again.rgb)


def test_a_second_run_rewrites_only_damaged_shards(made: Path) -> None:
    before = contents(made)
    assert write_pairs(made, FEW, 3, tiles_per_shard=1) == 0
    path = get_shard_path(made, TRAIN, 1)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(FileError):
        load_pairs(made, TRAIN)
    assert write_pairs(made, FEW, 3, tiles_per_shard=1) == 1
    assert contents(made) == before


def test_bytes_do_not_depend_on_workers(made: Path, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    write_pairs(tmp_path, FEW, 3, 2, lambda done, total: told.append((done, total)), tiles_per_shard=1)
    assert contents(tmp_path) == contents(made)
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_a_killed_run_leaves_whole_shards_and_goes_on(made: Path, tmp_path: Path) -> None:
    code = (
        "from pathlib import Path; import sys\n"
        "from hnf_core.datasets.pair_generation import PairSizes, write_pairs\n"
        "write_pairs(Path(sys.argv[1]), PairSizes(3, 0, 0), 3, tiles_per_shard=1)"
    )
    run = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], cwd=ROOT)
    deadline = time.monotonic() + 60.0
    while not get_shard_path(tmp_path, TRAIN, 0).exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    run.send_signal(signal.SIGKILL)
    assert run.wait(10) != 0
    # What a kill in the middle of a write leaves behind.
    (tmp_path / TRAIN / ".0002-x.safetensors").write_bytes(b"half")
    shards = list_shards(tmp_path, TRAIN, FEW, 3, 1)
    there = [shard for shard in shards if shard.path.exists()]
    assert there
    assert all(is_complete(shard) for shard in there)
    with pytest.raises(FileError, match="shards"):
        load_pairs(tmp_path, TRAIN)
    assert load_pairs(tmp_path, TRAIN, partial=True).tiles == len(there)
    write_pairs(tmp_path, FEW, 3, tiles_per_shard=1)
    assert contents(tmp_path) == contents(made)


def test_shards_of_other_recipes_do_not_mix(made: Path, tmp_path: Path) -> None:
    pairs, shards, key = load_shard(get_shard_path(made, TRAIN, 0))
    assert shards == 3
    save_shard(get_shard_path(tmp_path, TRAIN, 0), pairs, shard_count=2, key=key)
    save_shard(get_shard_path(tmp_path, TRAIN, 1), pairs, shard_count=2, key="another")
    with pytest.raises(FileError, match="different recipes"):
        load_pairs(tmp_path, TRAIN)
    with pytest.raises(UsageError, match="another recipe"):
        write_pairs(tmp_path, PairSizes(1, 0, 0), 3)


@pytest.mark.parametrize("content", [b"", b"\x10\0\0\0\0\0\0\0{}", b"\xff" * 64])
def test_what_is_no_shard_is_refused_in_words(tmp_path: Path, content: bytes) -> None:
    path = get_shard_path(tmp_path, TRAIN, 0)
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(FileError, match="no readable shard"):
        load_shard(path)
    assert not is_complete(Shard(path, (), 1, ""))


def test_nothing_there_and_unknown_splits_are_said(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no tactile pairs"):
        load_pairs(tmp_path, TRAIN)
    with pytest.raises(UsageError, match="no split"):
        load_pairs(tmp_path, "test")
    with pytest.raises(UsageError):
        concatenate_pairs([])


def test_a_failed_shard_write_leaves_the_disk_unchanged(made: Path, tmp_path: Path) -> None:
    blocked = tmp_path / TRAIN
    blocked.write_text("a file where a folder should be")
    with pytest.raises(FileError):
        write_shard(list_shards(tmp_path, TRAIN, PairSizes(1, 0, 0), 3)[0])
    assert blocked.read_text() == "a file where a folder should be"
