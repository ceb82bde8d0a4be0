"""The encoder's weights on disk: safetensors in half precision with JSON metadata, checked on the way in."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import MaterialError
from ...files import write_bytes
from ...tensor_file import packed
from ...weights_file import Kind, read_weights
from ..token import ALEXNET_ID, ENCODER_ID
from .network import AlexNet, Design

DEFAULT_ENCODER = Path(__file__).parents[2] / "data" / "encoder.safetensors"
FORMAT = "hnf-encoder-1"
_KIND = Kind(
    "the encoder", FORMAT, "this is no encoder", "Train it again with `hnf train encoder`, or choose another file."
)
PIXELS = range(31, 513)


def save_encoder(path: Path, network: AlexNet) -> None:
    """Write in half precision, atomically; network.metadata (training data, seed, metrics, licence, all text) is
    kept; format, encoder and architecture are added. Raises FileError."""
    tensors = {name: np.ascontiguousarray(value, dtype=np.float16) for name, value in network.tensors.items()}
    metadata = {
        **network.metadata,
        "format": FORMAT,
        "encoder": ALEXNET_ID,
        "architecture": json.dumps(dataclasses.asdict(network.design), sort_keys=True),
    }
    write_bytes(path, packed(tensors, metadata))


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
    file = read_weights(path, _KIND)
    made = file.metadata.get("encoder")
    if made != ALEXNET_ID:
        raise file.refused(f"{_KIND.foreign} ({made}, not {ALEXNET_ID}).")
    design = file.described(lambda metadata: _design(json.loads(metadata["architecture"])))
    return AlexNet(design, file.parameters(design.shapes()), file.metadata, file.content_id)


def _design(record: Mapping[str, Any]) -> Design:
    mean, deviation = (tuple(float(value) for value in record[name]) for name in ("mean", "deviation"))
    design = Design(int(record["pixels"]), int(record["hidden"]), mean, deviation)  # type: ignore[arg-type]
    if len(mean) != 3 or len(deviation) != 3 or not all(0.0 < value < float("inf") for value in deviation):
        raise ValueError("three means and three positive deviations are needed")
    if design.pixels not in PIXELS or not 1 <= design.hidden <= 4096:
        raise ValueError(f"{design.pixels} pixels and {design.hidden} units are out of range")
    return design
