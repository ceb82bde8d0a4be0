"""Read and write actuator profiles as JSON files.

A file holds `{"schema": 1, "name": …, "title": …, "source": …, "range_hz": [low, high], "peak_m_s2": …, "sustained": …,
"thermal_s": …, "response": …}`. A figure that is null or absent is unknown. `response` holds what `hnf actuators
measure` writes: `{"frequency_hz": […], "gain_db": […], "phase_rad": […], "coherence": […], "delay_s": …}`.
"""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError, UsageError
from ..files import write_bytes
from .measure.frequency_response import Float, FrequencyResponse
from .profile import ActuatorProfile, get_profile

SCHEMA = 1
"""Version of the file's layout."""

MAX_BYTES = 4_000_000
"""Largest file that is read [bytes]."""

DECIMALS = 5
"""Decimal places of a written frequency response."""

_COLUMNS = ("frequency_hz", "gain_db", "phase_rad", "coherence")


def load_profile(name_or_path: str) -> ActuatorProfile:
    """Return a built-in profile by name, or read one from a file.

    Parameters
    ----------
    name_or_path : str
        A key of `PROFILES`, or a path that ends in ".json".

    Raises
    ------
    UsageError
        If there is no built-in profile of that name.
    FileError
        If the file cannot be read or holds no valid profile.
    """
    return read_profile(Path(name_or_path)) if name_or_path.lower().endswith(".json") else get_profile(name_or_path)


def write_profile(path: Path, profile: ActuatorProfile) -> None:
    """Write a profile for `read_profile`, its response rounded to `DECIMALS` places.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    record = {"schema": SCHEMA} | asdict(profile)
    if profile.response is not None:
        columns = {name: np.round(getattr(profile.response, name), DECIMALS).tolist() for name in _COLUMNS}
        record["response"] = columns | {"delay_s": profile.response.delay_s}
    write_bytes(path, (json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode("utf-8"))


def read_profile(path: Path) -> ActuatorProfile:
    """Read a profile from a JSON file.

    Raises
    ------
    FileError
        If the file is missing or too large, or holds no profile of a possible device.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"it has more than {MAX_BYTES // 1_000_000} MB")
        record = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(record, dict) or record.pop("schema", None) != SCHEMA:
            raise ValueError(f'no object with "schema": {SCHEMA}')
        unknown = set(record) - {field.name for field in fields(ActuatorProfile)}
        if unknown:
            raise ValueError(f"unknown: {', '.join(sorted(unknown))}")
        profile = ActuatorProfile(
            _read_text(record, "name"),
            _read_text(record, "title"),
            _read_text(record, "source"),
            range_hz=_parse_range(record.get("range_hz")),
            peak_m_s2=_read_positive(record, "peak_m_s2"),
            sustained=_read_positive(record, "sustained"),
            thermal_s=_read_positive(record, "thermal_s"),
            response=_parse_response(record.get("response")),
        )
        _ = profile.limits
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the file's path."
        ) from error
    except (ValueError, RecursionError, UsageError) as error:
        raise FileError(
            f"is no actuator's profile ({error}).", where=str(path), remedy="See docs/streaming.md, Profiles."
        ) from error
    return profile


def _read_text(record: dict[str, Any], name: str) -> str:
    value = record.get(name)
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f"{name} is no text")
    return value


def _read_positive(record: dict[str, Any], name: str) -> float | None:
    value = record.get(name)
    return None if value is None else _check_number(value, name, 1e-9, 1e9)


def _check_number(value: Any, name: str, low: float, high: float) -> float:
    if type(value) not in (int, float) or not low <= value <= high:
        raise ValueError(f"{name} is no number from {low:g} to {high:g}")
    return float(value)


def _parse_range(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError("range_hz is no [low, high]")
    low, high = (_check_number(edge, "range_hz", 1e-9, 1e9) for edge in value)
    if low >= high:
        raise ValueError("range_hz is no [low, high]")
    return low, high


def _parse_response(value: Any) -> FrequencyResponse | None:
    if value is None:
        return None
    if not isinstance(value, dict) or set(value) != {*_COLUMNS, "delay_s"}:
        raise ValueError(f"a response has {', '.join(_COLUMNS)} and delay_s")
    frequency, gain, phase, coherence = (_parse_column(value[name], name) for name in _COLUMNS)
    return FrequencyResponse(frequency, gain, phase, coherence, _check_number(value["delay_s"], "delay_s", -1e3, 1e3))


def _parse_column(values: Any, name: str) -> Float:
    if not isinstance(values, list):
        raise ValueError(f"{name} is no list of numbers")
    return np.array([_check_number(value, name, -1e9, 1e9) for value in values], dtype=np.float64)
