"""Every fault of the playing process ends in silence: a child that plays is stopped, continued and killed."""

from __future__ import annotations

import os

import pytest
from ptys import needs_pty

from hnf_lab.bench import fault_harness
from hnf_lab.bench.faults import FAULTS, Fault, find_violations, run_trials

pytest.importorskip("serial", reason="pyserial is not installed")
pytestmark = needs_pty
if os.name != "posix":
    pytest.skip("this system has no signals that stop a process", allow_module_level=True)

OF_A_PROCESS = (fault_harness.kill_player, fault_harness.suspend_briefly, fault_harness.suspend_for_long)
HERE = [kind for kind in FAULTS if kind.trial in OF_A_PROCESS]


def test_there_are_three() -> None:
    assert len(HERE) == len(OF_A_PROCESS)


@pytest.mark.parametrize("kind", HERE, ids=lambda kind: kind.name)
def test_it_ends_as_promised(kind: Fault) -> None:
    found = run_trials(kind, 2, seed=4)
    assert [find_violations(kind, outcome) for outcome in found] == [[], []], found
