"""The bench that says what commands cost. No time is asserted."""

import json
import os

import pytest

from hnf_core.errors import HnfError
from hnf_lab.bench.harness import BenchOptions
from hnf_lab.bench.startup import HEAVY_PACKAGES, make_action_csv, measure_startup, run_process

pytestmark = pytest.mark.skipif(not hasattr(os, "wait4"), reason="no system call that tells what a process took")


def test_a_command_is_measured_after_import_numpy():
    base, *found = measure_startup(BenchOptions(repeats=1, quick=True))
    assert (base.method, base.ratio) == ("import numpy", None)
    assert [row.method for row in found] == [
        "hnf --help",
        "hnf --version",
        "hnf materials --json",
        "hnf synth, 0.5 s, oak-wood",
        "hnf synth, 0.5 s, own .hnf",
    ]
    for row in found:
        assert row.ratio_to == base.method
        assert row.seconds.count == row.cpu.count == 1
        assert row.peak_mb > 1.0
    assert "none of the heavy ones" in found[0].note
    assert [name for name in HEAVY_PACKAGES if name in found[-1].note.rpartition(";")[2]] == ["numpy"]


def test_a_process_that_fails_says_why():
    with pytest.raises(HnfError, match="code 3:\nbecause"):
        run_process("print('because'); sys.exit(3)")


def test_a_process_tells_its_own_memory_and_not_its_parents():
    held = bytearray(300_000_000)
    run = run_process("block = bytearray(60_000_000); print(json.dumps(sys.argv[1:]))", "a", "b c")
    assert 60.0 < run.peak_mb < 200.0 < len(held) / 1e6
    assert json.loads(run.output) == ["a", "b c"]


def test_a_hand_moves_all_the_time(tmp_path):
    from hnf_core.action.action import read_action_csv

    table = tmp_path / "action.csv"
    table.write_text(make_action_csv(10.0))
    action = read_action_csv(table, "pen")
    assert action.duration_s == pytest.approx(10.0, abs=0.01)
    assert action.speed.min() > 0.0
