"""Probes of both heads on every sensor: which tuples each is fitted to, and which it gets right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .probe import Probe, chosen_probe
from .statistics import Hits

Rows = NDArray[np.int64]
Float32 = NDArray[np.float32]
Cell = tuple[str, str]
"""Head, and what it is tested on."""

VISION, TOUCH, REFITTED = HEADS = ("vision", "touch", "touch, probe of the tested sensor")
LOOKS = "looks"
FOLDS = 4


@dataclass(frozen=True)
class Seen:
    """n labelled tuples as the encoders see them. look, touch: (n, d). label, group: (n,), see Tuples. classes: how
    many."""

    look: Float32
    touch: Float32
    label: Rows
    group: Rows
    classes: int

    def take(self, chosen: NDArray[np.generic]) -> Seen:
        return Seen(
            self.look[chosen], self.touch[chosen], self.label[chosen], self.group[chosen], self.classes
        )  # fmt: skip


def joined(parts: Sequence[Seen]) -> Seen:
    """One after the other."""
    return Seen(
        np.concatenate([part.look for part in parts]),
        np.concatenate([part.touch for part in parts]),
        np.concatenate([part.label for part in parts]),
        np.concatenate([part.group for part in parts]),
        parts[0].classes,
    )


def probed(fitted: Mapping[str, Seen], tested: Mapping[str, Seen], trained_on: Sequence[str]) -> dict[Cell, Hits]:
    """Hits by head and sensor.

    fitted, tested: sensor → tuples. trained_on: the sensors that the encoders know. The vision probe and the touch
    probe are fitted to those sensors' tuples together; REFITTED is a touch probe fitted to the tested sensor alone,
    which tells what the encoders miss from what the probe misses.
    """
    known = joined([fitted[name] for name in trained_on])
    first = next(iter(tested.values()))
    vision = _fit(known.look, known)
    out = {(VISION, LOOKS): Hits(vision.predict(first.look) == first.label, first.group)}
    touch = _fit(known.touch, known)
    for name, each in tested.items():
        alone = touch if list(trained_on) == [name] else _fit(fitted[name].touch, fitted[name])
        for head, probe in ((TOUCH, touch), (REFITTED, alone)):
            out[head, name] = Hits(probe.predict(each.touch) == each.label, each.group)
    return out


def folded(tested: Mapping[str, Seen], trained_on: Sequence[str]) -> dict[Cell, Hits]:
    """For classes that encoders never met: every piece is judged by probes that were fitted to the other folds' pieces.

    tested: sensor → tuples, the same ones under every sensor.
    """
    first = next(iter(tested.values()))
    fold = _folds(first.label, first.group)
    right: dict[Cell, NDArray[np.bool_]] = {}
    for number in range(FOLDS):
        inside = fold == number
        rest = {name: each.take(~inside) for name, each in tested.items()}
        hits = probed(rest, {name: each.take(inside) for name, each in tested.items()}, trained_on)
        for cell, hit in hits.items():
            right.setdefault(cell, np.zeros(len(fold), dtype=bool))[inside] = hit.correct
    return {cell: Hits(correct, first.group) for cell, correct in right.items()}


def _fit(x: NDArray[np.float32], seen: Seen) -> Probe:
    return chosen_probe(x, seen.label, seen.group, seen.classes)[0]


def _folds(label: Rows, group: Rows) -> Rows:
    """Fold of each tuple: the pieces of every class go to the folds by turns."""
    out = np.zeros(len(label), dtype=np.int64)
    for each in np.unique(label):
        mine = label == each
        out[mine] = np.unique(group[mine], return_inverse=True)[1] % FOLDS
    return out
