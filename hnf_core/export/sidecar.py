"""FILE.json beside an exported FILE: what its numbers stand for, where it comes from, and which bytes it speaks of."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FileError
from ..files import content_hash
from ..signal import Signal
from .json_files import read_json, write_json
from .options import ExportOptions
from .origin import SOFTWARE, make_provenance_record

SIDECAR_SCHEMA = 1


def get_sidecar_path(path: Path) -> Path:
    return path.with_name(path.name + ".json")


def is_sidecar(path: Path) -> bool:
    """Whether path is one, of whichever file."""
    try:
        record = read_json(path)
    except FileError:
        return False
    return "schema" in record and all(isinstance(record.get(name), str) for name in ("file", "hash"))


@dataclass(frozen=True)
class SourceStroke:
    """What an exported file was made of: a stroke, and the .blend it is in; "" where that is not told."""

    stroke: str
    blend: str


def write_sidecar(
    path: Path, format_name: str, signal: Signal, options: ExportOptions | None, loss: dict[str, Any], blend: str = ""
) -> None:
    """signal: what was exported to path, as the format called word. options: as for origin_record. loss: the report.
    blend: name of the .blend that the signal's stroke is in. Raises FileError."""
    record = {
        "schema": SIDECAR_SCHEMA,
        "file": path.name,
        "hash": content_hash(path.read_bytes()),
        "format": format_name,
        "software": SOFTWARE,
        **({"blend": blend} if blend else {}),
        "duration_s": signal.duration_s,
        **{name: value for name, value in make_provenance_record(signal, options).items() if name != "schema"},
        "loss": loss,
    }
    write_json(get_sidecar_path(path), record)


def read_sidecar_provenance(path: Path) -> tuple[int, dict[str, str]] | None:
    """Seed and provenance from the sidecar; None where there is none, or it speaks of other bytes."""
    try:
        record = _read_matching_sidecar(path)
        return int(record["seed"]), {str(name): str(value) for name, value in record["provenance"].items()}
    except (FileError, OSError, KeyError, TypeError, ValueError, AttributeError):
        return None


def read_sidecar_loss(path: Path) -> dict[str, Any] | None:
    """What the export of path lost, as `Loss.to_json` wrote it into the sidecar; None where there is none, or it speaks
    of other bytes, or is damaged."""
    try:
        loss = _read_matching_sidecar(path)["loss"]
        sound = isinstance(loss["exact"], bool) and all(isinstance(each, str) for each in loss["dropped"])
        levels = [float(loss[when][what]) for when in ("before", "after") for what in ("rms", "peak")]
        return dict(loss) if sound and all(0.0 <= each < math.inf for each in levels) else None
    except (FileError, OSError, KeyError, TypeError, ValueError, OverflowError):
        return None


def _read_matching_sidecar(path: Path) -> dict[str, Any]:
    """The sidecar, where it speaks of the bytes in path. Raises ValueError where it does not, FileError where there is
    none, KeyError, OSError."""
    record = read_json(get_sidecar_path(path))
    if record["hash"] != content_hash(path.read_bytes()):
        raise ValueError("it speaks of other bytes")
    return record


def read_source_stroke(path: Path) -> SourceStroke | None:
    """Who made path, as its sidecar says; None where it names no stroke, or there is none."""
    try:
        record = read_json(get_sidecar_path(path))
        return SourceStroke(str(record["provenance"]["stroke"]), str(record.get("blend", "")))
    except (FileError, KeyError, TypeError):
        return None
