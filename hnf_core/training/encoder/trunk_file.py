"""A trunk that the user has: torchvision's AlexNet, as .safetensors or as a .pth state dict."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...errors import FileError, WeightsError
from ...material.alexnet.trunk import trunk_shapes

_REMEDY = (
    "Give the state dict of torchvision.models.alexnet: alexnet-owt-7be5be79.pth as PyTorch offers it, or the same "
    "tensors as .safetensors."
)


def load_trunk(path: Path) -> tuple[dict[str, Tensor], str]:
    """Float32 tensors features.0.weight … features.10.bias, and the file's SHA-256 in hex.

    Everything is read as data, never as a program (.pth with weights_only). classifier.* is ignored. Raises FileError
    where there is no file, WeightsError where names, shapes or numbers are not AlexNet's.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot read the trunk ({error.strerror}).", where=str(path), remedy=_REMEDY) from error
    state = read_state_dict(path, _REMEDY)
    wanted = trunk_shapes()
    missing = sorted(set(wanted) - set(state))
    strange = sorted(name for name in set(state) - set(wanted) if not str(name).startswith("classifier."))
    if missing or strange:
        raise WeightsError(
            f"not the trunk of AlexNet: missing {missing[:3]}, unknown {strange[:3]}.", where=str(path), remedy=_REMEDY
        )
    out = {}
    for name, shape in wanted.items():
        tensor = state[name]
        if not isinstance(tensor, Tensor) or tuple(tensor.shape) != shape or not tensor.is_floating_point():
            found = tuple(tensor.shape) if isinstance(tensor, Tensor) else type(tensor).__name__
            raise WeightsError(f"{name} is {found}, AlexNet's is {shape}.", where=str(path), remedy=_REMEDY)
        out[name] = tensor.to(torch.float32)
        if not torch.isfinite(out[name]).all():
            raise WeightsError(f"{name} is not finite.", where=str(path), remedy=_REMEDY)
    return out, hashlib.sha256(data).hexdigest()


def read_state_dict(path: Path, remedy: str) -> dict[Any, Any]:
    """Names and values of a .safetensors file, or of a .pth file read as data. Raises WeightsError, which tells the
    remedy, where it is neither."""
    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            return dict(load_file(path))
        found = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch and safetensors raise many kinds on foreign files
        raise WeightsError(
            f"damaged or not a file of weights ({str(error).splitlines()[0][:120]}).", where=str(path), remedy=remedy
        ) from error
    if not isinstance(found, dict):
        raise WeightsError(f"holds a {type(found).__name__}, not a state dict.", where=str(path), remedy=remedy)
    return found
