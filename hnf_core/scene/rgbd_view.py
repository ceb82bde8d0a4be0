"""A rendered RGB-D view, the passes of a multilayer EXR as Blender writes them, and EXR files of our own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..files import write_atomically
from .camera import Camera


@dataclass(frozen=True)
class RgbdView:
    """One rendered view of a scene.

    Attributes
    ----------
    camera : Camera
        Camera of the view.
    rgb : ndarray of float32, shape (H, W, 3)
        Linear colour.
    depth : ndarray of float32, shape (H, W)
        Planar depth [m], inf where nothing is hit.
    face_id : ndarray of int32, shape (H, W)
        Index of the polygon seen, -1 if none.
    normal : ndarray of float32, shape (H, W, 3), or None
        World shading normal, with bump and normal maps applied, zero if nothing is hit; None if the pass was not
        rendered.
    channels : mapping of str to ndarray of float32
        Further passes (H, W) or (H, W, 3) by name.
    """

    camera: Camera
    rgb: NDArray[np.float32]
    depth: NDArray[np.float32]
    face_id: NDArray[np.int32]
    normal: NDArray[np.float32] | None = None
    channels: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)


def read_exr(path: str | Path) -> dict[str, NDArray[np.float32]]:
    """Read the passes of an EXR by name: (H, W) for one channel, (H, W, C) in file order for several.

    Parameters
    ----------
    path : str or Path
        The file. Blender up to 4.5 writes one part with interleaved channels, 5.0 one part per pass; both name a
        channel "<layer>.<pass>.<component>".

    Returns
    -------
    dict of str to ndarray of float32
        Passes, without the name of the view layer.

    Raises
    ------
    FileError
        If the file is missing, damaged, or no EXR.
    """
    path = Path(path)
    parts = _read_parts(path)
    channels = {name: channel.pixels for part in parts for name, channel in part.channels.items()}
    if not channels:
        raise FileError("it holds no channels.", where=str(path), remedy="Render it again.")
    return group_channels(channels)


def _read_parts(path: Path) -> Any:
    if not path.is_file():
        raise FileError("there is no such file.", where=str(path), remedy="Render it again.")
    import OpenEXR  # imported here because it is slow to load and only needed for rendered files

    try:
        return OpenEXR.File(str(path), separate_channels=True).parts
    except Exception as error:  # the reader's own exceptions share no narrower base
        raise FileError(
            f"it cannot be read as OpenEXR ({error}).", where=str(path), remedy="Render it again."
        ) from error


MANIFEST_ENTRY = re.compile(r'"(.*?)":"([0-9a-f]{8})"(?=[,}])')
"""An entry of a cryptomatte's manifest, a JSON object in which Cycles does not escape the names."""


def read_cryptomatte_names(path: Path) -> dict[int, str]:
    """Read the names of everything that a file's cryptomattes may show, by 32-bit hash (Psyop, Cryptomatte 1.2).

    The pass `CryptoObject00` of `read_exr` holds the bits of such a hash in its first channel. Raises FileError as
    `read_exr` does.
    """
    headers = (str(value) for part in _read_parts(path) for key, value in part.header.items() if "/manifest" in key)
    return {int(code, 16): name for header in headers for name, code in MANIFEST_ENTRY.findall(header)}


def write_exr(path: Path, channels: Mapping[str, NDArray[np.float32] | NDArray[np.uint32]]) -> None:
    """Write channels (H, W), or (H, W, 3) as "RGB", to an EXR of one part, losslessly compressed, atomically.

    Raises FileError if OpenEXR is missing or the file cannot be written.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise FileError(
            f"EXR needs OpenEXR ({error}).", where=str(path), remedy="Install the package with all it needs."
        ) from error
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    contiguous = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    write_atomically(path, lambda temporary: OpenEXR.File(header, contiguous).write(str(temporary)))


def group_channels(channels: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
    """Group channels named "<layer>.<pass>.<component>" to passes; components in the order x y z w, or r g b a."""
    passes: dict[str, dict[str, NDArray[np.float32]]] = {}
    for name, pixels in channels.items():
        prefix, _, component = name.rpartition(".")
        pass_name = prefix.partition(".")[2] if "." in prefix else prefix
        passes.setdefault(pass_name, {})[component] = np.asarray(pixels, dtype=np.float32)
    return {name: _stack_components(components) for name, components in passes.items()}


def _stack_components(components: dict[str, NDArray[np.float32]]) -> NDArray[np.float32]:
    if len(components) == 1:
        return next(iter(components.values()))
    order = sorted(components, key=lambda name: "rxgybzaw".find(name.lower()) if name else -1)
    return np.stack([components[name] for name in order], axis=-1)
