"""What a pen meets on a surface: where it is in the surface's own frame, which way its axes lie, what is felt there.

Looked up face by face in the evaluated mesh as it is, without a copy: a hand moves a hundred times a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import compute_tangents
from hnf_core.material.hnf_file import MaterialFile, from_library, with_library_defaults
from hnf_core.material.library import get_material, load_library
from hnf_core.material.material import LibraryMaterial
from hnf_core.material.prior import rank
from hnf_core.material.token import TOKEN_DIM, Token

from .drawn_stroke import Hit
from .meshes import compute_surface_frame, get_materials
from .own_material import get_artist_choice
from .storage import TOKEN_ATTRIBUTE, read_tokens

Float = NDArray[np.float64]


@dataclass(frozen=True)
class ContactPoint:
    """point: (3,) m in the surface frame. axes: (2, 3) unit, ∂p/∂u laid on the face and the normal × it: the frame that
    stroke directions and tactile maps have there. slot, token: material slot, and palette index of the bake (−1: not
    baked)."""

    point: Float
    axes: Float
    slot: int
    token: int


def find_contact_point(hit: Hit, depsgraph: Any, metres_per_unit: float) -> ContactPoint:
    """The place that a ray met. Raises SceneError where its object is scaled to nothing."""
    evaluated = hit.obj.evaluated_get(depsgraph)
    mesh = evaluated.data
    rigid, stretch = compute_surface_frame(evaluated.matrix_world, metres_per_unit, f"object '{hit.obj.name}'")
    normal = rigid[:3, :3].T @ hit.normal
    length = float(np.linalg.norm(normal))
    normal = normal / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    corners, uv, slot, token = np.zeros((3, 3)), None, 0, -1
    if hit.face < len(mesh.polygons):  # not so where a graphics card subdivides
        face = mesh.polygons[hit.face]
        loops = list(face.loop_indices)[:3]
        corners = np.array([mesh.vertices[mesh.loops[loop].vertex_index].co for loop in loops]) @ stretch.T
        layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
        uv = None if layer is None else np.array([[layer.uv[loop].vector for loop in loops]], dtype=np.float64)
        slot, token = int(face.material_index), _read_face_token(mesh, hit.face)
    (along,), _ = compute_tangents(corners[None], uv, normal[None])
    return ContactPoint(stretch @ hit.local, np.stack([along, np.cross(normal, along)]), slot, token)


def _read_face_token(mesh: Any, face: int) -> int:
    kept = mesh.attributes.get(TOKEN_ATTRIBUTE)
    is_kept = kept is not None and kept.domain == "FACE" and kept.data_type == "INT"
    return int(kept.data[face].value) if is_kept else -1


def find_touched_material(obj: Any, depsgraph: Any, slot: int, token: int) -> MaterialFile:
    """What a slot of obj feels like, complete: what was baked there, unless another material was chosen since; else
    the artist's choice; else what the slot's shader looks like most.

    Raises MaterialError for a choice that the library does not know, FileError for a damaged definition.
    """
    materials = get_materials(obj.evaluated_get(depsgraph), obj.evaluated_get(depsgraph).data)
    shader = materials[slot] if slot < len(materials) else None
    word = get_artist_choice(shader) if shader is not None else ""
    if isinstance(word, MaterialFile) and word.field:
        return word  # what was baked of it is its token alone
    chosen = with_library_defaults(word) if isinstance(word, MaterialFile) else get_material(word) if word else None
    baked = _get_baked_material(obj, token)
    if baked is not None and (chosen is None or chosen.name == baked.name):
        return baked
    return from_library(chosen or _guess_material(obj, shader))


def _get_baked_material(obj: Any, token: int) -> MaterialFile | None:
    kept = read_tokens(obj.data) if token >= 0 else None
    if kept is None or token >= len(kept.palette):
        return None
    palette = kept.palette
    known = np.ones(TOKEN_DIM, dtype=bool)
    return MaterialFile(
        palette.names[token],
        Token(palette.tokens[token], known),
        palette.mechanics[token],
        encoder=palette.encoder_id,
    )


def _guess_material(obj: Any, shader: Any) -> LibraryMaterial:
    from hnf_core.material.material import Appearance

    from .picture_names import list_texture_names
    from .shader_values import read_stated_appearance

    looks = Appearance() if shader is None else read_stated_appearance(shader)
    names = ["" if shader is None else shader.name, obj.name, obj.data.name]
    return get_material(rank(load_library(), looks, names, image_names=list_texture_names(shader))[0].name)
