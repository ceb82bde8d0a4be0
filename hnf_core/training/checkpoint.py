"""Checkpoints of a training run: everything that the next epoch depends on, in one safetensors file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..files import write_bytes
from ..safetensors_io import dump_tensors, load_tensors

FORMAT = "hnf-checkpoint-1"


@dataclass(frozen=True)
class Checkpoint:
    """State of a run after `epoch` epochs.

    tensors: network, optimiser, best weights and random state, by name. history: (epoch, 3) epoch number, training loss
    and validation loss.
    """

    epoch: int
    tensors: Mapping[str, NDArray[np.generic]]
    history: NDArray[np.float64]


def save_checkpoint(path: Path, checkpoint: Checkpoint, fingerprint: str) -> None:
    """Write a checkpoint atomically, with the fingerprint of its run. Raises FileError."""
    tensors = {name: np.ascontiguousarray(value) for name, value in checkpoint.tensors.items()}
    tensors["history"] = checkpoint.history
    metadata = {"format": FORMAT, "fingerprint": fingerprint, "epoch": str(checkpoint.epoch)}
    write_bytes(path, dump_tensors(tensors, metadata))


def load_checkpoint(path: Path, fingerprint: str) -> Checkpoint | None:
    """Read the checkpoint of the run with this fingerprint.

    Returns None if there is none, if it is damaged, or if it belongs to other data, another architecture or another
    seed; the run then starts from the beginning.
    """
    try:
        tensors, metadata = load_tensors(path.read_bytes())
        if metadata["format"] != FORMAT or metadata["fingerprint"] != fingerprint:
            return None
        history = tensors.pop("history")
        return Checkpoint(int(metadata["epoch"]), tensors, history)
    except (OSError, ValueError, KeyError, TypeError):
        return None
