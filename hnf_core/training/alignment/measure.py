"""What frozen encoders are worth: probes of either head on each sensor, retrieval, bridging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.tactile_pairs import PAIR_SENSORS
from .bridge import agreement, triplets
from .data import Judged, labelled
from .embedding import embed_looks, embed_touches
from .heads import Cell, Seen, folded, probed
from .models import Models
from .retrieval import recall
from .statistics import Hits
from .tuples import Tuples

KS = (1, 5, 10)
PROBE_ITEMS = 2000
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
    known = _seen(models, judged.known, seed)
    unseen = _seen(models, judged.unseen, seed)
    named = {name: each.take(each.label >= 0) for name, each in known.items() if (each.label >= 0).any()}
    needed = dict.fromkeys((*trained_on, *named)) if named else ()
    fitted = _seen(models, {name: labelled(learn.of_sensor(name), items, seed) for name in needed}, seed + 1)
    return Measured(
        models.sensor,
        probed(fitted, named, trained_on) if named else {},
        folded(unseen, trained_on) if unseen else {},
        {name: recalled(each) for name, each in known.items()},
        max(len(each.label) for each in known.values()),
        None if judged.apart is None else bridged(*(known[name].take(judged.apart[name]) for name in PAIR_SENSORS)),
    )


def _seen(models: Models, sets: Mapping[str, Tuples], seed: int) -> dict[str, Seen]:
    """Looks of equal rows are embedded once."""
    out: dict[str, Seen] = {}
    looks: dict[bytes, NDArray[np.float32]] = {}
    for name, tuples in sets.items():
        key = tuples.row.tobytes()
        if key not in looks:
            looks[key] = embed_looks(models.vision, tuples, models.pixels)
        touch = embed_touches(models.touch, tuples, models.pixels, seed)
        out[name] = Seen(looks[key], touch, tuples.label, tuples.group, len(tuples.classes))
    return out


def recalled(seen: Seen) -> dict[str, dict[int, float]]:
    """Both ways."""
    return {"look to touch": recall(seen.look, seen.touch, KS), "touch to look": recall(seen.touch, seen.look, KS)}


def bridged(gelsight: Seen, digit: Seen) -> Bridged:
    """Patches of both sensors, no place touched by both."""
    label, group = (gelsight.label, digit.label), (gelsight.group, digit.group)
    found = triplets(gelsight.touch, digit.touch)
    sure = triplets(gelsight.touch, digit.touch, mutual=True)
    return Bridged(
        len(found.gelsight), agreement(found, *label), agreement(found, *group),
        float(np.mean(label[0][:, None] == label[1][None, :])), len(sure.gelsight), agreement(sure, *label),
    )  # fmt: skip
