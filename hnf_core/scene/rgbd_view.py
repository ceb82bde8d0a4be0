"""What a camera sees.

Reading the passes of a rendered multilayer EXR, whichever Blender wrote it.
"""

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
    """One rendered view.

    rgb: (H, W, 3) float32 linear. depth: (H, W) float32 planar z in metres, sky = inf.
    face_id: (H, W) int32, -1 = none. normal: (H, W, 3) float32 world shading normal (micro-normals included),
    zero where nothing is hit; None where the pass was not rendered. channels: further (H, W) or (H, W, 3) float32
    passes by name.
    """

    camera: Camera
    rgb: NDArray[np.float32]
    depth: NDArray[np.float32]
    face_id: NDArray[np.int32]
    normal: NDArray[np.float32] | None = None
    channels: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)


def read_exr(path: str | Path) -> dict[str, NDArray[np.float32]]:
    """Passes by name without the view layer's: (H, W) for one channel, (H, W, C) in file order for several.

    Blender up to 4.5 writes one part with interleaved channels, 5.0 one part a pass; either way a channel is called
    "<layer>.<pass>.<component>". Raises FileError when the file is missing, damaged, or no EXR.
    """
    path = Path(path)
    if not path.is_file():
        raise FileError("there is no such file.", where=str(path), remedy="Render it again.")
    import OpenEXR  # heavy, and needed only where something was rendered

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
    """Channels named "<layer>.<pass>.<component>" → passes; components in the order x y z w, or r g b a."""
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
