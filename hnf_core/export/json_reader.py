"""Read JSON files of unknown origin: values of the expected type, or one FileError that names the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import FileError
from ..files import escape_surrogates, refuse_pointer, write_bytes

MAX_JSON_BYTES = 32 * 2**20
"""Largest file [bytes]: a quarter of an hour of control points every 5 ms; a stroke takes kilobytes."""
_READ_BLOCK_BYTES = 2**20
REEXPORT_REMEDY = "Export or download it again."


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
        value = json.loads(data.decode("utf-8-sig"), parse_constant=_refuse_constant)
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


def _refuse_constant(constant: str) -> float:
    raise ValueError(f"{constant} is no number")
