"""Provenance of an exported signal: its source, unit and scale, as JSON text inside a file and as a sidecar.

`encode_provenance` makes the line of text that formats keep in a free field. The sidecar FILE.json next to an exported
FILE holds the same record, the loss of the export, and a hash of the file's bytes.
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
    """Return the record stored with the data: schema, units, scale, seed, rate and provenance.

    `options` give full scale and range; None means that the numbers are accelerations in `UNITS`.
    """
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
    """Scale and source of a file's values.

    Attributes
    ----------
    full_scale_m_s2 : float
        Acceleration [m/s²] of the value 1.
    range_hz : tuple of float
        Frequencies [Hz] of the values 0 and 1.
    stated : bool
        The file states this scale.
    provenance : dict
        The file's own provenance.
    """

    full_scale_m_s2: float
    range_hz: tuple[float, float]
    stated: bool
    provenance: dict[str, str]


def parse_provenance(text: object, options: ImportOptions) -> Provenance:
    """Parse a provenance text; without a valid one, use the options or the defaults.

    Damaged text and text of other programs count as no statement.
    """
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
    """Return the provenance of a signal rendered from the envelopes in the file called `name`.

    `ignored` lists entries that were not understood, `assumed` lists values that the file leaves open. Entries of
    these two names in `origin` are dropped, since they describe the file before it.
    """
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
    """Return True if a file is a sidecar."""
    try:
        record = read_json(path)
    except FileError:
        return False
    return "schema" in record and all(isinstance(record.get(name), str) for name in ("file", "hash"))


@dataclass(frozen=True)
class SourceStroke:
    """Stroke that an exported file was made from, and its .blend file; "" if not known."""

    stroke: str
    blend: str


def write_sidecar(
    path: Path, format_name: str, signal: Signal, options: ExportOptions | None, loss: dict[str, Any], blend: str = ""
) -> None:
    """Write the sidecar of an exported file.

    Parameters
    ----------
    path : Path
        Exported file.
    format_name : str
        Name of its format.
    signal : Signal
        Exported signal.
    options : ExportOptions or None
        Scale, as in `make_provenance_record`.
    loss : dict
        `ConversionLoss.to_json` of the export.
    blend : str
        Name of the .blend file with the stroke; "" if not known.

    Raises
    ------
    FileError
        If the sidecar cannot be written.
    """
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
    """Return seed and provenance from the sidecar; None if it is missing or its hash differs."""
    try:
        record = _read_matching_sidecar(path)
        return int(record["seed"]), {str(name): str(value) for name, value in record["provenance"].items()}
    except (FileError, OSError, KeyError, TypeError, ValueError, AttributeError):
        return None


def read_sidecar_loss(path: Path) -> dict[str, Any] | None:
    """Return the loss of an export from its sidecar, as `ConversionLoss.to_json` wrote it.

    None if the sidecar is missing or damaged, or its hash differs.
    """
    try:
        loss = _read_matching_sidecar(path)["loss"]
        sound = isinstance(loss["exact"], bool) and all(isinstance(each, str) for each in loss["dropped"])
        levels = [float(loss[when][what]) for when in ("before", "after") for what in ("rms", "peak")]
        return dict(loss) if sound and all(0.0 <= each < math.inf for each in levels) else None
    except (FileError, OSError, KeyError, TypeError, ValueError, OverflowError):
        return None


def _read_matching_sidecar(path: Path) -> dict[str, Any]:
    """Return the sidecar of a file.

    Raises ValueError if its hash differs from the file's, FileError if it is missing, KeyError, OSError.
    """
    record = read_json(get_sidecar_path(path))
    if record["hash"] != content_hash(path.read_bytes()):
        raise ValueError("it speaks of other bytes")
    return record


def read_source_stroke(path: Path) -> SourceStroke | None:
    """Return the stroke that a file was made from; None if its sidecar is missing or names no stroke."""
    try:
        record = read_json(get_sidecar_path(path))
        return SourceStroke(str(record["provenance"]["stroke"]), str(record.get("blend", "")))
    except (FileError, KeyError, TypeError):
        return None
