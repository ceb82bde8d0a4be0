"""Probes of both heads on every sensor: which tuples each is fitted to, and which it gets right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .probe import LinearProbe, choose_linear_probe
from .statistics import Hits

Rows = NDArray[np.int64]
Float32 = NDArray[np.float32]
Cell = tuple[str, str]
"""Head, and what it is tested on."""

VISION, TOUCH, REFITTED = HEADS = ("vision", "touch", "touch, probe of the tested sensor")
IMAGES = "looks"
FOLD_COUNT = 4


@dataclass(frozen=True)
class ProbeInput:
    """n labelled tuples as the encoders see them. look, touch: (n, d). label, group: (n,), see Tuples. classes: how
    many."""

    image: Float32
    touch: Float32
    label: Rows
    group: Rows
    classes: int

    def select(self, chosen: NDArray[np.generic]) -> ProbeInput:
        return ProbeInput(
            self.image[chosen], self.touch[chosen], self.label[chosen], self.group[chosen], self.classes
        )  # fmt: skip


def concatenate_inputs(inputs: Sequence[ProbeInput]) -> ProbeInput:
    """One after the other."""
    return ProbeInput(
        np.concatenate([part.image for part in inputs]),
        np.concatenate([part.touch for part in inputs]),
        np.concatenate([part.label for part in inputs]),
        np.concatenate([part.group for part in inputs]),
        inputs[0].classes,
    )


def evaluate_probes(
    fitted: Mapping[str, ProbeInput], tested: Mapping[str, ProbeInput], trained_on: Sequence[str]
) -> dict[Cell, Hits]:
    """Hits by head and sensor.

    fitted, tested: sensor → tuples. trained_on: the sensors that the encoders know. The vision probe and the touch
    probe are fitted to those sensors' tuples together; REFITTED is a touch probe fitted to the tested sensor alone,
    which tells what the encoders miss from what the probe misses.
    """
    known = concatenate_inputs([fitted[name] for name in trained_on])
    first = next(iter(tested.values()))
    vision = _fit_probe(known.image, known)
    out = {(VISION, IMAGES): Hits(vision.predict(first.image) == first.label, first.group)}
    touch = _fit_probe(known.touch, known)
    for name, each in tested.items():
        alone = touch if list(trained_on) == [name] else _fit_probe(fitted[name].touch, fitted[name])
        for head, probe in ((TOUCH, touch), (REFITTED, alone)):
            out[head, name] = Hits(probe.predict(each.touch) == each.label, each.group)
    return out


def cross_validate_probes(tested: Mapping[str, ProbeInput], trained_on: Sequence[str]) -> dict[Cell, Hits]:
    """For classes that encoders never met: every piece is judged by probes that were fitted to the other folds' pieces.

    tested: sensor → tuples, the same ones under every sensor.
    """
    first = next(iter(tested.values()))
    fold = _assign_folds(first.label, first.group)
    right: dict[Cell, NDArray[np.bool_]] = {}
    for number in range(FOLD_COUNT):
        inside = fold == number
        rest = {name: each.select(~inside) for name, each in tested.items()}
        hits = evaluate_probes(rest, {name: each.select(inside) for name, each in tested.items()}, trained_on)
        for cell, hit in hits.items():
            right.setdefault(cell, np.zeros(len(fold), dtype=bool))[inside] = hit.correct
    return {cell: Hits(correct, first.group) for cell, correct in right.items()}


def _fit_probe(x: NDArray[np.float32], probe_input: ProbeInput) -> LinearProbe:
    return choose_linear_probe(x, probe_input.label, probe_input.group, probe_input.classes)[0]


def _assign_folds(label: Rows, group: Rows) -> Rows:
    """Fold of each tuple: the pieces of every class go to the folds by turns."""
    out = np.zeros(len(label), dtype=np.int64)
    for each in np.unique(label):
        mine = label == each
        out[mine] = np.unique(group[mine], return_inverse=True)[1] % FOLD_COUNT
    return out
