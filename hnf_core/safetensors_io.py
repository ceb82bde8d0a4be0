"""Reading and writing of safetensors files, with checks of weights: file size, format, shapes, finite numbers."""

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
    """Serialise arrays and metadata as a complete safetensors file; equal content gives equal bytes."""
    from safetensors.numpy import save

    # With empty metadata and no tensors, the library writes a header that is no JSON.
    return _sort_header(save(dict(tensors), metadata=dict(metadata) if metadata else None))


def load_tensors(data: bytes) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Return the arrays (read-only) and the metadata of a safetensors file's bytes.

    Raises ValueError if the bytes are damaged, of another format, or of a number type that numpy does not have.
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
    """Return the first bytes of a safetensors file: the header's length, and the header as sorted JSON."""
    text = json.dumps(header, sort_keys=True, separators=separators).encode("utf-8")
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def split_header(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Split a safetensors file into its header, parsed, and the bytes of its arrays.

    Raises ValueError if the file is cut short or its header is no JSON object.
    """
    size = int.from_bytes(data[:8], "little")
    if len(data) < 8 or size > len(data) - 8:
        raise ValueError("it ends early")
    header = json.loads(data[8 : 8 + size].decode("utf-8"))
    if not isinstance(header, dict):
        raise ValueError("its header is no JSON object")
    return header, data[8 + size :]


def _sort_header(data: bytes) -> bytes:
    # The library writes metadata in random order; sorted, equal content gives equal bytes.
    header, body = split_header(data)
    return pack_header(header, (",", ":")) + body


T = TypeVar("T")

MAX_FILE_BYTES = 1 << 30
"""Largest accepted file, ten times the largest network read here, a ResNet-50 [bytes]."""


@dataclass(frozen=True)
class WeightsKind:
    """One kind of weights file, such as an encoder's, with the texts of its error messages.

    Attributes
    ----------
    name : str
        Its name in "cannot read …".
    format : str
        Required value of ``metadata["format"]``.
    wrong_format : str
        Message for a file of another format.
    remedy : str
        How to get a good file, for the error message.
    """

    name: str
    format: str
    wrong_format: str
    remedy: str


@dataclass(frozen=True)
class WeightsFile:
    """Content of a weights file, not yet checked.

    Attributes
    ----------
    where : str
        Path of the file, for error messages.
    kind : WeightsKind
        Kind of weights that was read.
    tensors : mapping of str to ndarray
        Arrays as stored.
    metadata : mapping of str to str
        Metadata as stored.
    content_id : str
        Hash of the file's bytes.
    """

    where: str
    kind: WeightsKind
    tensors: Mapping[str, NDArray[Any]]
    metadata: Mapping[str, str]
    content_id: str

    def make_error(self, what: str) -> WeightsError:
        """Return the exception to raise if the file cannot be used because of `what`."""
        return WeightsError(what, where=self.where, remedy=self.kind.remedy)

    def parse_metadata(self, parse: Callable[[Mapping[str, str]], T]) -> T:
        """Return ``parse(metadata)``; raise WeightsError if it fails on a missing, wrong or oversized value."""
        try:
            return parse(self.metadata)
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            raise self.make_error(f"unreadable description ({error}).") from error

    def check_parameters(
        self, shapes: Mapping[str, tuple[int, ...]], dtype: type[np.floating[Any]] = np.floating
    ) -> dict[str, NDArray[np.float32]]:
        """Return all tensors as float32, after checking names and shapes against an architecture.

        Parameters
        ----------
        shapes : mapping of str to tuple of int
            Names and shapes that the architecture has.
        dtype : type
            Number type that every stored tensor must be of.

        Returns
        -------
        dict of str to ndarray of float32
            The parameters by name.

        Raises
        ------
        WeightsError
            If names or shapes differ, a tensor is of another type, or a number is not finite in float32.
        """
        stored = {name: tuple(value.shape) for name, value in self.tensors.items()}
        wrong = sorted(set(stored.items()) ^ set(shapes.items()))
        if wrong:
            raise self.make_error(f"parameters do not fit the architecture: {wrong[:3]}.")
        parameters = {}
        for name, value in self.tensors.items():
            if not np.issubdtype(value.dtype, dtype):
                raise self.make_error(f"{name} is {value.dtype}, not {dtype.__name__}.")
            with np.errstate(over="ignore"):
                parameters[name] = value.astype(np.float32)
            if not np.isfinite(parameters[name]).all():
                raise self.make_error(f"{name} is not all finite.")
        return parameters


def read_weights(path: Path, kind: WeightsKind) -> WeightsFile:
    """Read a file of weights, and check its size and format.

    Raises FileError if there is no file, WeightsError if it is damaged, too large, or of another format.
    """
    return parse_weights(read_weights_bytes(path, kind.name, "Check the path."), kind, str(path))


def parse_weights(data: bytes, kind: WeightsKind, where: str) -> WeightsFile:
    """Parse the bytes of a weights file, and check its format.

    Raises WeightsError if they are damaged or of another format.
    """
    try:
        tensors, metadata = load_tensors(data)
    except ValueError as error:
        raise WeightsError(f"{error}.", where=where, remedy="Get the file again.") from error
    file = WeightsFile(where, kind, tensors, metadata, content_hash(data))
    if metadata.get("format") != kind.format:
        stated = metadata.get("format", "no format")
        raise file.make_error(f"{kind.wrong_format} ({stated}, not {kind.format}).")
    return file


def read_weights_bytes(path: Path, name: str, remedy: str) -> bytes:
    """Read the bytes of a weights file.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        Its name in "cannot read …".
    remedy : str
        Remedy in the error message.

    Raises
    ------
    FileError
        If the file cannot be read.
    WeightsError
        If it is larger than `MAX_FILE_BYTES`; nothing is read then.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise WeightsError(f"larger than any weights ({MAX_FILE_BYTES >> 20} MiB).", where=str(path), remedy=remedy)
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot read {name} ({error.strerror}).", where=str(path), remedy=remedy) from error
