"""Random steps of a user: a short walk without a fault, and faults that are seen where there are some."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hnf_lab import ROOT
from hnf_lab.blender_bench.random_steps import Outcome, format_table, run_apart

STEPS, SEED = 50, 1
BREAK = {
    "a traceback": "from hnf_blender.ops import bake_ops\nbake_ops.HNF_OT_bake.execute = lambda *_: 1 / 0\n",
    "a stale status": "from hnf_blender.state import status_tracker\n"
    "status_tracker.process_changes = lambda *_: False\n",
    "a crash": "import os\nfrom hnf_blender.ops.bake_ops import HNF_OT_bake\n"
    "HNF_OT_bake.execute = lambda *_: os.abort()\n",
}


def test_a_short_walk_is_without_fault() -> None:
    outcome = run_apart(SEED, STEPS)
    assert outcome.faults == []
    assert outcome.steps.total() == STEPS


@pytest.mark.parametrize("what", BREAK)
def test_a_fault_is_found(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python's own sitecustomize puts it into the walk's process."""
    (tmp_path / "sitecustomize.py").write_text(BREAK[what], encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(ROOT), str(ROOT / "tools")]))
    assert run_apart(SEED, STEPS).faults != []


def test_the_table_has_a_row_a_seed_and_a_line_a_fault() -> None:
    good, bad = Outcome(0, seconds=60.0), Outcome(1, faults=["step 3: it broke"])
    good.steps.update({"bake": 2, "undo": 3, "redo": 1, "refused": 4})
    assert format_table([good, bad]).splitlines()[2:] == [
        "| 0 | 6 | 4 | 2 | 4 | 0 | 1.0 |",
        "| 1 | 0 | 0 | 0 | 0 | 1 | 0.0 |",
        "* seed 1, step 3: it broke",
    ]
