"""Where a signal comes from and what its numbers stand for, as one line of text that formats keep in a free field."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

from .. import __version__
from ..signal import Signal
from .options import (
    DEFAULT_FULL_SCALE_M_S2,
    DEFAULT_RANGE_HZ,
    MAX_FULL_SCALE_M_S2,
    MIN_FULL_SCALE_M_S2,
    ExportOptions,
    ImportOptions,
)
from .tone import CARRIER_DESCRIPTION

SOFTWARE = f"Haptic Neural Fields {__version__}"
UNITS = "m/s^2"
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
