"""Two trained encoders in a folder: weights under the standard names, and how they came about."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...errors import FileError, WeightsError
from ...files import write_bytes, write_text
from ...tensor_file import dump_tensors, load_tensors
from .encoders import Architecture, ResNetEncoder
from .train import FitResult, Recipe

MODEL_FORMAT = "hnf-alignment-1"
RECORD_FILE = "alignment.json"


@dataclass(frozen=True)
class AlignedEncoders:
    """vision, touch: frozen encoders. pixels: what they were trained on. record: what RECORD says."""

    vision: ResNetEncoder
    touch: ResNetEncoder
    pixels: int
    record: Mapping[str, Any]

    @property
    def sensor(self) -> str:
        """gelsight, digit or both: what its tuples were of."""
        return str(self.record["sensor"])


def save_encoders(folder: Path, fitted: FitResult, recipe: Recipe, details: Mapping[str, Any]) -> Mapping[str, Any]:
    """Write vision.safetensors, touch.safetensors and RECORD, which holds what is `told` (sensor: …), the recipe, the
    curve of the loss and the weights' checksums; return the record. Raises FileError."""
    sums = {}
    for name, encoder in (("vision", fitted.vision), ("touch", fitted.touch)):
        tensors = {key: value.contiguous().numpy() for key, value in encoder.state_dict().items()}
        data = dump_tensors(tensors, {"format": MODEL_FORMAT, "encoder": name})
        write_bytes(folder / f"{name}.safetensors", data)
        sums[name] = hashlib.sha256(data).hexdigest()
    curve = fitted.history[_space_indices(len(fitted.history), 50)]
    record = {
        "format": MODEL_FORMAT, **details, "recipe": asdict(recipe), "steps": len(fitted.history),
        "seconds": round(float(fitted.history[-1, 1]), 1) if len(fitted.history) else 0.0, "sha256": sums,
        "curve": [[int(step), round(seconds, 1), round(loss, 4)] for step, seconds, loss in curve.tolist()],
    }  # fmt: skip
    write_text(folder / RECORD_FILE, json.dumps(record, indent=1) + "\n")
    return record


def load_encoders(folder: Path) -> AlignedEncoders:
    """Raises FileError where the folder holds no such weights, WeightsError where they do not fit the record."""
    try:
        record = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))
        if record["format"] != MODEL_FORMAT:
            raise ValueError(f"format {record['format']!r}")
        recipe = record["recipe"]
        shape = recipe["architecture"]
        architecture = Architecture(tuple(shape["blocks"]), int(shape["width"]), int(shape["outputs"]))
        data = {name: (folder / f"{name}.safetensors").read_bytes() for name in ("vision", "touch")}
        states = {name: load_tensors(each)[0] for name, each in data.items()}
        sums, pixels = record["sha256"], int(recipe["pixels"])
        str(record["sensor"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(
            f"these are no aligned encoders ({error}).", where=str(folder), remedy="Train them: hnf train alignment."
        ) from error
    encoders = {}
    for name, state in states.items():
        if hashlib.sha256(data[name]).hexdigest() != sums.get(name):
            raise WeightsError(
                f"{name}.safetensors is not the file that {RECORD_FILE} describes.",
                where=str(folder),
                remedy="Train again.",
            )
        encoder = ResNetEncoder(architecture)
        try:
            encoder.load_state_dict({key: torch.from_numpy(np.array(value)) for key, value in state.items()})
        except RuntimeError as error:
            raise WeightsError(f"{name}.safetensors does not fit its record.", where=str(folder)) from error
        encoders[name] = encoder.to(memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
    return AlignedEncoders(encoders["vision"], encoders["touch"], pixels, record)


def _space_indices(count: int, most: int) -> list[int]:
    """Up to `most` of the numbers below count, the last among them."""
    return sorted({count - 1 - (count - 1) * index // most for index in range(most)}) if count else []
