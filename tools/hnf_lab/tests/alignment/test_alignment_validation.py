"""Recipes are compared on pieces of the training data that no training saw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from alignment_pairs import write_pairs

pytest.importorskip("torch", reason="alignment trains with torch")

from hnf_core.datasets.tactile_pairs import TRAIN, load_pairs
from hnf_core.errors import UsageError
from hnf_lab.alignment.inputs import COMPARED_CLASSES, make_training_tuples
from hnf_lab.experiments.alignment_validation import main, split_tuples


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pairs")
    write_pairs(folder, 48)
    return folder


def test_no_piece_is_on_both_sides(folder: Path) -> None:
    tuples = make_training_tuples(load_pairs(folder, TRAIN), COMPARED_CLASSES)
    split = split_tuples(tuples)
    for sensor, held_out in split.held_out.known.items():
        assert not set(held_out.group) & set(split.training.group)
        assert len(held_out) + len(split.training) == len(tuples)
        assert set(held_out.label) == {0, 1, 2}
        assert split.held_out.disjoint is not None
        assert 0 < split.held_out.disjoint[sensor].sum() < len(held_out)
    np.testing.assert_array_equal(tuples.row[split.rows], split.training.row)
    with pytest.raises(UsageError, match="no piece has a label"):
        split_tuples(tuples.select(tuples.label < 0))


def test_the_table_has_a_row_for_each_training(folder: Path, tmp_path: Path, capsys) -> None:
    words = ["--steps", "1", "30", "--seeds", "1", "--batch", "32", "--hidden", "32", "--tiles", "40"]
    assert main([*words, "--data", str(folder), "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "112 tuples to train on, 48 views held out" in told
    rows = [line.strip("| ").split(" | ") for line in told.splitlines() if line.startswith("|")][2:]
    assert [row[:2] for row in rows] == [["1", "0"], ["30", "0"]]
    untrained, trained = ([float(value) for value in row[2:]] for row in rows)
    assert np.mean(trained[3:5]) > np.mean(untrained[3:5])
    files = sorted(path.name for path in (tmp_path / "tiles-40").iterdir())
    assert files == [f"statistics-{number}.safetensors" for number in range(4)]
