"""Dataclasses as JSON and back, strictly: a missing or unknown field, a wrong type, NaN or infinity is an error.

Fields are str, int, float, bool, tuples of one type, dataclasses, and any of these or None. msgspec would do the same
in C, but costs 42 ms of import and 225 KB in the add-on's zip, for messages that take microseconds.
"""

from __future__ import annotations

import json
import math
from dataclasses import MISSING, asdict, fields, is_dataclass
from functools import cache
from types import UnionType
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

Record = TypeVar("Record")


def encode_json(record: Any, **extra: Any) -> str:
    """Encode a dataclass, preceded by the values `extra`, as one line of JSON; raise ValueError for NaN or infinity."""
    return json.dumps({**extra, **asdict(record)}, separators=(",", ":"), allow_nan=False)


def load_json(text: str) -> Any:
    """Load JSON, but refuse NaN and infinity, which json.loads accepts; raise ValueError or RecursionError."""
    return json.loads(text, parse_constant=_reject_constant)


def parse_record(kind: type[Record], values: Any, *, complete: bool = False) -> Record:
    """Build a dataclass from the values of a JSON object.

    Parameters
    ----------
    kind
        The dataclass.
    values
        Dict of its fields.
    complete
        Require the fields with a default, too: for text that `encode_json` wrote, which has them all.

    Returns
    -------
    Record
        Instance of `kind`.

    Raises
    ------
    ValueError
        If a field is missing, unknown or of another type, or a number is not finite; the message names it.
    """
    if not isinstance(values, dict):
        raise ValueError(f"{kind.__name__} is no object")
    types, required = _find_field_types(cast(Any, kind))
    if unknown := values.keys() - types.keys():
        raise ValueError(f"{kind.__name__} has no field '{min(unknown)}'")
    if missing := (types.keys() if complete else required) - values.keys():
        raise ValueError(f"{kind.__name__} needs '{min(missing)}'")
    fields_by_name = {
        name: _parse_value(types[name], value, f"{kind.__name__}.{name}", complete) for name, value in values.items()
    }
    return kind(**fields_by_name)


@cache
def _find_field_types(kind: Any) -> tuple[dict[str, Any], frozenset[str]]:
    """Return the type of each field of a dataclass by name, and the names of the fields without default."""
    required = frozenset(field.name for field in fields(kind) if field.default is MISSING)
    return get_type_hints(kind), required


def _parse_value(kind: Any, value: Any, name: str, complete: bool) -> Any:
    if get_origin(kind) is UnionType:
        return None if value is None else _parse_value(get_args(kind)[0], value, name, complete)
    if get_origin(kind) is tuple and isinstance(value, list):
        return tuple(_parse_value(get_args(kind)[0], item, name, complete) for item in value)
    if isinstance(value, dict) and isinstance(kind, type) and is_dataclass(kind):
        return parse_record(kind, value, complete=complete)
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ValueError(f"{name} is no {getattr(kind, '__name__', 'list')}")
    if kind is float and not math.isfinite(value):
        raise ValueError(f"{name} is not finite")
    return value


def _reject_constant(constant: str) -> float:
    raise ValueError(f"{constant} is no number")
