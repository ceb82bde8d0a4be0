"""How often the right one is among the k nearest.

From two sensors that never touched the same place to triplets: each GelSight tuple takes the DIGIT patch that is
nearest to it in the shared space.

What frozen encoders are worth: probes of either head on each sensor, retrieval, bridging.

What was measured, kept beside the weights, so that a table of several trainings is put together later.

The paper's table of classification in form: chance, vision head, touch head; trained on one sensor and on both,
tested on each.
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

from .encoders import embed_images, embed_touches
from .inputs import HeldOutTuples, Tuples, select_labelled
from .linear_probes import (
    HEADS,
    TOUCH,
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
    """How many of the gallery stand before the right one, (n,): row i of the gallery is right for query i.

    queries, gallery: (n, d), (m ≥ n, d), of length 1. Ties count against the query: a constant embedding finds nothing.
    """
    out = []
    for start in range(0, len(queries), QUERIES_PER_BLOCK):
        cosines = queries[start : start + QUERIES_PER_BLOCK] @ gallery.T
        right = cosines[np.arange(len(cosines)), start + np.arange(len(cosines))]
        out.append((cosines >= right[:, None]).sum(axis=1) - 1)
    return np.concatenate(out) if out else np.zeros(0, dtype=np.int64)


def compute_recall(queries: Float32, gallery: Float32, ks: Sequence[int]) -> dict[int, float]:
    """Share of queries whose own row is among the k nearest of the gallery, for each k; by chance k / len(gallery)."""
    rank = compute_ranks(queries, gallery)
    return {k: float(np.mean(rank < k)) for k in ks}


Rows = NDArray[np.int64]


@dataclass(frozen=True)
class PseudoTriplets:
    """Picture, GelSight patch, DIGIT patch.

    gelsight: (t,) rows of the GelSight tuples: picture and patch. digit: (t,) rows of the DIGIT tuples. cosine: (t,)
    likeness of the two patches.
    """

    gelsight: Rows
    digit: Rows
    cosine: Float32


def find_nearest(queries: Float32, gallery: Float32) -> tuple[Rows, Float32]:
    """Row of the gallery with the largest cosine for each query, and that cosine; the first of equals."""
    found = [
        queries[start : start + QUERIES_PER_BLOCK] @ gallery.T for start in range(0, len(queries), QUERIES_PER_BLOCK)
    ]
    rows = np.concatenate([each.argmax(axis=1) for each in found])
    return rows, np.concatenate([each.max(axis=1) for each in found])


def make_pseudo_triplets(gelsight: Float32, digit: Float32, *, mutual: bool = False) -> PseudoTriplets:
    """One triplet for each GelSight tuple, by its touch embedding.

    gelsight: (n, d), digit: (m ≥ 1, d), of length 1. mutual: only where the DIGIT patch's nearest GelSight patch is
    this one too, fewer and surer.
    """
    there, cosine = find_nearest(gelsight, digit)
    rows = np.arange(len(gelsight))
    if mutual:
        back, _ = find_nearest(digit, gelsight)
        rows = rows[back[there] == rows]
    return PseudoTriplets(rows, there[rows], cosine[rows])


def compute_label_agreement(
    found: PseudoTriplets, gelsight_label: NDArray[np.int64], digit_label: NDArray[np.int64]
) -> float:
    """Share of triplets whose two patches are of one material."""
    return float(np.mean(gelsight_label[found.gelsight] == digit_label[found.digit]))


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
        float(np.mean(label[0][:, None] == label[1][None, :])), len(sure.gelsight), compute_label_agreement(sure,
        *label),
    )  # fmt: skip


MEASUREMENT_FORMAT = "hnf-alignment-measured-1"


def save_measurement(path: Path, measured: Measurement, sums: Mapping[str, str]) -> None:
    """sums: checksums of the weights. Raises FileError."""
    record = {
        "format": MEASUREMENT_FORMAT, "sha256": dict(sums), "trained_on": measured.trained_on,
        "known": _hits_to_json(measured.known), "unseen": _hits_to_json(measured.unseen),
        "recall": {
            sensor: {way: {str(k): value for k, value in found.items()} for way, found in ways.items()}
            for sensor, ways in measured.recall.items()
        },
        "gallery": measured.gallery, "bridged": None if measured.bridged is None else asdict(measured.bridged),
    }  # fmt: skip
    write_text(path, json.dumps(record) + "\n")


def load_measurement(path: Path, sums: Mapping[str, str]) -> Measurement | None:
    """None where there is none, or it is of other weights. Raises FileError where the file is damaged."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["format"] != MEASUREMENT_FORMAT or record["sha256"] != dict(sums):
            return None
        return Measurement(
            str(record["trained_on"]), _hits_from_json(record["known"]), _hits_from_json(record["unseen"]),
            {
                sensor: {way: {int(k): float(value) for k, value in found.items()} for way, found in ways.items()}
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
            "correct": "".join("1" if each else "0" for each in hits.correct),
        }
        for (head, tested_on), hits in cells.items()
    ]  # fmt: skip


def _hits_from_json(cells: list[dict[str, Any]]) -> dict[Cell, Hits]:
    return {
        (str(cell["head"]), str(cell["tested_on"])): Hits(
            np.array([each == "1" for each in cell["correct"]]), np.array(cell["group"], dtype=np.int64)
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
    """What training on `trained_on` keeps of the accuracy that training on the tested sensor alone reaches."""

    data: str
    trained_on: str
    tested_on: str
    ratio: Estimate


@dataclass(frozen=True)
class Report:
    """chance: data → share of the most frequent class."""

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
    """Of known and unseen, where they have labels: share of the most frequent class, what always saying it gets."""
    found = {}
    for name, tested in (("known", held_out.known), ("unseen", held_out.unseen)):
        label = np.concatenate([each.label for each in tested.values()]) if tested else np.zeros(0, dtype=np.int64)
        if (label >= 0).any():
            found[name] = float(np.bincount(label[label >= 0]).max() / (label >= 0).sum())
    return found


def make_report(measured: Sequence[Measurement], chances: Mapping[str, float]) -> Report:
    """measured: one for each training. chances: of "known" and, where there are such, "unseen"."""
    rows = [
        AccuracyRow(data, each.trained_on, head, tested_on, estimate_accuracy(hits))
        for data in chances
        for head in HEADS
        for each in measured
        for (name, tested_on), hits in _get_cells(each, data).items()
        if name == head
    ]
    alone = {each.trained_on: each for each in measured if each.trained_on in PAIR_SENSORS}
    kept = [
        Retention(
            data,
            each.trained_on,
            sensor,
            estimate_ratio(_get_cells(each, data)[TOUCH, sensor], _get_cells(one, data)[TOUCH, sensor]),
        )
        for data in chances
        for each in measured
        for sensor, one in alone.items()
        if sensor != each.trained_on and (TOUCH, sensor) in _get_cells(each, data)
    ]
    return Report(dict(chances), tuple(rows), tuple(kept), tuple(measured))


def format_report(report: Report) -> str:
    """The tables in words."""
    parts = []
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
        kept = [each for each in report.kept if each.data == data]
        if kept:
            lines += [
                "",
                "| touch head trained on | tested on | of the same sensor's accuracy % (95 %) |",
                "|---|---|---|",
            ]
            lines += [
                f"| {_get_sensor_name(each.trained_on)} | {_get_sensor_name(each.tested_on)} | "
                f"{_format_percent(each.ratio)} |" for each in kept
            ]  # fmt: skip
        parts.append("\n".join(lines))
    parts.append(_format_retrieval(report.measured))
    bridges = _format_bridging(report.measured)
    return "\n\n".join([*parts, *([bridges] if bridges else [])]) + "\n"


def _format_retrieval(measured: Sequence[Measurement]) -> str:
    ks = sorted({k for each in measured for ways in each.recall.values() for found in ways.values() for k in found})
    head = [f"The right one of {measured[0].gallery} among the k nearest, %.", ""]
    head += [f"| trained on | touch | way | {' | '.join(f'k = {k}' for k in ks)} |", "|---" * (3 + len(ks)) + "|"]
    return "\n".join(
        head
        + [
            f"| {_get_sensor_name(each.trained_on)} | {_get_sensor_name(sensor)} | {way} | "
            + " | ".join(f"{100 * found[k]:.1f}" for k in ks)
            + " |"
            for each in measured
            for sensor, ways in each.recall.items()
            for way, found in ways.items()
        ]
    )


def _format_bridging(measured: Sequence[Measurement]) -> str:
    lines = [
        f"| {_get_sensor_name(each.trained_on)} | {found.triplets} | {100 * found.of_class:.1f} | "
        f"{100 * found.of_piece:.1f} | "
        f"{100 * found.by_chance:.1f} | {found.mutual} | {100 * found.mutual_of_class:.1f} |"
        for each in measured
        if (found := each.bridged) is not None
    ]
    head = [
        "DIGIT patches attached to GelSight tuples of other places by the nearest neighbour.", "",
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
