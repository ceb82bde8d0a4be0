"""What lies under the mouse in a 3-D view.

What a person sees and presses on, and no stroke can touch as it is: instances, texts, curves.

What a pen meets on a surface: where it is in the surface's own frame, which way its axes lie, what is felt there.

Looked up face by face in the evaluated mesh as it is, without a copy: a hand moves a hundred times a second.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import compute_tangents
from hnf_core.material.hnf_file import MaterialFile, from_library, with_library_defaults
from hnf_core.material.library import Appearance, LibraryMaterial, get_material, load_library
from hnf_core.material.ranking import rank
from hnf_core.material.token import TOKEN_DIM, Token

from ..translations import tr
from .scene.material_definition import get_artist_choice
from .scene.mesh_attributes import TOKEN_ATTRIBUTE, read_tokens
from .scene.meshes import compute_surface_frame, get_materials
from .splats.splat_cloud import is_cloud

Float = NDArray[np.float64]

SEE_THROUGH_DISPLAY_TYPES = ("WIRE", "BOUNDS")
"""Display types that a person sees through, so that a pen draws through them too."""
MAX_RAY_HITS = 64
RAY_STEP_FRACTION = 1e-5
"""By how much of the way so far a ray goes on behind something it passes through."""


@dataclass(frozen=True)
class Hit:
    """obj: what the ray met. local: (3,) in its coordinates. world, normal: (3,). face: polygon of its evaluated
    mesh."""

    obj: Any
    local: Float
    world: Float
    normal: Float
    face: int


@dataclass(frozen=True)
class UntouchableObject:
    """name: of the object to select. is_instance: it shows other objects or geometry; else it is no mesh yet."""

    name: str
    is_instance: bool


def cast_on_surface(scene: Any, depsgraph: Any, viewport: Any, origin: Any, direction: Any) -> Hit | None:
    """The first mesh that a person sees along a ray of the viewport (SpaceView3D, None: the view layer decides), in
    Blender units. Instances, and what the viewport hides or shows as wires, are passed through."""
    from mathutils import Vector

    if any(is_cloud(obj) for obj in scene.objects):
        return _cast_per_object(scene, depsgraph, viewport, Vector(origin), Vector(direction))
    for world, normal, face, obj, matrix in iter_ray_hits(scene, depsgraph, origin, direction):
        if _is_surface(obj, matrix, scene, depsgraph, viewport):
            return Hit(obj, np.array(matrix.inverted_safe() @ world), np.array(world), np.array(normal), int(face))
    return None


def iter_ray_hits(scene: Any, depsgraph: Any, origin: Any, direction: Any) -> Iterator[tuple[Any, Any, int, Any, Any]]:
    """(place, normal, face, object, its matrix there) of what Blender's own ray meets, the nearest first, LAYERS of
    them at most; instances and whatever else it stops at."""
    from mathutils import Vector

    start, direction = Vector(origin), Vector(direction)
    for _ in range(MAX_RAY_HITS):
        found, world, normal, face, met, matrix = scene.ray_cast(depsgraph, start, direction)
        if not found:
            return
        yield world, normal, face, met.original, matrix
        start = world + direction * max((world - Vector(origin)).length * RAY_STEP_FRACTION, 1e-7)


def _cast_per_object(scene: Any, depsgraph: Any, viewport: Any, origin: Any, direction: Any) -> Hit | None:
    """The same, object by object: Blender's own ray would walk over a hundred thousand ellipsoids first."""
    nearest: Hit | None = None
    for obj in scene.objects:
        if obj.type != "MESH" or is_cloud(obj) or not obj.visible_get(view_layer=depsgraph.view_layer):
            continue
        evaluated = obj.evaluated_get(depsgraph)
        matrix = evaluated.matrix_world
        if len(evaluated.data.polygons) == 0 or not _is_surface(obj, matrix, scene, depsgraph, viewport):
            continue
        back = matrix.inverted_safe()
        found, local, normal, face = evaluated.ray_cast(back @ origin, back.to_3x3() @ direction)
        world = matrix @ local
        if found and (nearest is None or (world - origin).length < np.linalg.norm(nearest.world - np.array(origin))):
            up = back.to_3x3().transposed() @ normal
            nearest = Hit(obj, np.array(local), np.array(world), np.array(up.normalized()), int(face))
    return nearest


def _is_surface(obj: Any, matrix: Any, scene: Any, depsgraph: Any, viewport: Any) -> bool:
    if obj.type != "MESH" or obj.display_type in SEE_THROUGH_DISPLAY_TYPES or scene.objects.get(obj.name) != obj:
        return False
    if not obj.visible_get(view_layer=depsgraph.view_layer, viewport=viewport):
        return False
    own = np.array(obj.evaluated_get(depsgraph).matrix_world)
    return bool(np.allclose(own, np.array(matrix), rtol=1e-5, atol=1e-6))


def find_untouchable(scene: Any, depsgraph: Any, origin: Any, direction: Any) -> UntouchableObject | None:
    """The first such thing along a ray (Blender units); None where there is none, or where splats make a ray dear."""
    if any(is_cloud(obj) for obj in scene.objects):
        return None
    for _, _, _, obj, matrix in iter_ray_hits(scene, depsgraph, origin, direction):
        if obj.display_type in SEE_THROUGH_DISPLAY_TYPES:
            continue
        shown_by = _find_instancer(obj, matrix, depsgraph)
        if shown_by is not None and (shown_by != obj or obj.type == "MESH"):
            return UntouchableObject(str(shown_by.name), is_instance=True)
        if obj.type != "MESH":  # Blender calls the mesh of a text an instance that the text itself shows
            return UntouchableObject(str(obj.name), is_instance=False)
    return None


def _find_instancer(obj: Any, matrix: Any, depsgraph: Any) -> Any:
    """What makes the instance of obj that stands there; None: obj itself does."""
    for each in depsgraph.object_instances:
        if not each.is_instance or each.object.original != obj:
            continue
        if np.allclose(np.array(each.matrix_world), np.array(matrix), rtol=1e-5, atol=1e-6):
            return each.parent.original
    return None


def find_view_under_mouse(context: Any, event: Any) -> Any:
    """The 3-D view under the mouse, with its bars, or None."""
    for area in context.window.screen.areas if context.window is not None else ():
        inside = area.x <= event.mouse_x < area.x + area.width and area.y <= event.mouse_y < area.y + area.height
        if inside and area.type == "VIEW_3D":
            return area
    return None


def find_region_under_mouse(context: Any, event: Any) -> Any:
    """The main region of the 3-D view under the pen, or None; not where a sidebar or header lies over it."""
    found = None
    for area in context.window.screen.areas if context.window is not None else ():
        for region in area.regions if area.type == "VIEW_3D" else ():
            inside = (
                region.x <= event.mouse_x < region.x + region.width
                and region.y <= event.mouse_y < region.y + region.height
            )
            if inside and region.type == "WINDOW":
                found = region
            elif inside and region.width > 1 and region.height > 1:
                return None
    return found


def pick_object(context: Any, x: int, y: int) -> tuple[Any, int] | None:
    """(object, material slot) of the surface that the pen would meet at pixel (x, y) of context's 3-D region, or
    None."""
    from bpy_extras import view3d_utils

    region, view = context.region, context.region_data
    if region is None or view is None:
        return None
    origin = view3d_utils.region_2d_to_origin_3d(region, view, (x, y))
    direction = view3d_utils.region_2d_to_vector_3d(region, view, (x, y))
    return pick_object_along_ray(
        context.scene, context.evaluated_depsgraph_get(), context.space_data, origin, direction
    )


def pick_object_along_ray(
    scene: Any, depsgraph: Any, viewport: Any, origin: Any, direction: Any
) -> tuple[Any, int] | None:
    """(object, material slot) of the first surface that a person sees along a ray (cast_on_surface), or None."""
    met = cast_on_surface(scene, depsgraph, viewport, origin, direction)
    if met is None:
        return None
    mesh = met.obj.evaluated_get(depsgraph).data
    slot = mesh.polygons[met.face].material_index if 0 <= met.face < len(mesh.polygons) else 0
    return met.obj, min(slot, max(len(met.obj.material_slots) - 1, 0))


def pick_surface(context: Any, area: Any, region: Any, at: tuple[float, float]) -> Any:
    """What the pen meets at a place of a region of a 3-D view, in its pixels: a Hit, or None."""
    from bpy_extras import view3d_utils

    return cast_on_surface(
        context.scene,
        context.evaluated_depsgraph_get(),
        area.spaces.active,
        view3d_utils.region_2d_to_origin_3d(region, region.data, at),
        view3d_utils.region_2d_to_vector_3d(region, region.data, at),
    )


def explain_untouchable(context: Any, region: Any, at: tuple[float, float]) -> str:
    """Why what is seen at a place of a region of a 3-D view, in its pixels, is no surface, and what to do; "" where
    nothing is seen there."""
    from bpy_extras import view3d_utils

    seen = find_untouchable(
        context.scene,
        context.evaluated_depsgraph_get(),
        view3d_utils.region_2d_to_origin_3d(region, region.data, at),
        view3d_utils.region_2d_to_vector_3d(region, region.data, at),
    )
    if seen is None:
        return ""
    if seen.is_instance:
        said = tr("'{name}' shows instances: select it, Object > Apply > Make Instances Real, then press again")
    else:
        said = tr("'{name}' is not a mesh: select it, Object > Convert > Mesh, then press again")
    return said.format(name=seen.name)


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
    from .shader.closures import read_stated_appearance
    from .shader.images import list_texture_names

    looks = Appearance() if shader is None else read_stated_appearance(shader)
    names = ["" if shader is None else shader.name, obj.name, obj.data.name]
    return get_material(rank(load_library(), looks, names, image_names=list_texture_names(shader))[0].name)
