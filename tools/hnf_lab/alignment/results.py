"""Evaluate aligned encoders: recall of retrieval, cross-sensor matching, linear probes, and the report tables.

`measure_encoders` returns a `Measurement`, stored beside the weights by `save_measurement`. `make_report` combines
several trainings into the tables: chance, vision and touch head, trained on one sensor and on both, tested on each.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.tactile_pairs import PAIR_SENSORS
from hnf_core.errors import FileError
from hnf_core.files import write_text

from .encoders import Embedding, embed_images, embed_touches
from .inputs import HeldOutTuples, Tuples, select_labelled
from .linear_probes import (
    HEADS,
    IMAGES,
    TOUCH,
    VISION,
    Cell,
    Estimate,
    Hits,
    ProbeInput,
    cross_validate_probes,
    estimate_accuracy,
    estimate_ratio,
    evaluate_probes,
)
from .train import AlignedEncoders

Float32 = NDArray[np.float32]
QUERIES_PER_BLOCK = 512


def compute_ranks(queries: Float32, gallery: Float32) -> NDArray[np.int64]:
    """Return the rank of the correct gallery row for each query, (n,); row i is correct for query i.

    Ties count against the query, so a constant embedding finds nothing.

    Parameters
    ----------
    queries
        (n, d) unit vectors.
    gallery
        (m ≥ n, d) unit vectors.
    """
    ranks = []
    for start in range(0, len(queries), QUERIES_PER_BLOCK):
        cosines = queries[start : start + QUERIES_PER_BLOCK] @ gallery.T
        correct = cosines[np.arange(len(cosines)), start + np.arange(len(cosines))]
        ranks.append((cosines >= correct[:, None]).sum(axis=1) - 1)
    return np.concatenate(ranks) if ranks else np.zeros(0, dtype=np.int64)


def compute_recall(queries: Float32, gallery: Float32, ks: Sequence[int]) -> dict[int, float]:
    """Return, for each k, the fraction of queries whose correct row is among the k nearest; chance is k / m."""
    rank = compute_ranks(queries, gallery)
    return {k: float(np.mean(rank < k)) for k in ks}


Rows = NDArray[np.int64]


@dataclass(frozen=True)
class PseudoTriplets:
    """Triplets of image, GelSight patch and DIGIT patch.

    Attributes
    ----------
    gelsight
        (t,) rows of the GelSight tuples, for image and patch.
    digit
        (t,) rows of the DIGIT tuples.
    cosine
        (t,) cosine similarity of the two patches.
    """

    gelsight: Rows
    digit: Rows
    cosine: Float32


def find_nearest(queries: Float32, gallery: Float32) -> tuple[Rows, Float32]:
    """Return the gallery row with the largest cosine for each query, and that cosine; the first of equals."""
    blocks = [
        queries[start : start + QUERIES_PER_BLOCK] @ gallery.T for start in range(0, len(queries), QUERIES_PER_BLOCK)
    ]
    rows = np.concatenate([block.argmax(axis=1) for block in blocks])
    return rows, np.concatenate([block.max(axis=1) for block in blocks])


def make_pseudo_triplets(gelsight: Float32, digit: Float32, *, mutual: bool = False) -> PseudoTriplets:
    """Match each GelSight tuple with the DIGIT patch nearest to it in the embedding space.

    Parameters
    ----------
    gelsight, digit
        (n, d) and (m ≥ 1, d) touch embeddings of unit length.
    mutual
        Keep only mutual nearest neighbours: fewer and more reliable.
    """
    nearest, cosine = find_nearest(gelsight, digit)
    rows = np.arange(len(gelsight))
    if mutual:
        back, _ = find_nearest(digit, gelsight)
        rows = rows[back[nearest] == rows]
    return PseudoTriplets(rows, nearest[rows], cosine[rows])


def compute_label_agreement(
    found: PseudoTriplets, gelsight_label: NDArray[np.int64], digit_label: NDArray[np.int64]
) -> float:
    """Return the fraction of triplets whose two patches have the same label."""
    return float(np.mean(gelsight_label[found.gelsight] == digit_label[found.digit]))


RECALL_RANKS = (1, 5, 10)
"""Ranks k of the reported recall."""
PROBE_ITEMS = 2000
"""Number of labelled tuples of each sensor to which probes are fitted."""


@dataclass(frozen=True)
class CrossSensorRetrieval:
    """Agreement of DIGIT patches matched to GelSight tuples of other places.

    Attributes
    ----------
    of_class, of_piece
        Fractions of triplets whose patches are of one class and of one instance.
    by_chance
        Fraction of one class with random matches.
    mutual
        Number of mutual nearest neighbours.
    mutual_of_class
        Fraction of those of one class.
    """

    triplets: int
    of_class: float
    of_piece: float
    by_chance: float
    mutual: int
    mutual_of_class: float


@dataclass(frozen=True)
class Measurement:
    """Evaluation of one pair of encoders.

    Attributes
    ----------
    trained_on
        "gelsight", "digit" or "both".
    known, unseen
        Probe hits, see HeldOutTuples.
    recall
        Sensor → direction → k → recall with `gallery` candidates.
    bridged
        Cross-sensor retrieval; None with a single sensor.
    """

    trained_on: str
    known: Mapping[Cell, Hits]
    unseen: Mapping[Cell, Hits]
    recall: Mapping[str, Mapping[str, Mapping[int, float]]]
    gallery: int
    bridged: CrossSensorRetrieval | None


def measure_encoders(
    models: AlignedEncoders, training: Tuples, held_out: HeldOutTuples, seed: int = 0, items: int = PROBE_ITEMS
) -> Measurement:
    """Evaluate encoders on held-out tuples by probes and retrieval.

    Probes are fitted to training tuples, except for unseen classes, which are cross-validated. Without labels there are
    no probes.

    Parameters
    ----------
    models
        The encoders.
    training
        Tuples to which probes are fitted.
    held_out
        Tuples to test on.
    seed
        Seed of draws and touch noise.
    items
        Number of tuples of each sensor to which probes are fitted.

    Raises
    ------
    UsageError
        If a sensor has no training tuples.
    """
    trained_on = PAIR_SENSORS if models.sensor == "both" else (models.sensor,)
    points, known = _embed_sets(models, held_out.known, seed)
    _, unseen = _embed_sets(models, held_out.unseen, seed)
    labelled = {name: tuples.select(tuples.label >= 0) for name, tuples in known.items() if (tuples.label >= 0).any()}
    sensors_to_fit = dict.fromkeys((*trained_on, *labelled)) if labelled else ()
    _, fitted = _embed_sets(
        models, {name: select_labelled(training.select_sensor(name), items, seed) for name in sensors_to_fit}, seed + 1
    )
    return Measurement(
        models.sensor,
        evaluate_probes(fitted, labelled, trained_on) if labelled else {},
        cross_validate_probes(unseen, trained_on) if unseen else {},
        {name: evaluate_retrieval(tuples) for name, tuples in points.items()},
        max(len(tuples.label) for tuples in known.values()),
        None
        if held_out.disjoint is None
        else evaluate_cross_sensor_retrieval(*(points[name].select(held_out.disjoint[name]) for name in PAIR_SENSORS)),
    )


def _embed_sets(
    models: AlignedEncoders, sets: Mapping[str, Tuples], seed: int
) -> tuple[dict[str, ProbeInput], dict[str, ProbeInput]]:
    """Return all sets as points of the space and as the features before it; images of equal rows are embedded once."""
    points: dict[str, ProbeInput] = {}
    features: dict[str, ProbeInput] = {}
    images: dict[bytes, Embedding] = {}
    for name, tuples in sets.items():
        key = tuples.row.tobytes()
        if key not in images:
            images[key] = embed_images(models.vision, tuples, models.pixels)
        touch = embed_touches(models.touch, tuples, models.pixels, seed)
        told = tuples.label, tuples.group, len(tuples.classes)
        points[name] = ProbeInput(images[key].points, touch.points, *told)
        features[name] = ProbeInput(images[key].features, touch.features, *told)
    return points, features


def evaluate_retrieval(embeddings: ProbeInput) -> dict[str, dict[int, float]]:
    """Return the recall from image to touch and from touch to image."""
    return {
        "look to touch": compute_recall(embeddings.image, embeddings.touch, RECALL_RANKS),
        "touch to look": compute_recall(embeddings.touch, embeddings.image, RECALL_RANKS),
    }


def evaluate_cross_sensor_retrieval(gelsight: ProbeInput, digit: ProbeInput) -> CrossSensorRetrieval:
    """Match patches of both sensors; no place is touched by both."""
    label, group = (gelsight.label, digit.label), (gelsight.group, digit.group)
    triplets = make_pseudo_triplets(gelsight.touch, digit.touch)
    mutual_triplets = make_pseudo_triplets(gelsight.touch, digit.touch, mutual=True)
    return CrossSensorRetrieval(
        len(triplets.gelsight), compute_label_agreement(triplets, *label), compute_label_agreement(triplets, *group),
        float(np.mean(label[0][:, None] == label[1][None, :])), len(mutual_triplets.gelsight),
        compute_label_agreement(mutual_triplets, *label),
    )  # fmt: skip


MEASUREMENT_FORMAT = "hnf-alignment-measured-1"


def save_measurement(path: Path, measured: Measurement, sums: Mapping[str, str]) -> None:
    """Write a measurement. sums: checksums of the weights. Raises FileError."""
    record = {
        "format": MEASUREMENT_FORMAT, "sha256": dict(sums), "trained_on": measured.trained_on,
        "known": _hits_to_json(measured.known), "unseen": _hits_to_json(measured.unseen),
        "recall": {
            sensor: {way: {str(k): value for k, value in values.items()} for way, values in directions.items()}
            for sensor, directions in measured.recall.items()
        },
        "gallery": measured.gallery, "bridged": None if measured.bridged is None else asdict(measured.bridged),
    }  # fmt: skip
    write_text(path, json.dumps(record) + "\n")


def load_measurement(path: Path, sums: Mapping[str, str]) -> Measurement | None:
    """Load a measurement; None if there is none or it belongs to other weights.

    Raises
    ------
    FileError
        If the file is damaged.
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["format"] != MEASUREMENT_FORMAT or record["sha256"] != dict(sums):
            return None
        return Measurement(
            str(record["trained_on"]), _hits_from_json(record["known"]), _hits_from_json(record["unseen"]),
            {
                sensor: {way: {int(k): float(value) for k, value in values.items()} for way, values in ways.items()}
                for sensor, ways in record["recall"].items()
            },
            int(record["gallery"]), None if record["bridged"] is None else CrossSensorRetrieval(**record["bridged"]),
        )  # fmt: skip
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileError(f"cannot be read ({error}).", where=str(path), remedy="Delete it; it is made again.") from error


def _hits_to_json(cells: Mapping[Cell, Hits]) -> list[dict[str, Any]]:
    return [
        {
            "head": head, "tested_on": tested_on, "group": hits.group.tolist(),
            "correct": "".join("1" if is_correct else "0" for is_correct in hits.correct),
        }
        for (head, tested_on), hits in cells.items()
    ]  # fmt: skip


def _hits_from_json(cells: list[dict[str, Any]]) -> dict[Cell, Hits]:
    return {
        (str(cell["head"]), str(cell["tested_on"])): Hits(
            np.array([digit == "1" for digit in cell["correct"]]), np.array(cell["group"], dtype=np.int64)
        )
        for cell in cells
    }


TITLES = {"known": "New pieces of known classes", "unseen": "Classes that the encoders never met"}
SENSOR_NAMES = {"gelsight": "GelSight", "digit": "DIGIT", "both": "both", "looks": "looks"}


@dataclass(frozen=True)
class AccuracyRow:
    """One accuracy."""

    data: str
    trained_on: str
    head: str
    tested_on: str
    accuracy: Estimate


@dataclass(frozen=True)
class Retention:
    """Accuracy on a sensor relative to that of the encoders trained on that sensor alone."""

    data: str
    trained_on: str
    tested_on: str
    ratio: Estimate


@dataclass(frozen=True)
class Report:
    """Results of several trainings. chance: data → frequency of the most frequent class."""

    chance: Mapping[str, float]
    rows: tuple[AccuracyRow, ...]
    kept: tuple[Retention, ...]
    measured: tuple[Measurement, ...]

    def to_json(self) -> dict[str, Any]:
        return {
            "chance": {name: round(value, 4) for name, value in self.chance.items()},
            "accuracy": [{**_get_text_fields(row), "accuracy": row.accuracy.to_json()} for row in self.rows],
            "kept": [{**_get_text_fields(each), "ratio": each.ratio.to_json()} for each in self.kept],
            "recall": {each.trained_on: {"gallery": each.gallery, **each.recall} for each in self.measured},
            "bridged": {
                each.trained_on: asdict(each.bridged) for each in self.measured if each.bridged is not None
            },
        }  # fmt: skip


def compute_chance_levels(held_out: HeldOutTuples) -> dict[str, float]:
    """Return the frequency of the most frequent class, for known and unseen data that have labels."""
    levels = {}
    for name, tested in (("known", held_out.known), ("unseen", held_out.unseen)):
        label = np.concatenate([tuples.label for tuples in tested.values()]) if tested else np.zeros(0, dtype=np.int64)
        if (label >= 0).any():
            levels[name] = float(np.bincount(label[label >= 0]).max() / (label >= 0).sum())
    return levels


def make_report(measured: Sequence[Measurement], chances: Mapping[str, float]) -> Report:
    """Combine measurements, one per training. chances: chance levels of the data to report."""
    rows = [
        AccuracyRow(data, result.trained_on, head, tested_on, estimate_accuracy(hits))
        for data in chances
        for head in HEADS
        for result in measured
        for (name, tested_on), hits in _get_cells(result, data).items()
        if name == head
    ]
    single_sensor = {result.trained_on: result for result in measured if result.trained_on in PAIR_SENSORS}
    retentions = [
        Retention(
            data,
            result.trained_on,
            sensor,
            estimate_ratio(_get_cells(result, data)[TOUCH, sensor], _get_cells(reference, data)[TOUCH, sensor]),
        )
        for data in chances
        for result in measured
        for sensor, reference in single_sensor.items()
        if sensor != result.trained_on and (TOUCH, sensor) in _get_cells(result, data)
    ]
    return Report(dict(chances), tuple(rows), tuple(retentions), tuple(measured))


PUBLISHED = (
    ("chance", "18.60 / 11.08", "18.60 / 11.08"),
    ("TaRF (TnG)", "54.70 / –", "–"),
    ("TaRF (TnG + TaRF)", "57.60 / –", "–"),
    ("GACM (HaTT GelSight)", "–", "– / 77.29"),
    ("HNF (TnG + TaRF + HaTT)", "76.16 / 68.75", "55.40 / 92.13"),
    ("HNF (balanced)", "75.47 / 97.19", "67.73 / 96.44"),
)
"""Method, and accuracy % of its vision and touch on Touch-and-Go / HaTT, as published: other data than ours."""


def _format_published(report: Report) -> str:
    """Format the paper's table: published rows, then chance and the encoders trained on both sensors here."""
    found = {
        (row.head, row.tested_on): f"{100 * row.accuracy.value:.1f}"
        for row in report.rows
        if (row.data, row.trained_on) == ("known", "both")
    }
    vision, *touch = (found.get(cell, "–") for cell in ((VISION, IMAGES), (TOUCH, "gelsight"), (TOUCH, "digit")))
    chance = f"{100 * report.chance.get('known', float('nan')):.1f}"
    return "\n".join(
        ["| linear probe, accuracy % | data | vision | touch |", "|---|---|---|---|"]
        + [f"| {name} | published: TnG / HaTT | {looks} | {felt} |" for name, looks, felt in PUBLISHED]
        + [f"| chance | ours: generated pairs | {chance} | {chance} |"]
        + [f"| both sensors, one space | ours: generated pairs, GelSight / DIGIT | {vision} | {' / '.join(touch)} |"]
    )


def format_report(report: Report) -> str:
    """Format the tables as Markdown."""
    parts = [_format_published(report)] if "known" in report.chance else []
    for data, value in report.chance.items():
        rows = [row for row in report.rows if row.data == data]
        items = rows[0].accuracy
        lines = [
            f"{TITLES[data]}: {items.items} views of {items.groups} pieces; chance {100 * value:.1f} %.",
            "",
            "| head | trained on | tested on | accuracy % (95 %) |",
            "|---|---|---|---|",
        ]
        lines += [
            f"| {row.head} | {_get_sensor_name(row.trained_on)} | {_get_sensor_name(row.tested_on)} | "
            f"{_format_percent(row.accuracy)} |"
            for row in rows
        ]
        retentions = [retention for retention in report.kept if retention.data == data]
        if retentions:
            lines += [
                "",
                "| touch head trained on | tested on | of the same sensor's accuracy % (95 %) |",
                "|---|---|---|",
            ]
            lines += [
                f"| {_get_sensor_name(retention.trained_on)} | {_get_sensor_name(retention.tested_on)} | "
                f"{_format_percent(retention.ratio)} |" for retention in retentions
            ]  # fmt: skip
        parts.append("\n".join(lines))
    parts.append(_format_retrieval(report.measured))
    bridges = _format_bridging(report.measured)
    return "\n\n".join([*parts, *([bridges] if bridges else [])]) + "\n"


def _format_retrieval(measured: Sequence[Measurement]) -> str:
    ks = sorted(
        {
            k
            for result in measured
            for directions in result.recall.values()
            for values in directions.values()
            for k in values
        }
    )
    head = [f"The right one of {measured[0].gallery} among the k nearest, %.", ""]
    head += [f"| trained on | touch | way | {' | '.join(f'k = {k}' for k in ks)} |", "|---" * (3 + len(ks)) + "|"]
    return "\n".join(
        head
        + [
            f"| {_get_sensor_name(result.trained_on)} | {_get_sensor_name(sensor)} | {direction} | "
            + " | ".join(f"{100 * values[k]:.1f}" for k in ks)
            + " |"
            for result in measured
            for sensor, directions in result.recall.items()
            for direction, values in directions.items()
        ]
    )


def _format_bridging(measured: Sequence[Measurement]) -> str:
    lines = [
        f"| {_get_sensor_name(result.trained_on)} | {retrieval.triplets} | {100 * retrieval.of_class:.1f} | "
        f"{100 * retrieval.of_piece:.1f} | "
        f"{100 * retrieval.by_chance:.1f} | {retrieval.mutual} | {100 * retrieval.mutual_of_class:.1f} |"
        for result in measured
        if (retrieval := result.bridged) is not None
    ]
    head = [
        "DIGIT patches attached to GelSight tuples of other places by the nearest neighbor.", "",
        "| trained on | triplets | of one class % | of one piece % | chance of one class % | mutual | of one class % |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    return "\n".join(head + lines) if lines else ""


def _get_cells(measured: Measurement, data: str) -> Mapping[Cell, Hits]:
    return measured.known if data == "known" else measured.unseen


def _get_text_fields(row: AccuracyRow | Retention) -> dict[str, str]:
    return {name: value for name, value in asdict(row).items() if isinstance(value, str)}


def _get_sensor_name(key: str) -> str:
    return SENSOR_NAMES.get(key, key)


def _format_percent(value: Estimate) -> str:
    return f"{100 * value.value:.1f} ({100 * value.low:.1f}–{100 * value.high:.1f})"
