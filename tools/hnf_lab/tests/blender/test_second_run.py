"""The bench of a run with fresh results only. No time is asserted."""

from __future__ import annotations

import pytest

from hnf_blender.compat import version
from hnf_lab.bench.harness import BenchOptions
from hnf_lab.blender_bench.waiting_times import OPEN_NAME, SECOND_RUN_NAME, measure_second_run


@pytest.mark.skipif(version() < (5, 0, 0), reason="one Blender is enough for a bench's rows")
def test_a_second_run_is_compared_to_opening_and_imports_little():
    opened, again = measure_second_run(BenchOptions(repeats=1, quick=True))
    assert (opened.method, again.method, again.ratio_to) == (OPEN_NAME, SECOND_RUN_NAME, OPEN_NAME)
    assert again.ratio.median == pytest.approx(again.cpu.median / opened.cpu.median)
    assert again.note.rpartition("; ")[2] == "numpy, bpy"
