"""What frozen encoders are worth: probes of either head on each sensor, retrieval, bridging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.tactile_pairs import PAIR_SENSORS
from .bridge import compute_label_agreement, make_pseudo_triplets
from .data import HeldOutTuples, select_labelled
from .embedding import embed_images, embed_touches
from .heads import Cell, ProbeInput, cross_validate_probes, evaluate_probes
from .models import AlignedEncoders
from .retrieval import compute_recall
from .statistics import Hits
from .tuples import Tuples

RECALL_RANKS = (1, 5, 10)
PROBE_ITEMS = 2000
"""Labelled tuples of each sensor that probes are fitted to."""


@dataclass(frozen=True)
class CrossSensorRetrieval:
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
class Measurement:
    """trained_on: gelsight, digit or both. known, unseen: hits, see Judged. recall: sensor → way → k → share, the right
    one among `gallery`. bridged: None where there is one sensor only."""

    trained_on: str
    known: Mapping[Cell, Hits]
    unseen: Mapping[Cell, Hits]
    recall: Mapping[str, Mapping[str, Mapping[int, float]]]
    gallery: int
    bridged: CrossSensorRetrieval | None


def measure_encoders(
    models: AlignedEncoders, training: Tuples, held_out: HeldOutTuples, seed: int = 0, items: int = PROBE_ITEMS
) -> Measurement:
    """Probes are fitted to tuples of `learn` (`items` of each sensor), and none of `judged` is fitted to, but for its
    unseen classes, which are probed fold by fold. Without labels there are no probes. Raises UsageError where a sensor
    is not in `learn`."""
    trained_on = PAIR_SENSORS if models.sensor == "both" else (models.sensor,)
    known = _embed_sets(models, held_out.known, seed)
    unseen = _embed_sets(models, held_out.unseen, seed)
    named = {name: each.select(each.label >= 0) for name, each in known.items() if (each.label >= 0).any()}
    needed = dict.fromkeys((*trained_on, *named)) if named else ()
    fitted = _embed_sets(
        models, {name: select_labelled(training.select_sensor(name), items, seed) for name in needed}, seed + 1
    )
    return Measurement(
        models.sensor,
        evaluate_probes(fitted, named, trained_on) if named else {},
        cross_validate_probes(unseen, trained_on) if unseen else {},
        {name: evaluate_retrieval(each) for name, each in known.items()},
        max(len(each.label) for each in known.values()),
        None
        if held_out.disjoint is None
        else evaluate_cross_sensor_retrieval(*(known[name].select(held_out.disjoint[name]) for name in PAIR_SENSORS)),
    )


def _embed_sets(models: AlignedEncoders, sets: Mapping[str, Tuples], seed: int) -> dict[str, ProbeInput]:
    """Looks of equal rows are embedded once."""
    out: dict[str, ProbeInput] = {}
    looks: dict[bytes, NDArray[np.float32]] = {}
    for name, tuples in sets.items():
        key = tuples.row.tobytes()
        if key not in looks:
            looks[key] = embed_images(models.vision, tuples, models.pixels)
        touch = embed_touches(models.touch, tuples, models.pixels, seed)
        out[name] = ProbeInput(looks[key], touch, tuples.label, tuples.group, len(tuples.classes))
    return out


def evaluate_retrieval(embeddings: ProbeInput) -> dict[str, dict[int, float]]:
    """Both ways."""
    return {
        "look to touch": compute_recall(embeddings.image, embeddings.touch, RECALL_RANKS),
        "touch to look": compute_recall(embeddings.touch, embeddings.image, RECALL_RANKS),
    }


def evaluate_cross_sensor_retrieval(gelsight: ProbeInput, digit: ProbeInput) -> CrossSensorRetrieval:
    """Patches of both sensors, no place touched by both."""
    label, group = (gelsight.label, digit.label), (gelsight.group, digit.group)
    found = make_pseudo_triplets(gelsight.touch, digit.touch)
    sure = make_pseudo_triplets(gelsight.touch, digit.touch, mutual=True)
    return CrossSensorRetrieval(
        len(found.gelsight), compute_label_agreement(found, *label), compute_label_agreement(found, *group),
        float(np.mean(label[0][:, None] == label[1][None, :])), len(sure.gelsight), compute_label_agreement(sure, *label),
    )  # fmt: skip
