"""Where a signal comes from and what its numbers stand for, as one line of text that formats keep in a free field.

FILE.json beside an exported FILE: what its numbers stand for, where it comes from, and which bytes it speaks of.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import FileError
from ..files import content_hash
from ..signal import Signal
from .envelope import CARRIER_DESCRIPTION
from .json_reader import read_json, write_json
from .options import (
    DEFAULT_FULL_SCALE_M_S2,
    DEFAULT_RANGE_HZ,
    MAX_FULL_SCALE_M_S2,
    MIN_FULL_SCALE_M_S2,
    ExportOptions,
    ImportOptions,
)
from .wav import UNITS

SOFTWARE = f"Haptic Neural Fields {__version__}"
_RECORD_SCHEMA = 1


def make_provenance_record(signal: Signal, options: ExportOptions | None) -> dict[str, Any]:
    """What can be written beside the data: schema, units, full scale and range (options None: a number is what it says,
    in units), seed, rate and provenance."""
    scale: dict[str, Any] = {"scale": 1.0}
    if options is not None:
        scale = {"full_scale": options.full_scale_m_s2, "range_hz": list(options.range_hz)}
        if options.full_scale_assumed:
            scale["full_scale_assumed"] = True
    return {
        "schema": _RECORD_SCHEMA,
        "units": UNITS,
        **scale,
        "seed": int(signal.seed),
        "sample_rate_hz": signal.sample_rate,
        "provenance": {str(name): str(value) for name, value in signal.provenance.items()},
    }


def encode_provenance(signal: Signal, options: ExportOptions | None) -> str:
    return json.dumps(make_provenance_record(signal, options), ensure_ascii=False)


@dataclass(frozen=True)
class Provenance:
    """full_scale_m_s2, range_hz: what 1 and 0 … 1 stand for. stated: whether the file said so. provenance: its own."""

    full_scale_m_s2: float
    range_hz: tuple[float, float]
    stated: bool
    provenance: dict[str, str]


def parse_provenance(text: object, options: ImportOptions) -> Provenance:
    """What text states, else what options say, else the defaults. Text of others, or damaged, states nothing."""
    mine = Provenance(
        options.full_scale_m_s2 or DEFAULT_FULL_SCALE_M_S2, options.range_hz or DEFAULT_RANGE_HZ, False, {}
    )
    try:
        record = json.loads(text) if isinstance(text, str) else {}
        low, high = (float(each) for each in record["range_hz"])
        scale = float(record["full_scale"])
        facts = {str(name): str(value) for name, value in record["provenance"].items()}
        sound = (
            record["units"] == UNITS and MIN_FULL_SCALE_M_S2 <= scale <= MAX_FULL_SCALE_M_S2 and 0.0 < low < high <= 1e5
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        return mine
    return replace(mine, full_scale_m_s2=scale, range_hz=(low, high), stated=True, provenance=facts) if sound else mine


def make_rendered_provenance(
    origin: Provenance, name: str, ignored: tuple[str, ...] = (), assumed: tuple[str, ...] = ()
) -> dict[str, str]:
    """Provenance of what was rendered from the envelopes in the file called name. ignored, assumed: what was not
    understood in it, and what it leaves open. Those of the file before it, in origin, speak of that file alone."""
    low, high = origin.range_hz
    said = "stated in the file" if origin.stated else "the file states none"
    named = {"ignored": "; ".join(ignored), "assumed": "; ".join(assumed)}
    return {
        **{key: value for key, value in origin.provenance.items() if key not in named},
        "source": name,
        "carrier": CARRIER_DESCRIPTION,
        "scale": f"1 = {origin.full_scale_m_s2:g} m/s², 0 … 1 = {low:g} … {high:g} Hz ({said})",
        **{key: value for key, value in named.items() if value},
    }


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
