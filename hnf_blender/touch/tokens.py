"""Tokens of all baked strokes → attributes on the meshes they touch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hnf_core.errors import FileError, SceneError
from hnf_core.files import content_hash
from hnf_core.material.palette import Palette, build_palette
from hnf_core.material.token import ENCODER_ID, LEVELS, split_encoders

from ..bridge.storage import UNBAKED, FaceTokens, read_tokens, write_tokens
from .bake import TouchedObject, encoder_of
from .feel import BakedStroke
from .jobs import SurfaceFacts


def by_mesh(strokes: Sequence[BakedStroke]) -> list[list[BakedStroke]]:
    """The strokes in groups that touch one mesh."""
    groups: dict[str, list[BakedStroke]] = {}
    for stroke in strokes:
        groups.setdefault(stroke.touched.obj.data.name_full, []).append(stroke)
    return list(groups.values())


def store_tokens(strokes: Sequence[BakedStroke]) -> Iterator[str]:
    """Write every touched mesh once; yields a warning for each that cannot be written."""
    for group in by_mesh(strokes):
        obj = group[0].touched.obj
        if obj.type != "MESH":
            yield f"object '{obj.name}' has no mesh of its own: its tokens are not stored in the .blend."
            continue
        try:
            write_tokens(obj.data, face_tokens(obj.data, group))
        except SceneError as error:
            yield str(error)


def face_tokens(mesh: Any, strokes: Sequence[BakedStroke]) -> FaceTokens:
    """Faces under the strokes' patches get their patch's token; of overlapping patches the last wins. Tokens that an
    earlier bake left on the other faces stay as long as the mesh and its shaders are what they were then."""
    source = surface_source(strokes[0].touched)
    earlier = _still_true(mesh, source)
    count = len(mesh.polygons)
    index = np.full(count, UNBAKED, dtype=np.int32)
    confidence = np.zeros(count, dtype=np.float32)
    tokens, mechanics, names, makes = [], [], [], {ENCODER_ID}
    if earlier is not None:
        index, confidence = earlier.index.copy(), earlier.confidence.copy()
        tokens, mechanics = list(earlier.palette.tokens), list(earlier.palette.mechanics)
        names = list(earlier.palette.names)
        makes.update(split_encoders(earlier.palette.encoder_id))
    for stroke in strokes:
        for patch, record, fused in zip(stroke.patches, stroke.records, stroke.fused, strict=True):
            index[record.faces] = len(tokens)
            confidence[record.faces] = fused.confidence
            tokens.append(fused.values)
            mechanics.append(stroke.materials[patch.slot].library.mechanics)
            names.append(stroke.materials[patch.slot].library.name)
            makes.update({encoder_of(record)} - {""})
    used = sorted(set(index[index >= 0].tolist()))
    palette, merged = build_palette(
        [tokens[i] for i in used], [mechanics[i] for i in used], [names[i] for i in used], encoders=makes
    )
    lookup = np.full(len(tokens) + 1, UNBAKED, dtype=np.int32)
    lookup[used] = merged
    index = lookup[index]  # UNBAKED is −1, the last entry
    return FaceTokens(palette, index, _roughness(palette, index), confidence, source)


def _roughness(palette: Palette, index: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """RMS height in metres over all bands of each face's token; 0 where nothing was touched."""
    power = np.sum(10.0 ** (2.0 * palette.tokens[:, LEVELS].astype(np.float64)), axis=1)
    return np.asarray(np.append(np.sqrt(power), 0.0)[index], dtype=np.float32)


def _still_true(mesh: Any, source: str) -> FaceTokens | None:
    try:
        earlier = read_tokens(mesh)
    except FileError:  # damaged: this bake replaces it
        return None
    return earlier if earlier is not None and earlier.source == source else None


def surface_source(surface: TouchedObject | SurfaceFacts) -> str:
    """Hash of what a surface's tokens are measured from."""
    return content_hash(surface.shape_hash, *surface.shader_hashes, surface.owner_hash)
