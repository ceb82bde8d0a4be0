"""What frozen encoders are worth: probes of either head on each sensor, retrieval, bridging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...datasets.tactile_pairs import PAIR_SENSORS
from .batches import Embedded, embed
from .bridge import agreement, triplets
from .data import Judged, labelled
from .heads import Cell, Seen, folded, probed
from .models import Models
from .retrieval import recall
from .statistics import Hits
from .tuples import Tuples

KS = (1, 5, 10)
PROBE_ITEMS = 4000
"""Labelled tuples of each sensor that probes are fitted to."""


@dataclass(frozen=True)
class Bridged:
    """DIGIT patches attached to GelSight tuples of other places. of_class, of_piece: shares of triplets whose patches
    are of one class, of one piece. by_chance: share of one class where any patch is taken. mutual: how many of the
    triplets are each other's nearest, and mutual_of_class what share of those is of one class."""

    triplets: int
    of_class: float
    of_piece: float
    by_chance: float
    mutual: int
    mutual_of_class: float


@dataclass(frozen=True)
class Measured:
    """trained_on: gelsight, digit or both. known, unseen: hits, see Judged. recall: sensor → way → k → share, the right
    one among `gallery`. bridged: None where there is one sensor only."""

    trained_on: str
    known: Mapping[Cell, Hits]
    unseen: Mapping[Cell, Hits]
    recall: Mapping[str, Mapping[str, Mapping[int, float]]]
    gallery: int
    bridged: Bridged | None


def measure(models: Models, learn: Tuples, judged: Judged, seed: int = 0, items: int = PROBE_ITEMS) -> Measured:
    """Probes are fitted to tuples of `learn` (`items` of each sensor), and none of `judged` is fitted to, but for its
    unseen classes, which are probed fold by fold. Without labels there are no probes. Raises UsageError where a sensor
    is not in `learn`."""
    trained_on = PAIR_SENSORS if models.sensor == "both" else (models.sensor,)

    def embedded(tuples: Tuples, salt: int) -> Embedded:
        return embed(models.vision, models.touch, tuples, models.pixels, seed + salt)

    def seen(tuples: Tuples, salt: int) -> Seen:
        return Seen(embedded(tuples, salt), tuples.label, tuples.group, len(tuples.classes))

    known = {name: seen(each, 2) for name, each in judged.known.items()}
    named = {name: each.take(each.label >= 0) for name, each in known.items() if (each.label >= 0).any()}
    needed = dict.fromkeys((*trained_on, *named)) if named else ()
    fitted = {name: seen(labelled(learn.of_sensor(name), items, seed), 1) for name in needed}
    unseen = {name: seen(each, 3) for name, each in judged.unseen.items()}
    return Measured(
        models.sensor,
        probed(fitted, named, trained_on) if named else {},
        folded(unseen, trained_on) if unseen else {},
        {name: _recalled(each.embedded) for name, each in known.items()},
        max(len(each.label) for each in known.values()),
        None if judged.touched is None else bridged(judged.touched, embedded(judged.touched, 4)),
    )


def _recalled(embedded: Embedded) -> dict[str, dict[int, float]]:
    return {
        "look to touch": recall(embedded.vision, embedded.touch, KS),
        "touch to look": recall(embedded.touch, embedded.vision, KS),
    }


def bridged(tuples: Tuples, embedded: Embedded) -> Bridged:
    """tuples: of both sensors, no place touched by both."""
    gelsight, digit = (tuples.sensor == make for make in range(len(PAIR_SENSORS)))
    label, group = (tuples.label[gelsight], tuples.label[digit]), (tuples.group[gelsight], tuples.group[digit])
    found = triplets(embedded.touch[gelsight], embedded.touch[digit])
    sure = triplets(embedded.touch[gelsight], embedded.touch[digit], mutual=True)
    return Bridged(
        len(found.gelsight), agreement(found, *label), agreement(found, *group),
        float(np.mean(label[0][:, None] == label[1][None, :])), len(sure.gelsight), agreement(sure, *label),
    )  # fmt: skip
