"""A trunk that the user has: torchvision's AlexNet as a .safetensors file."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from ...errors import WeightsError
from ...material.alexnet.trunk import get_backbone_shapes
from ..state_dict import format_save_command, read_state_dict

BACKBONE_NAME = "alexnet"
_REMEDY = format_save_command(BACKBONE_NAME)


def load_backbone(path: Path) -> tuple[dict[str, Tensor], str]:
    """Float32 tensors features.0.weight … features.10.bias, and the file's SHA-256 in hex.

    classifier.* is ignored. Raises FileError where there is no file, WeightsError where it is not a safetensors file,
    or names, shapes or numbers are not AlexNet's.
    """
    state, digest = read_state_dict(path, BACKBONE_NAME)
    wanted = get_backbone_shapes()
    missing = sorted(set(wanted) - set(state))
    strange = sorted(name for name in set(state) - set(wanted) if not name.startswith("classifier."))
    if missing or strange:
        raise WeightsError(
            f"not the trunk of AlexNet: missing {missing[:3]}, unknown {strange[:3]}.", where=str(path), remedy=_REMEDY
        )
    out = {}
    for name, shape in wanted.items():
        found = tuple(state[name].shape)
        if found != shape:
            raise WeightsError(f"{name} is {found}, AlexNet's is {shape}.", where=str(path), remedy=_REMEDY)
        if not state[name].is_floating_point():
            raise WeightsError(f"{name} is {state[name].dtype}, not real.", where=str(path), remedy=_REMEDY)
        out[name] = state[name].to(torch.float32)
        if not torch.isfinite(out[name]).all():
            raise WeightsError(f"{name} is not finite.", where=str(path), remedy=_REMEDY)
    return out, digest
