"""The paper's table of classification in form: chance, vision head, touch head; trained on one sensor and on both,
tested on each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...datasets.tactile_pairs import PAIR_SENSORS
from .data import HeldOutTuples
from .heads import HEADS, TOUCH, Cell
from .measure import Measurement
from .statistics import Estimate, Hits, estimate_accuracy, estimate_ratio

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
            f"| {row.head} | {_get_sensor_name(row.trained_on)} | {_get_sensor_name(row.tested_on)} | {_format_percent(row.accuracy)} |"
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
                f"| {_get_sensor_name(each.trained_on)} | {_get_sensor_name(each.tested_on)} | {_format_percent(each.ratio)} |" for each in kept
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
        f"| {_get_sensor_name(each.trained_on)} | {found.triplets} | {100 * found.of_class:.1f} | {100 * found.of_piece:.1f} | "
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
