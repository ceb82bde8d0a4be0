"""Tokens of all baked strokes → attributes on the meshes they touch."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence, Set
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import FileError, HnfError, SceneError
from hnf_core.files import content_hash
from hnf_core.material.palette import Palette, build_palette
from hnf_core.material.token import ENCODER_ID, LEVELS, split_encoders
from hnf_core.scene.near import crop_mesh
from hnf_core.scene.patch import CAMERA_DISTANCE_M

from ..bridge.scene_names import find_object
from ..bridge.splat_cloud import get_cloud, read_cloud, write_point_tokens
from ..bridge.splat_frame import compute_cloud_frame
from ..bridge.storage import UNBAKED, FaceTokens, PointTokens, read_tokens, write_tokens
from ..props.scene import find_index
from .bake import TouchedObject, get_encoder_name
from .feel import BakedStroke
from .jobs import Session, SurfaceFacts


def group_by_mesh(strokes: Sequence[BakedStroke]) -> list[list[BakedStroke]]:
    """The strokes in groups that touch one mesh."""
    groups: dict[str, list[BakedStroke]] = {}
    for stroke in strokes:
        groups.setdefault(stroke.touched.obj.data.name_full, []).append(stroke)
    return list(groups.values())


def store_tokens(strokes: Sequence[BakedStroke]) -> Iterator[str]:
    """Write every touched mesh once; yields a warning for each that cannot be written."""
    for group in group_by_mesh(strokes):
        obj = group[0].touched.obj
        if obj.type != "MESH":
            yield f"object '{obj.name}' has no mesh of its own: its tokens are not stored in the .blend."
            continue
        try:
            tokens = make_face_tokens(obj.data, group)
            write_tokens(obj.data, tokens)
            if tokens.points is not None:
                write_point_tokens(get_cloud(obj), tokens.points)
        except SceneError as error:
            yield str(error)


def make_face_tokens(mesh: Any, strokes: Sequence[BakedStroke], sources: Set[str] = frozenset()) -> FaceTokens:
    """Faces under the strokes' patches get their patch's token; of overlapping patches the last wins. Tokens that an
    earlier bake left on the other faces stay as long as the mesh and its shaders are what they were then. sources: of
    other surfaces with this mesh (shared_sources), whose tokens stay too."""
    source = hash_surface_source(strokes[0].touched)
    earlier = _read_valid_tokens(mesh, {source, *sources})
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
            makes.update({get_encoder_name(record)} - {""})
    used = sorted(set(index[index >= 0].tolist()))
    palette, merged = build_palette(
        [tokens[i] for i in used], [mechanics[i] for i in used], [names[i] for i in used], encoders=makes
    )
    lookup = np.full(len(tokens) + 1, UNBAKED, dtype=np.int32)
    lookup[used] = merged
    index = lookup[index]  # UNBAKED is −1, the last entry
    points = make_point_tokens(strokes[0].touched, index, confidence)
    return FaceTokens(palette, index, _compute_roughness(palette, index), confidence, source, points)


def make_point_tokens(
    touched: TouchedObject, index: NDArray[np.int32], confidence: NDArray[np.float32]
) -> PointTokens | None:
    """Of the splats of a reconstructed surface: each gets what the nearest face has, if no farther than a patch's
    camera stands off; None where there are no splats. index, confidence: (F,) of the faces of the object's own mesh."""
    cloud = get_cloud(touched.obj)
    if cloud is None:
        return None
    from hnf_core.scene.splats.nearest import find_nearest_triangles

    mesh, own = touched.surface.mesh, touched.surface.source_face
    splats = compute_cloud_frame(touched.obj, cloud, touched.surface.stretch).to_surface(read_cloud(cloud).means)
    face = mesh.face if own is None else own[mesh.face]
    made = PointTokens(np.full(len(splats), UNBAKED, dtype=np.int32), np.zeros(len(splats), dtype=np.float32))
    baked = mesh.vertices[mesh.triangles[(face >= 0) & (index[face] != UNBAKED)]].reshape(-1, 3)
    if len(baked) == 0:
        return made
    low, high = baked.min(axis=0) - CAMERA_DISTANCE_M, baked.max(axis=0) + CAMERA_DISTANCE_M
    here = np.flatnonzero(((splats >= low) & (splats <= high)).all(axis=1))
    near = crop_mesh(mesh, [(low + high) / 2.0], float((high - low).max() / 2.0) + CAMERA_DISTANCE_M)
    found = find_nearest_triangles(near.vertices, near.triangles, splats[here], CAMERA_DISTANCE_M)
    here, triangle = here[found.triangle >= 0], found.triangle[found.triangle >= 0]
    nearest = near.face[triangle] if own is None else own[near.face[triangle]]
    told = nearest >= 0
    made.index[here[told]], made.confidence[here[told]] = index[nearest[told]], confidence[nearest[told]]
    return made


def _compute_roughness(palette: Palette, index: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """RMS height in metres over all bands of each face's token; 0 where nothing was touched."""
    power = np.sum(10.0 ** (2.0 * palette.tokens[:, LEVELS].astype(np.float64)), axis=1)
    return np.asarray(np.append(np.sqrt(power), 0.0)[index], dtype=np.float32)


def _read_valid_tokens(mesh: Any, sources: Set[str]) -> FaceTokens | None:
    try:
        earlier = read_tokens(mesh)
    except FileError:  # damaged: this bake replaces it
        return None
    return earlier if earlier is not None and earlier.source in sources else None


def hash_surface_source(surface: TouchedObject | SurfaceFacts) -> str:
    """Hash of what a surface's tokens are measured from."""
    return content_hash(surface.shape_hash, *surface.shader_hashes, surface.owner_hash)


def find_shared_sources(session: Session, obj: Any) -> set[str]:
    """surface_source of the other touched objects with obj's mesh. Linked duplicates (Alt D) may differ in scale and in
    the materials of their own slots, and the mesh, which has room for the tokens of one source, serves them all."""
    chosen = (each.hnf_stroke.surface for each in session.scene.objects if each.hnf_stroke.is_stroke)
    touched = {*chosen, *(find_object(session.scene, name) for name in session.known_names)} - {None, obj}
    sources = set()
    for other in touched:
        if other.data == obj.data and find_index(session.scene.objects, other) >= 0:
            with contextlib.suppress(HnfError):  # one that is hidden says nothing
                sources.add(hash_surface_source(session.get_facts(other)))
    return sources
