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
from ...tensor_file import dump_tensors
from ...weights_file import WeightsKind, read_weights
from ..token import ALEXNET_ID, ENCODER_ID
from .network import AlexNet, AlexNetConfig

DEFAULT_ENCODER = Path(__file__).parents[2] / "data" / "encoder.safetensors"
ENCODER_FORMAT = "hnf-encoder-1"
_ENCODER_KIND = WeightsKind(
    "the encoder",
    ENCODER_FORMAT,
    "this is no encoder",
    "Train it again with `hnf train encoder`, or choose another file.",
)
SUPPORTED_PIXELS = range(31, 513)


def save_encoder(path: Path, network: AlexNet) -> None:
    """Write in half precision, atomically; network.metadata (training data, seed, metrics, licence, all text) is
    kept; format, encoder and architecture are added. Raises FileError."""
    tensors = {name: np.ascontiguousarray(value, dtype=np.float16) for name, value in network.tensors.items()}
    metadata = {
        **network.metadata,
        "format": ENCODER_FORMAT,
        "encoder": ALEXNET_ID,
        "architecture": json.dumps(dataclasses.asdict(network.config), sort_keys=True),
    }
    write_bytes(path, dump_tensors(tensors, metadata))


def load_encoder(path: Path | str | None = None) -> AlexNet:
    """Read an encoder; without a path the project's own (read once), which the Blender extension leaves out.

    Raises MaterialError where the project's own is left out, FileError where there is no file, WeightsError where it is
    damaged, of another format, make or architecture, or not finite.
    """
    return _load_default(DEFAULT_ENCODER) if path is None else _read_encoder(Path(path))


@lru_cache(maxsize=1)
def _load_default(path: Path) -> AlexNet:
    if not path.is_file():
        raise MaterialError(
            f"the network of {ALEXNET_ID} is not part of the Blender extension.",
            remedy=f"Choose {ENCODER_ID}, or name a copy of hnf_core/data/{path.name} from the project's source.",
        )
    return _read_encoder(path)


def _read_encoder(path: Path) -> AlexNet:
    file = read_weights(path, _ENCODER_KIND)
    made = file.metadata.get("encoder")
    if made != ALEXNET_ID:
        raise file.make_error(f"{_ENCODER_KIND.wrong_format} ({made}, not {ALEXNET_ID}).")
    design = file.parse_metadata(lambda metadata: _parse_config(json.loads(metadata["architecture"])))
    return AlexNet(design, file.check_parameters(design.shapes()), file.metadata, file.content_id)


def _parse_config(record: Mapping[str, Any]) -> AlexNetConfig:
    mean, deviation = (tuple(float(value) for value in record[name]) for name in ("mean", "deviation"))
    design = AlexNetConfig(int(record["pixels"]), int(record["hidden"]), mean, deviation)  # type: ignore[arg-type]
    if len(mean) != 3 or len(deviation) != 3 or not all(0.0 < value < float("inf") for value in deviation):
        raise ValueError("three means and three positive deviations are needed")
    if design.pixels not in SUPPORTED_PIXELS or not 1 <= design.hidden <= 4096:
        raise ValueError(f"{design.pixels} pixels and {design.hidden} units are out of range")
    return design
