"""Frozen dataclasses ↔ JSON, by their annotations: what is read back is of the declared types, or refused."""

from __future__ import annotations

import json
from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from hnf_core.errors import FileError

Record = TypeVar("Record")


def to_json(record: Any) -> str:
    """One line of JSON."""
    return json.dumps(asdict(record), ensure_ascii=True, separators=(",", ":"))


def from_json(kind: type[Record], text: str, *, where: str = "record") -> Record:
    """What to_text wrote of a kind. Raises FileError where the text is anything else."""
    try:
        made: Record = _convert_value(kind, json.loads(text))
        return made
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise FileError(f"it is no {kind.__name__} ({error}).", where=where, remedy="Bake again.") from error


def _convert_value(kind: Any, value: Any) -> Any:
    if is_dataclass(kind) and isinstance(kind, type):
        hints = get_type_hints(kind)
        names = {field.name for field in fields(kind)}
        if not isinstance(value, dict) or set(value) != names:
            raise ValueError(f"{kind.__name__} has the fields {', '.join(sorted(names))}")
        return kind(**{name: _convert_value(hints[name], value[name]) for name in names})
    if get_origin(kind) is tuple:
        if not isinstance(value, list):
            raise ValueError(f"{value!r} is no list")
        return tuple(_convert_value(get_args(kind)[0], each) for each in value)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise ValueError(f"{value!r} is no {kind.__name__}")
    return value
