"""A rendered RGB-D view, and the passes of a multilayer EXR as Blender writes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
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
    if not path.is_file():
        raise FileError("there is no such file.", where=str(path), remedy="Render it again.")
    import OpenEXR  # imported here because it is slow to load and only needed for rendered files

    try:
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        channels = {name: channel.pixels for part in parts for name, channel in part.channels.items()}
    except Exception as error:  # the reader's own exceptions share no narrower base
        raise FileError(
            f"it cannot be read as OpenEXR ({error}).", where=str(path), remedy="Render it again."
        ) from error
    if not channels:
        raise FileError("it holds no channels.", where=str(path), remedy="Render it again.")
    return group_channels(channels)


def group_channels(channels: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
    """Group channels named "<layer>.<pass>.<component>" to passes; components in the order x y z w, or r g b a."""
    passes: dict[str, dict[str, NDArray[np.float32]]] = {}
    for name, pixels in channels.items():
        pass_name, _, component = name.rpartition(".")
        passes.setdefault(_strip_layer(pass_name), {})[component] = np.asarray(pixels, dtype=np.float32)
    return {name: _stack_components(components) for name, components in passes.items()}


def _strip_layer(name: str) -> str:
    return name.partition(".")[2] if "." in name else name


def _stack_components(components: dict[str, NDArray[np.float32]]) -> NDArray[np.float32]:
    if len(components) == 1:
        return next(iter(components.values()))
    order = sorted(components, key=lambda name: "rxgybzaw".find(name.lower()) if name else -1)
    return np.stack([components[name] for name in order], axis=-1)
