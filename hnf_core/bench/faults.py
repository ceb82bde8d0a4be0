"""Every fault ends in silence: each of them at frames drawn at random, on a virtual device behind a real pty."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from .faults_kinds import KINDS, Kind
from .faults_rig import SILENT_S, Outcome, Rig
from .frame import Options, Row, Spread

NAME = "faults"
SEED = 20
TIMES = 20
"""Of each kind for each repeat: 100 with 5."""

QUICK = 2


def rows(options: Options) -> list[Row]:
    """For each kind: how long something still sounded, by the device's sample clock; how many did not end well."""
    count = QUICK if options.quick else TIMES * options.repeats
    return [_row(kind, _outcomes(kind, count, options)) for kind in KINDS]


def outcomes(kind: Kind, count: int, seed: int) -> list[Outcome]:
    """Let it happen so often, each time on a device of its own."""
    found = []
    for trial in range(count):
        with Rig(np.random.default_rng([seed, trial])) as rig:
            found.append(kind.trial(rig))
    return found


def faults_of(kind: Kind, outcome: Outcome) -> list[str]:
    """What was not as promised; nothing where all is well."""
    promises = {
        f"{1e3 * outcome.silent_s:.1f} ms until silence": outcome.silent_s <= SILENT_S,
        f"{len(outcome.messages)} messages": len(outcome.messages) == kind.told,
        f"{outcome.beyond} counts beyond limits": outcome.beyond == 0,
        "hung": not outcome.hung,
        f"does not start again ({outcome.not_again})": not outcome.not_again,
        "played on" if outcome.played_on else "did not play on": outcome.played_on == kind.survives,
    }
    return [broken for broken, kept in promises.items() if not kept]


def _outcomes(kind: Kind, count: int, options: Options) -> list[Outcome]:
    options.watch(f"{NAME}: {kind.name}")
    return outcomes(kind, count, SEED)


def _form(message: str) -> str:
    """Without the port and the figures, which differ each time."""
    return re.sub(r"\d+([.]\d+)?", "#", message.partition(": ")[2] or message)


def _row(kind: Kind, found: Sequence[Outcome]) -> Row:
    bad = [broken for outcome in found if (broken := faults_of(kind, outcome))]
    noticed = [outcome.noticed_s for outcome in found if outcome.noticed_s is not None]
    notes = ["plays on until stopped" if kind.survives else "ends"]
    if noticed:
        notes.append(f"known to the host within {1e3 * max(noticed):.0f} ms")
    told = Counter(_form(message) for outcome in found for message in outcome.messages)
    notes += [f"“{words}” × {times}" for words, times in told.most_common(2)]
    notes += [f"NOT WELL: {', '.join(broken)}" for broken in bad[:3]]
    return Row(
        NAME,
        kind.name,
        Spread.of([outcome.silent_s for outcome in found]),
        error=float(len(bad)),
        error_unit=f"of {len(found)} not as promised",
        note="; ".join(notes),
    )
