"""JSON, strictly: dataclasses as text and back, and files of unknown origin, whose first invalid value is refused.

Fields of dataclasses are str, int, float, bool, tuples of one type, dataclasses, and any of these or None; a missing or
unknown field, a wrong type, NaN or infinity is an error. msgspec would do the same in C, but costs 42 ms of import and
225 KB in the add-on's zip, for messages that take microseconds. A file gives values of the expected type, or one
FileError that names it.
"""

from __future__ import annotations

import json
import math
from dataclasses import MISSING, asdict, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

from .errors import FileError
from .files import escape_surrogates, refuse_pointer, write_bytes

Record = TypeVar("Record")
MAX_JSON_BYTES = 32 * 2**20
"""Largest file [bytes]: a quarter of an hour of control points every 5 ms; a stroke takes kilobytes."""
_READ_BLOCK_BYTES = 2**20
REEXPORT_REMEDY = "Export or download it again."


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


def read_limited_bytes(path: Path, max_bytes: int) -> bytes:
    """Return a file's bytes. Raises FileError if it cannot be read or exceeds `max_bytes`."""
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise FileError(f"{size / 2**20:.0f} MB are too much.", where=str(path), remedy="Split it.")
        data = bytearray()
        with path.open("rb") as stream:
            # A device file reports size 0, so the bytes are counted as they come.
            while len(data) <= max_bytes and (piece := stream.read(_READ_BLOCK_BYTES)):
                data += piece
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the file's path."
        ) from error
    if len(data) > max_bytes:
        raise FileError(f"it has no end within {max_bytes / 2**20:.0f} MB.", where=str(path), remedy="Give a file.")
    return bytes(data)


def read_json(path: Path) -> dict[str, Any]:
    """Return the one JSON object that a file contains.

    Raises FileError if the file exceeds `MAX_JSON_BYTES`, is not UTF-8 or not JSON (NaN and Infinity are not), is
    nested too deeply for Python, or holds no object.
    """
    data = read_limited_bytes(path, MAX_JSON_BYTES)
    refuse_pointer(data, path)
    try:
        value = load_json(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise FileError("is no UTF-8 text.", where=str(path), remedy="Save it as UTF-8.") from error
    except (ValueError, RecursionError) as error:
        raise FileError(f"is no JSON ({error}).", where=str(path), remedy=REEXPORT_REMEDY) from error
    if not isinstance(value, dict):
        raise FileError("holds no JSON object.", where=str(path), remedy=REEXPORT_REMEDY)
    return value


def write_json(path: Path, record: dict[str, Any], *, indent: int | None = 1) -> None:
    """Write an object as JSON, atomically; equal objects give equal bytes.

    With `indent` None it is one line without blanks. Raises FileError if the text would be too large to be read again
    or cannot be written.
    """
    separators = (",", ":") if indent is None else None
    text = json.dumps(record, indent=indent, separators=separators, ensure_ascii=False, allow_nan=False)
    data = (escape_surrogates(text) + "\n").encode()
    if len(data) > MAX_JSON_BYTES:
        why = f"it would be {len(data) / 2**20:.0f} MB of text, and {MAX_JSON_BYTES / 2**20:.0f} are read again."
        raise FileError(why, where=str(path), remedy="Split the signal, or write WAV.")
    write_bytes(path, data)


class JsonReader:
    """Typed access to the values of one JSON file; the first invalid one raises FileError."""

    def __init__(self, path: Path) -> None:
        self._where = str(path)

    def make_error(self, why: str, remedy: str = REEXPORT_REMEDY) -> FileError:
        return FileError(f"{why}.", where=self._where, remedy=remedy)

    def get_object(self, owner: dict[str, Any], name: str) -> dict[str, Any]:
        """Return the value of key `name` of `owner`, which must be an object."""
        value = owner.get(name)
        if not isinstance(value, dict):
            raise self.make_error(f"'{name}' is missing" if value is None else f"'{name}' is no object")
        return value

    def get_array(self, owner: dict[str, Any], name: str) -> list[Any]:
        """Return the value of key `name` of `owner`, which must be an array."""
        value = owner.get(name)
        if not isinstance(value, list):
            raise self.make_error(f"'{name}' is missing" if value is None else f"'{name}' is no array")
        return value

    def get_number(self, owner: Any, name: str, low: float, high: float) -> float:
        """Return the value of key `name` of `owner`, which must be a number within low … high."""
        if not isinstance(owner, dict):
            raise self.make_error(f"where '{name}' should stand is no object")
        value = owner.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.make_error(f"'{name}' is missing" if value is None else f"'{name}' is no number")
        if not low <= value <= high:
            shown = f"{value:g}" if -1e300 < value < 1e300 else "beyond all measure"
            raise self.make_error(f"'{name}' is {shown}, and not within {low:g} … {high:g}")
        return float(value)


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
