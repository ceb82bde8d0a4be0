"""Report of the judge of looks: Markdown, JSON and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hnf_core.export.figure import write_figure

from ..recordings.measure import BASELINES
from ..recordings.report import format_table, summarise
from ..recordings.spectra import Distance
from .measure import LOUD_ERROR_DB, PhotographResult, compute_accuracy, compute_calibration, get_recorded_kind

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODES = {True: "named after the texture", False: "nothing named"}


def format_photographs(results: Sequence[PhotographResult]) -> str:
    """Format the report as Markdown."""
    parts = [
        "# Judged by photographs",
        f"{len(results) // 2} photographs of recorded textures, touched on a plane in Blender; spectra at up to nine "
        "conditions, as in `hnf eval recordings`. Baselines leave the texture itself out.",
        "## Distance from the recorded spectrum [dB]",
        _format_distances(results),
        "## Identification",
        _format_identification(results),
        "## Confidence: told and right, in equally filled bins",
        _format_calibration(results),
    ]
    for named, label in MODES.items():
        parts += [f"## Kinds of stuff, {label}: recorded (rows), taken (columns)", _format_confusion(results, named)]
    return "\n\n".join([*parts, "## Photographs", _format_rows(results)])


def to_json(results: Sequence[PhotographResult]) -> dict[str, Any]:
    """Return all figures of the report as plain values."""
    return {
        "modes": {
            label: {
                "calibration_error": compute_calibration(*_list_confidence(group))[0],
                "right": compute_accuracy(group)[0],
                "right_balanced": compute_accuracy(group)[1],
                "median_db": summarise([result.distance.total for result in group])[0],
            }
            for named, label in MODES.items()
            if (group := _select(results, named))
        },
        "photographs": [
            {
                "name": result.texture.name,
                "kind": get_recorded_kind(result.texture),
                "named": result.named,
                "material": result.material,
                "taken_kind": result.kind,
                "confidence": result.confidence,
                "reason": result.reason,
                "right": result.right,
                "distance_db": result.distance.total,
                "level_db": result.distance.level,
                "shape_db": result.distance.shape,
                "baselines_db": {
                    name: distance.total for name, distance in zip(BASELINES, result.baselines, strict=True)
                },
            }
            for result in results
        ],
    }


def _select(results: Sequence[PhotographResult], named: bool) -> list[PhotographResult]:
    return [result for result in results if result.named is named]


def _list_confidence(results: Sequence[PhotographResult]) -> tuple[list[float], list[bool]]:
    known = [result for result in results if get_recorded_kind(result.texture)]
    return [result.confidence for result in known], [result.right for result in known]


def _format_distances(results: Sequence[PhotographResult]) -> str:
    answers: list[tuple[str, list[Distance]]] = [
        (f"what is felt, {label}", [result.distance for result in _select(results, named)])
        for named, label in MODES.items()
    ]
    one = _select(results, True)
    answers += [(name, [result.baselines[index] for result in one]) for index, name in enumerate(BASELINES)]
    rows = []
    for name, distances in answers:
        median, high, count = summarise([distance.total for distance in distances])
        level, shape = (summarise([getattr(distance, key) for distance in distances])[0] for key in ("level", "shape"))
        loud = sum(distance.total > LOUD_ERROR_DB for distance in distances)
        rows.append(
            [name, f"{median:.1f}", f"{high:.1f}", f"{level:.1f}", f"{shape:.1f}", str(loud), str(count)],
        )
    header = ["answer", "median", "90 %", "level", "shape", f"beyond {LOUD_ERROR_DB:.0f} dB", "textures"]
    return format_table(header, rows)


def _format_identification(results: Sequence[PhotographResult]) -> str:
    rows = []
    for named, label in MODES.items():
        group = _select(results, named)
        share, balanced = compute_accuracy(group)
        told, right = _list_confidence(group)
        error, _ = compute_calibration(told, right)
        rows.append([label, f"{share:.0%}", f"{balanced:.0%}", f"{np.mean(told):.0%}", f"{error:.3f}", str(len(told))])
    header = ["", "right kind", "balanced over kinds", "mean confidence", "expected calibration error", "photographs"]
    return format_table(header, rows)


def _format_calibration(results: Sequence[PhotographResult]) -> str:
    rows = []
    for named, label in MODES.items():
        _, bins = compute_calibration(*_list_confidence(_select(results, named)))
        rows.append([label, *(f"{told:.0%} → {right:.0%} ({count:.0f})" for told, right, count in bins)])
    return format_table(["told → right (count)", *(str(number + 1) for number in range(len(rows[0]) - 1))], rows)


def _format_confusion(results: Sequence[PhotographResult], named: bool) -> str:
    group = [result for result in _select(results, named) if get_recorded_kind(result.texture)]
    kinds = sorted({get_recorded_kind(result.texture) for result in group})
    taken = sorted({result.kind for result in group})
    rows = []
    for kind in kinds:
        counts = [
            sum(get_recorded_kind(result.texture) == kind and result.kind == other for result in group)
            for other in taken
        ]
        rows.append([kind, *(str(count) if count else "" for count in counts)])
    return format_table(["", *taken], rows)


def _format_rows(results: Sequence[PhotographResult]) -> str:
    rows = [
        [
            result.texture.name,
            "named" if result.named else "",
            result.material,
            f"{result.confidence:.0%}",
            result.reason,
            f"{result.distance.total:.1f}",
            f"{result.distance.level:.1f}",
            *("–" if np.isnan(distance.total) else f"{distance.total:.1f}" for distance in result.baselines[:2]),
        ]
        for result in sorted(results, key=lambda result: (-result.named, -result.distance.total))
    ]
    return format_table(["texture", "", "taken", "confidence", "because", "distance", "level", *BASELINES[:2]], rows)


def write_picture(path: Path, results: Sequence[PhotographResult]) -> None:
    """Draw the reliability of the confidence, and the distances beside the baselines."""

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=[2, 3])
        left.plot([0, 1], [0, 1], color="0.4", lw=0.8)
        groups, labels = [], []
        for named, label in MODES.items():
            group = _select(results, named)
            error, bins = compute_calibration(*_list_confidence(group))
            left.plot(bins[:, 0], bins[:, 1], "o-", label=f"{label}: error {error:.2f}")
            groups.append([result.distance.total for result in group])
            labels.append("named" if named else "not named")
        left.set_xlabel("confidence told")
        left.set_ylabel("share right")
        left.set_xlim(0, 1)
        left.set_ylim(0, 1)
        left.legend(frameon=False)
        one = _select(results, True)
        groups += [[result.baselines[index].total for result in one] for index in range(len(BASELINES))]
        finite = [np.asarray(group)[np.isfinite(group)] for group in groups]
        right.boxplot(finite, whis=(10, 90), showfliers=False)
        right.set_xticks(range(1, len(groups) + 1), [*labels, "all", "category", "name", "one"])
        right.set_xlabel("what is felt, or means of other recordings")
        right.set_ylabel("distance from the recording [dB]")
        right.set_ylim(bottom=0.0)

    write_figure(path, (1200, 500), draw)
