"""Store the provenance and scale of a signal: as one line of text in a format's free field, and in a sidecar file.

Provenance are text facts such as stroke, material and seed. The sidecar FILE.json of an exported FILE states what its
numbers stand for, where the signal comes from, and the hash of the bytes that it describes.
"""

from __future__ import annotations

import contextlib
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import FileError
from ..files import escape_surrogates, hash_file
from ..json_io import read_json, write_json
from ..signal import Signal
from .envelope import CARRIER_DESCRIPTION, Envelope, render_envelope
from .options import (
    DEFAULT_FULL_SCALE_M_S2,
    DEFAULT_RANGE_HZ,
    MAX_FULL_SCALE_M_S2,
    MIN_FULL_SCALE_M_S2,
    ExportOptions,
    ImportOptions,
)
from .wav import UNITS, read_wav_channels

SOFTWARE = f"Haptic Neural Fields {__version__}"
_RECORD_SCHEMA = 1


def make_provenance_record(signal: Signal, options: ExportOptions | None) -> dict[str, Any]:
    """Return schema, units, scale, seed, rate and provenance of a signal as a JSON object.

    With `options` None the format stores m/s² directly; otherwise full scale and range are included.
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
    """Return units, scale, seed, rate and provenance of a signal as one line of JSON (see `make_provenance_record`)."""
    return escape_surrogates(json.dumps(make_provenance_record(signal, options), ensure_ascii=False))


@dataclass(frozen=True)
class Provenance:
    """Scale and origin of a signal, as the file states them or as options assume.

    Attributes
    ----------
    full_scale_m_s2 : float
        Acceleration [m/s²] that 1 stands for.
    range_hz : (float, float)
        Frequencies [Hz] that 0 and 1 stand for.
    stated : bool
        Whether the file stated both.
    provenance : dict of str
        The provenance in the file.
    """

    full_scale_m_s2: float
    range_hz: tuple[float, float]
    stated: bool
    provenance: dict[str, str]


def parse_provenance(text: object, options: ImportOptions) -> Provenance:
    """Return the scale and provenance that a format's free `text` states, else those of `options` or the defaults.

    A text of another program, or a damaged one, states nothing.
    """
    fallback = Provenance(
        options.full_scale_m_s2 or DEFAULT_FULL_SCALE_M_S2, options.range_hz or DEFAULT_RANGE_HZ, False, {}
    )
    try:
        record = json.loads(text) if isinstance(text, str) else {}
        low, high = (float(limit) for limit in record["range_hz"])
        scale = float(record["full_scale"])
        facts = {str(name): str(value) for name, value in record["provenance"].items()}
        is_valid = (
            record["units"] == UNITS and MIN_FULL_SCALE_M_S2 <= scale <= MAX_FULL_SCALE_M_S2 and 0.0 < low < high <= 1e5
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        return fallback
    return (
        replace(fallback, full_scale_m_s2=scale, range_hz=(low, high), stated=True, provenance=facts)
        if is_valid
        else fallback
    )


def make_rendered_provenance(
    origin: Provenance, name: str, ignored: tuple[str, ...] = (), assumed: tuple[str, ...] = ()
) -> dict[str, str]:
    """Return the provenance of a signal rendered from the envelopes in the file `name`.

    Parameters
    ----------
    origin : Provenance
        Scale and provenance of the file. Its own "ignored" and "assumed" concern an earlier file and are dropped.
    name : str
        Name of the file.
    ignored : tuple of str
        Parts of the file that were not understood.
    assumed : tuple of str
        Values that the file leaves undefined.

    Returns
    -------
    dict of str
        The provenance.
    """
    low, high = origin.range_hz
    basis = "stated in the file" if origin.stated else "the file states none"
    notes = {"ignored": "; ".join(ignored), "assumed": "; ".join(assumed)}
    return {
        **{key: value for key, value in origin.provenance.items() if key not in notes},
        "source": name,
        "carrier": CARRIER_DESCRIPTION,
        "scale": f"1 = {origin.full_scale_m_s2:g} m/s², 0 … 1 = {low:g} … {high:g} Hz ({basis})",
        **{key: value for key, value in notes.items() if value},
    }


@dataclass(frozen=True)
class EnvelopeFile:
    """Content of a file that holds strength and frequency over time.

    Attributes
    ----------
    envelope : Envelope
        Envelope in m/s² and Hz.
    origin : Provenance
        Its scale and origin.
    facts : dict of str
        Provenance of what is rendered from it.
    """

    envelope: Envelope
    origin: Provenance
    facts: dict[str, str]

    def render(self, rate_hz: float, seed: int, where: str) -> Signal:
        """Return the envelope as a signal; see `render_envelope`."""
        return Signal(render_envelope(self.envelope, rate_hz, seed, where=where), rate_hz, seed, self.facts)


SIDECAR_SCHEMA = 1


def get_sidecar_path(path: Path) -> Path:
    """Return the path of the sidecar of an exported file: its name with ".json" appended."""
    return path.with_name(path.name + ".json")


def is_sidecar(path: Path) -> bool:
    """Return whether a file is a sidecar of any exported file."""
    try:
        record = read_json(path)
    except FileError:
        return False
    return "schema" in record and all(isinstance(record.get(name), str) for name in ("file", "hash"))


@dataclass(frozen=True)
class SourceStroke:
    """Stroke that an exported file was made from, and its .blend file ("" if unknown)."""

    stroke: str
    blend: str


def write_sidecar(
    path: Path, format_name: str, signal: Signal, options: ExportOptions | None, loss: dict[str, Any], blend: str = ""
) -> None:
    """Write the sidecar of an exported file.

    Parameters
    ----------
    path : Path
        The exported file.
    format_name : str
        Name of its format.
    signal : Signal
        The exported signal.
    options : ExportOptions or None
        As for `make_provenance_record`.
    loss : dict
        The loss report as JSON.
    blend : str
        Name of the .blend file with the signal's stroke.

    Raises
    ------
    FileError
        If the sidecar cannot be written.
    """
    record = {
        **_describe_file(path, format_name, blend),
        "duration_s": signal.duration_s,
        **{name: value for name, value in make_provenance_record(signal, options).items() if name != "schema"},
        "loss": loss,
    }
    write_json(get_sidecar_path(path), record)


def write_source_sidecar(path: Path, format_name: str, source: SourceStroke) -> None:
    """Write the sidecar of a file that holds no signal: its bytes, and the stroke that it was made from.

    Raises FileError if it cannot be written.
    """
    record = {**_describe_file(path, format_name, source.blend), "provenance": {"stroke": source.stroke}}
    write_json(get_sidecar_path(path), record)


def _describe_file(path: Path, format_name: str, blend: str) -> dict[str, Any]:
    return {
        "schema": SIDECAR_SCHEMA,
        "file": path.name,
        "hash": hash_file(path),
        "format": format_name,
        "software": SOFTWARE,
        **({"blend": blend} if blend else {}),
    }


def read_sidecar_provenance(path: Path) -> tuple[int, dict[str, str]] | None:
    """Return seed and provenance from an exported file's sidecar; None without one, or if it describes other bytes."""
    try:
        record = _read_matching_sidecar(path)
        return int(record["seed"]), {str(name): str(value) for name, value in record["provenance"].items()}
    except (FileError, OSError, KeyError, TypeError, ValueError, AttributeError):
        return None


def read_sidecar_loss(path: Path) -> dict[str, Any] | None:
    """Return what the export to `path` lost, as `ConversionLoss.to_json` wrote it into the sidecar.

    Returns None if there is no sidecar, or it is damaged or describes other bytes.
    """
    try:
        loss = _read_matching_sidecar(path)["loss"]
        is_valid = isinstance(loss["exact"], bool) and all(isinstance(item, str) for item in loss["dropped"])
        levels = [float(loss[state][key]) for state in ("before", "after") for key in ("rms", "peak")]
        return dict(loss) if is_valid and all(0.0 <= item < math.inf for item in levels) else None
    except (FileError, OSError, KeyError, TypeError, ValueError, OverflowError):
        return None


def _read_matching_sidecar(path: Path) -> dict[str, Any]:
    """Return the sidecar of `path` if the hash in it is that of the file's bytes.

    Raises ValueError if it is not, FileError if there is no sidecar, and KeyError or OSError.
    """
    record = read_json(get_sidecar_path(path))
    if record["hash"] != hash_file(path):
        raise ValueError("it speaks of other bytes")
    return record


def read_source_stroke(path: Path) -> SourceStroke | None:
    """Return the stroke that `path` was made from, by its sidecar or a WAV's own comment; None if unknown.

    A WAV that names another stroke than its sidecar has replaced the file that the sidecar describes.
    """
    source = None
    with contextlib.suppress(FileError, KeyError, TypeError):
        record = read_json(get_sidecar_path(path))
        source = SourceStroke(str(record["provenance"]["stroke"]), str(record.get("blend", "")))
    if path.suffix.lower() == ".wav":
        with contextlib.suppress(FileError):
            stroke = read_wav_channels(path)[0].provenance.get("stroke")
            if stroke is not None and (source is None or source.stroke != stroke):
                return SourceStroke(stroke, "")
    return source
