"""Test that every fault on the wire or at the port ends in silence.

Each fault runs a few times; `hnf bench faults` runs it a hundred times. Faults of the playing process are in
test_faults_process.py.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from ptys import needs_pty

from hnf_lab.bench import fault_harness
from hnf_lab.bench.fault_harness import Outcome
from hnf_lab.bench.faults import FAULTS, Fault, find_violations, run_trials

pytest.importorskip("serial", reason="pyserial is not installed")
pytestmark = needs_pty

OF_A_PROCESS = (fault_harness.kill_player, fault_harness.suspend_briefly, fault_harness.suspend_for_long)
HERE = [kind for kind in FAULTS if kind.trial not in OF_A_PROCESS]


@pytest.mark.parametrize("kind", HERE, ids=lambda kind: kind.name)
def test_it_ends_as_promised(kind: Fault) -> None:
    found = run_trials(kind, 2, seed=3)
    assert [find_violations(kind, outcome) for outcome in found] == [[], []], found


GOOD = Outcome(0.015, ("said once",))


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (replace(GOOD, silent_after_s=0.0201), "20.1 ms until silence"),
        (replace(GOOD, messages=()), "0 messages"),
        (replace(GOOD, messages=("one", "two")), "2 messages"),
        (replace(GOOD, violations=1), "1 counts beyond limits"),
        (replace(GOOD, hung=True), "hung"),
        (replace(GOOD, restart_problem="busy"), "does not start again (busy)"),
        (replace(GOOD, played_on=True), "played on"),
    ],
)
def test_a_broken_promise_is_seen(outcome: Outcome, words: str) -> None:
    kind = Fault("any", lambda rig: GOOD)
    assert find_violations(kind, GOOD) == []
    assert find_violations(kind, outcome) == [words]
