"""Whatever goes wrong on the wire or at the port ends in silence: each fault a few times, as `hnf bench faults` does it
a hundred times. Those of the playing process are in test_faults_process.py."""

from __future__ import annotations

from dataclasses import replace

import pytest
from ptys import needs_pty

from hnf_core.bench import faults_process
from hnf_core.bench.faults import faults_of, outcomes
from hnf_core.bench.faults_kinds import KINDS, Kind
from hnf_core.bench.faults_rig import Outcome

pytest.importorskip("serial", reason="pyserial is not installed")
pytestmark = needs_pty

OF_A_PROCESS = (faults_process.killed, faults_process.slept_briefly, faults_process.slept_long)
HERE = [kind for kind in KINDS if kind.trial not in OF_A_PROCESS]


@pytest.mark.parametrize("kind", HERE, ids=lambda kind: kind.name)
def test_it_ends_as_promised(kind: Kind) -> None:
    found = outcomes(kind, 2, seed=3)
    assert [faults_of(kind, outcome) for outcome in found] == [[], []], found


GOOD = Outcome(0.015, ("said once",))


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (replace(GOOD, silent_s=0.0201), "20.1 ms until silence"),
        (replace(GOOD, messages=()), "0 messages"),
        (replace(GOOD, messages=("one", "two")), "2 messages"),
        (replace(GOOD, beyond=1), "1 counts beyond limits"),
        (replace(GOOD, hung=True), "hung"),
        (replace(GOOD, not_again="busy"), "does not start again (busy)"),
        (replace(GOOD, played_on=True), "played on"),
    ],
)
def test_a_broken_promise_is_seen(outcome: Outcome, words: str) -> None:
    kind = Kind("any", lambda rig: GOOD)
    assert faults_of(kind, GOOD) == []
    assert faults_of(kind, outcome) == [words]
