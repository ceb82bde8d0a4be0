"""What was measured, kept beside the weights, so that a table of several trainings is put together later."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileError
from ...files import write_text
from .heads import Cell
from .measure import CrossSensorRetrieval, Measurement
from .statistics import Hits

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
