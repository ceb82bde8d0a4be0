"""The bench of pictures: its rows, and errors of views. No time is asserted."""

from __future__ import annotations

import numpy as np
import pytest

from hnf_lab.bench.harness import BenchOptions
from hnf_lab.blender_bench import pictures


def test_the_error_is_of_srgb_colors():
    black = np.zeros((4, 5, 3), np.float32)
    assert pictures.compute_error(black, black) == 0.0
    assert pictures.compute_error(np.ones_like(black), black) == pytest.approx(1.0)


def test_every_way_shows_the_same_view_and_has_a_row():
    rows = {row.method: row for row in pictures.measure_pictures(BenchOptions(repeats=1, quick=True))}
    assert list(rows) == [*(method.name for method in pictures.list_methods()), pictures.FIGURE]
    assert all(row.cpu.lowest > 0.0 for row in rows.values())
    views = [row for name, row in rows.items() if name != pictures.FIGURE]
    assert all(0.0 < row.error < 0.1 for row in views)  # a black picture, or another camera, is off by more
    assert [row.ratio is None for row in views] == [True, False, False, False]
    assert rows[pictures.FIGURE].error is None
