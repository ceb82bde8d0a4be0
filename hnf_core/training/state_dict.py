"""A network that the user has, as a file: torchvision's names and tensors as .safetensors, read as data alone."""

from __future__ import annotations

import hashlib
from pathlib import Path

from torch import Tensor

from ..errors import WeightsError
from ..weights_file import read_weights_bytes

SUFFIX = ".safetensors"


def read_state_dict(path: Path, network: str) -> tuple[dict[str, Tensor], str]:
    """The tensors by name, as they were saved, and the file's SHA-256 in hex.

    network: its name in torchvision.models, for messages. torch's own files (.pth, .pt) are pickles, programs that run
    when they are read: they are refused unread, with the command that converts one. Raises FileError where there is no
    file, WeightsError where it is not a safetensors file.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    remedy = format_save_command(network)
    if path.is_file() and path.suffix != SUFFIX:
        found = path.suffix or "no suffix"
        raise WeightsError(
            f"not a file of weights that can be read as data alone ({found}, not {SUFFIX}).",
            where=str(path),
            remedy=remedy,
        )
    data = read_weights_bytes(path, "the trunk", remedy)
    try:
        return load(data), hashlib.sha256(data).hexdigest()
    except (SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise WeightsError(f"damaged or not a file of weights ({error}).", where=str(path), remedy=remedy) from error


def format_save_command(network: str) -> str:
    """What to run for a file that read_state_dict reads, in words and as one line for a shell."""
    return (
        f"Save the state dict of torchvision's {network} with your own Python: "
        f'python -c "import torchvision, safetensors.torch as s; '
        f"s.save_file(torchvision.models.{network}(weights='DEFAULT').state_dict(), '{network}{SUFFIX}')\""
    )
