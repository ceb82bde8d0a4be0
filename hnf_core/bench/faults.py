"""Every fault ends in silence: each of them at frames drawn at random, on a virtual device behind a real pty."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from .faults_kinds import FAULTS, Fault
from .faults_rig import MAX_SILENCE_DELAY_S, FaultRig, Outcome
from .frame import BenchOptions, Row, Spread

FAULTS_NAME = "faults"
SEED = 20
TRIALS_PER_REPEAT = 20
"""Of each kind for each repeat: 100 with 5."""

QUICK_TRIALS = 2


def measure_faults(options: BenchOptions) -> list[Row]:
    """For each kind: how long something still sounded, by the device's sample clock; how many did not end well."""
    count = QUICK_TRIALS if options.quick else TRIALS_PER_REPEAT * options.repeats
    return [_make_row(kind, _run_fault(kind, count, options)) for kind in FAULTS]


def run_trials(fault: Fault, count: int, seed: int) -> list[Outcome]:
    """Let it happen so often, each time on a device of its own."""
    found = []
    for trial in range(count):
        with FaultRig(np.random.default_rng([seed, trial])) as rig:
            found.append(fault.trial(rig))
    return found


def find_violations(fault: Fault, outcome: Outcome) -> list[str]:
    """What was not as promised; nothing where all is well."""
    promises = {
        f"{1e3 * outcome.silent_after_s:.1f} ms until silence": outcome.silent_after_s <= MAX_SILENCE_DELAY_S,
        f"{len(outcome.messages)} messages": len(outcome.messages) == fault.expected_messages,
        f"{outcome.violations} counts beyond limits": outcome.violations == 0,
        "hung": not outcome.hung,
        f"does not start again ({outcome.restart_problem})": not outcome.restart_problem,
        "played on" if outcome.played_on else "did not play on": outcome.played_on == fault.survives,
    }
    return [broken for broken, kept in promises.items() if not kept]


def _run_fault(fault: Fault, count: int, options: BenchOptions) -> list[Outcome]:
    options.watch(f"{FAULTS_NAME}: {fault.name}")
    return run_trials(fault, count, SEED)


def _normalise_message(message: str) -> str:
    """Without the port and the figures, which differ each time."""
    return re.sub(r"\d+([.]\d+)?", "#", message.partition(": ")[2] or message)


def _make_row(fault: Fault, found: Sequence[Outcome]) -> Row:
    bad = [broken for outcome in found if (broken := find_violations(fault, outcome))]
    noticed = [outcome.noticed_s for outcome in found if outcome.noticed_s is not None]
    notes = ["plays on until stopped" if fault.survives else "ends"]
    if noticed:
        notes.append(f"known to the host within {1e3 * max(noticed):.0f} ms")
    told = Counter(_normalise_message(message) for outcome in found for message in outcome.messages)
    notes += [f"“{words}” × {times}" for words, times in told.most_common(2)]
    notes += [f"NOT WELL: {', '.join(broken)}" for broken in bad[:3]]
    return Row(
        FAULTS_NAME,
        fault.name,
        Spread.from_values([outcome.silent_after_s for outcome in found]),
        error=float(len(bad)),
        error_unit=f"of {len(found)} not as promised",
        note="; ".join(notes),
    )
