"""Whatever happens to the playing process ends in silence: a child that plays is stopped, continued and killed."""

from __future__ import annotations

import os

import pytest
from ptys import needs_pty

from hnf_core.bench import faults_process
from hnf_core.bench.faults import faults_of, outcomes
from hnf_core.bench.faults_kinds import KINDS, Kind

pytest.importorskip("serial", reason="pyserial is not installed")
pytestmark = needs_pty
if os.name != "posix":
    pytest.skip("this system has no signals that stop a process", allow_module_level=True)

OF_A_PROCESS = (faults_process.killed, faults_process.slept_briefly, faults_process.slept_long)
HERE = [kind for kind in KINDS if kind.trial in OF_A_PROCESS]


def test_there_are_three() -> None:
    assert len(HERE) == len(OF_A_PROCESS)


@pytest.mark.parametrize("kind", HERE, ids=lambda kind: kind.name)
def test_it_ends_as_promised(kind: Kind) -> None:
    found = outcomes(kind, 2, seed=4)
    assert [faults_of(kind, outcome) for outcome in found] == [[], []], found
