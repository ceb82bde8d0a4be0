"""MPEG_haptic_material: what a baked surface feels like, as textures of a glTF file.

ISO/IEC 23090-14, 2nd edition; the extension's page and schemas are public: github.com/KhronosGroup/glTF,
extensions/2.0/Vendor/MPEG_haptic_material (README.md, schema/glTF.MPEG_haptic_material.schema.json,
MPEG_haptic_material.schema.json, ….material.schema.json, ….material.texture.schema.json). The file lists materials; a
mesh names one by hapticMaterialIndex; a material has arrays of textures {texture, type} by property.

The page says what a property means but not how pixels count. So each texture has its range, unit and exact values in
extras, and a taxel a baked material: a row of pixels that a UV map of its own points at. So values are not averaged
over seams of the artist's UV map, and a mesh without one has them too. Left out, as nothing baked says them:
temperature, vibration, custom. Left out, as it needs binary haptic media (.hmpg), which this project does not write:
haptic, and textures of type Reference.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..material.palette import Palette
from ..material.token import LEVELS, TOKEN_NAMES
from .gltf_file import BufferBuilder
from .gltf_mesh import compute_taxel_row_width
from .png import encode_grey_png

HAPTIC_EXTENSION = "MPEG_haptic_material"
_NEAREST, _CLAMP = 9728, 33071


def encode_haptic_material(palette: Palette, buffer: BufferBuilder, uv_map: int) -> dict[str, Any]:
    """glTF's samplers, images, textures and extensions of a palette; a property that no material knows is left out.
    uv_map: number of the TEXCOORD that points at the taxels."""
    roughness = np.sqrt(np.sum(10.0 ** (2.0 * palette.tokens[:, LEVELS].astype(np.float64)), axis=1))
    columns: dict[str, tuple[str, str, str, list[float | None]]] = {
        "stiffness": ("High_Resolution", "contact stiffness at 1 N", "N/m", _get_mechanics(palette, "stiffness_n_m")),
        "friction": ("High_Resolution", "coefficient of friction", "1", _get_mechanics(palette, "friction")),
        "vibrotactileTexture": ("Other", "RMS height of the relief", "m", [float(value) for value in roughness]),
    }
    material: dict[str, Any] = {"name": "baked touch"}
    images: list[dict[str, Any]] = []
    for name, (kind, quantity, unit, values) in columns.items():
        largest = max((value for value in values if value is not None), default=0.0)
        if largest <= 0.0:
            continue
        images.append(
            {"name": name, "mimeType": "image/png", "bufferView": buffer.add_bytes(_encode_taxel_row(values, largest))}
        )
        meaning = {"quantity": quantity, "unit": unit, "minimum": 0.0, "maximum": largest, "values": values}
        texture = {"index": len(images) - 1, "texCoord": uv_map}
        material[name] = [{"texture": texture, "type": kind, "extras": {"hnf": meaning}}]
    return {
        "samplers": [{"magFilter": _NEAREST, "minFilter": _NEAREST, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "images": images,
        "textures": [{"sampler": 0, "source": index} for index in range(len(images))],
        "extensions": {HAPTIC_EXTENSION: {"materials": [material]}},
        "extensionsUsed": [HAPTIC_EXTENSION],
    }


def encode_palette(palette: Palette) -> dict[str, Any]:
    """The palette in words and numbers that JSON holds exactly, for extras."""
    return {
        "schema": palette.schema,
        "encoder": palette.encoder_id,
        "names": list(palette.names),
        "stiffness_n_m": _get_mechanics(palette, "stiffness_n_m"),
        "damping_ratio": _get_mechanics(palette, "damping_ratio"),
        "friction": _get_mechanics(palette, "friction"),
        "features": list(TOKEN_NAMES),
        "tokens": [[float(value) for value in token] for token in palette.tokens],
    }


def _get_mechanics(palette: Palette, name: str) -> list[float | None]:
    values = [getattr(each, name) for each in palette.mechanics]
    return [None if value is None else float(value) for value in values]


def _encode_taxel_row(values: list[float | None], largest: float) -> bytes:
    """A row of taxels: black for what was not touched or is not known, 255 for the largest."""
    pixels: NDArray[np.uint8] = np.zeros((1, compute_taxel_row_width(len(values))), dtype=np.uint8)
    pixels[0, 1 : len(values) + 1] = [round(255.0 * (value or 0.0) / largest) for value in values]
    return encode_grey_png(pixels)
