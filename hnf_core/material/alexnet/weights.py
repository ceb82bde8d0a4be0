"""The encoder's weights on disk: safetensors in half precision with JSON metadata, checked on the way in."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileError, MaterialError, WeightsError
from ...files import content_hash, write_bytes
from ..token import ALEXNET_ID, ENCODER_ID
from .network import AlexNet, Design

DEFAULT_ENCODER = Path(__file__).parents[2] / "data" / "encoder.safetensors"
FORMAT = "hnf-encoder-1"
_AGAIN = "Train it again with `hnf train encoder`, or choose another file."
PIXELS = range(31, 513)


def save_encoder(path: Path, network: AlexNet) -> None:
    """Write in half precision, atomically; network.metadata (training data, seed, metrics, licence, all text) is
    kept; format, encoder and architecture are added. Raises FileError."""
    from safetensors.numpy import save

    tensors = {name: np.ascontiguousarray(value, dtype=np.float16) for name, value in network.tensors.items()}
    metadata = {
        **network.metadata,
        "format": FORMAT,
        "encoder": ALEXNET_ID,
        "architecture": json.dumps(dataclasses.asdict(network.design), sort_keys=True),
    }
    write_bytes(path, _canonical(save(tensors, metadata=metadata)))


def load_encoder(path: Path | str | None = None) -> AlexNet:
    """Read an encoder; without a path the project's own (read once), which the Blender extension leaves out.

    Raises MaterialError where the project's own is left out, FileError where there is no file, WeightsError where it is
    damaged, of another format, make or architecture, or not finite.
    """
    return _own(DEFAULT_ENCODER) if path is None else _read(Path(path))


@lru_cache(maxsize=1)
def _own(path: Path) -> AlexNet:
    if not path.is_file():
        raise MaterialError(
            f"the network of {ALEXNET_ID} is not part of the Blender extension.",
            remedy=f"Choose {ENCODER_ID}, or name a copy of hnf_core/data/{path.name} from the project's source.",
        )
    return _read(path)


def _read(path: Path) -> AlexNet:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileError(
            f"cannot read the encoder ({error.strerror}).", where=str(path), remedy="Check the path."
        ) from error
    try:
        tensors = load(data)
        metadata = dict(json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")]).get("__metadata__", {}))
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise WeightsError(
            f"damaged or not a safetensors file ({error}).", where=str(path), remedy="Get the file again."
        ) from error
    if metadata.get("format") != FORMAT or metadata.get("encoder") != ALEXNET_ID:
        found = metadata.get("encoder") or metadata.get("format") or "no format"
        raise WeightsError(f"this is no encoder ({found}, not {ALEXNET_ID}).", where=str(path), remedy=_AGAIN)
    try:
        design = _design(json.loads(metadata["architecture"]))
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(f"unreadable description ({error}).", where=str(path), remedy=_AGAIN) from error
    wrong = sorted(set(_shapes(tensors).items()) ^ set(design.shapes().items()))
    if wrong:
        raise WeightsError(f"parameters do not fit the architecture: {wrong[:3]}.", where=str(path), remedy=_AGAIN)
    if not all(np.issubdtype(each.dtype, np.floating) and np.isfinite(each).all() for each in tensors.values()):
        raise WeightsError("parameters are not all finite numbers.", where=str(path), remedy=_AGAIN)
    wide = {name: value.astype(np.float32) for name, value in tensors.items()}
    return AlexNet(design, wide, metadata, content_hash(data))


def _shapes(tensors: Mapping[str, NDArray[Any]]) -> dict[str, tuple[int, ...]]:
    return {name: tuple(value.shape) for name, value in tensors.items()}


def _design(record: Mapping[str, Any]) -> Design:
    mean, deviation = (tuple(float(value) for value in record[name]) for name in ("mean", "deviation"))
    design = Design(int(record["pixels"]), int(record["hidden"]), mean, deviation)  # type: ignore[arg-type]
    if len(mean) != 3 or len(deviation) != 3 or not all(0.0 < value < float("inf") for value in deviation):
        raise ValueError("three means and three positive deviations are needed")
    if design.pixels not in PIXELS or not 1 <= design.hidden <= 4096:
        raise ValueError(f"{design.pixels} pixels and {design.hidden} units are out of range")
    return design


def _canonical(data: bytes) -> bytes:
    """The file with its header sorted, so that equal encoders give equal bytes (see field.weights)."""
    size = int.from_bytes(data[:8], "little")
    header = json.dumps(json.loads(data[8 : 8 + size]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + data[8 + size :]
