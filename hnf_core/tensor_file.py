"""Arrays by name ↔ the bytes of a safetensors file: data alone, nothing that runs when it is read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray


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
