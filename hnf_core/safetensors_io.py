"""Arrays by name ↔ the bytes of a safetensors file: data alone, nothing that runs when it is read.

Weights from a file, checked on the way in: its size, its format, and that every number can be used.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import FileError, WeightsError
from .files import content_hash


def dump_tensors(tensors: Mapping[str, NDArray[Any]], metadata: Mapping[str, str] | None = None) -> bytes:
    """A whole file. Equal content gives equal bytes."""
    from safetensors.numpy import save

    # The library's header is no JSON where it is given empty metadata beside no tensors.
    return _sort_header(save(dict(tensors), metadata=dict(metadata) if metadata else None))


def load_tensors(data: bytes) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Arrays (not to be written into) and metadata of a whole file.

    Raises ValueError where it is damaged, something else, or holds numbers that numpy does not know.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        tensors = load(data)
        header, _ = split_header(data)
        return tensors, dict(header.get("__metadata__", {}))
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"damaged or not a safetensors file ({error})") from error


def pack_header(header: Mapping[str, Any], separators: tuple[str, str] = (", ", ": ")) -> bytes:
    """What a file begins with: the length of its header, and the header as JSON, sorted. Its arrays follow."""
    text = json.dumps(header, sort_keys=True, separators=separators).encode("utf-8")
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def split_header(data: bytes) -> tuple[dict[str, Any], bytes]:
    """A file's header and its arrays' bytes. Raises ValueError where it ends early or the header is no JSON object."""
    size = int.from_bytes(data[:8], "little")
    if len(data) < 8 or size > len(data) - 8:
        raise ValueError("it ends early")
    header = json.loads(data[8 : 8 + size].decode("utf-8"))
    if not isinstance(header, dict):
        raise ValueError("its header is no JSON object")
    return header, data[8 + size :]


def _sort_header(data: bytes) -> bytes:
    # The library writes metadata in random order.
    header, body = split_header(data)
    return pack_header(header, (",", ":")) + body


T = TypeVar("T")

MAX_FILE_BYTES = 1 << 30
"""Bytes of a file: ten times the largest network that is read here, a ResNet-50."""


@dataclass(frozen=True)
class WeightsKind:
    """One sort of weights. name: as in "cannot read the encoder". format: what metadata["format"] must say. foreign:
    what is said of a file of another format. again: how a good file is come by."""

    name: str
    format: str
    wrong_format: str
    remedy: str


@dataclass(frozen=True)
class WeightsFile:
    """where: it lies, for messages. tensors: as they are stored, unchecked. metadata: all text. content_id: of the
    file's bytes."""

    where: str
    kind: WeightsKind
    tensors: Mapping[str, NDArray[Any]]
    metadata: Mapping[str, str]
    content_id: str

    def make_error(self, what: str) -> WeightsError:
        """To raise where the file cannot be used."""
        return WeightsError(what, where=self.where, remedy=self.kind.remedy)

    def parse_metadata(self, parse: Callable[[Mapping[str, str]], T]) -> T:
        """What read makes of the metadata. Raises WeightsError where it raises for what is not as it should
        be: KeyError, TypeError, ValueError, or a number or a nesting beyond all measure."""
        try:
            return parse(self.metadata)
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            raise self.make_error(f"unreadable description ({error}).") from error

    def check_parameters(
        self, shapes: Mapping[str, tuple[int, ...]], dtype: type[np.floating[Any]] = np.floating
    ) -> dict[str, NDArray[np.float32]]:
        """All tensors, in float32. Raises WeightsError unless names and shapes are exactly these, and all numbers of
        type stored and finite in float32."""
        found = {name: tuple(value.shape) for name, value in self.tensors.items()}
        wrong = sorted(set(found.items()) ^ set(shapes.items()))
        if wrong:
            raise self.make_error(f"parameters do not fit the architecture: {wrong[:3]}.")
        out = {}
        for name, value in self.tensors.items():
            if not np.issubdtype(value.dtype, dtype):
                raise self.make_error(f"{name} is {value.dtype}, not {dtype.__name__}.")
            with np.errstate(over="ignore"):
                out[name] = value.astype(np.float32)
            if not np.isfinite(out[name]).all():
                raise self.make_error(f"{name} is not all finite.")
        return out


def read_weights(path: Path, kind: WeightsKind) -> WeightsFile:
    """Raises FileError where there is no file, WeightsError where it is damaged, too large, or of another format."""
    return parse_weights(read_weights_bytes(path, kind.name, "Check the path."), kind, str(path))


def parse_weights(data: bytes, kind: WeightsKind, where: str) -> WeightsFile:
    """The same of a file's bytes. Raises WeightsError where they are damaged or of another format."""
    try:
        tensors, metadata = load_tensors(data)
    except ValueError as error:
        raise WeightsError(f"{error}.", where=where, remedy="Get the file again.") from error
    file = WeightsFile(where, kind, tensors, metadata, content_hash(data))
    if metadata.get("format") != kind.format:
        found = metadata.get("format", "no format")
        raise file.make_error(f"{kind.wrong_format} ({found}, not {kind.format}).")
    return file


def read_weights_bytes(path: Path, name: str, remedy: str) -> bytes:
    """A file of weights whole. name: what it is, for the message. Raises FileError where it cannot be read,
    WeightsError where it is larger than LARGEST: of that nothing is read."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise WeightsError(f"larger than any weights ({MAX_FILE_BYTES >> 20} MiB).", where=str(path), remedy=remedy)
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot read {name} ({error.strerror}).", where=str(path), remedy=remedy) from error
