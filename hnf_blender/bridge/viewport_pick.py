"""Find the surface, object and material under the mouse or pen in a 3D view.

Rays are cast on evaluated meshes as they are, without copying them, because a pen moves a hundred times a second.
Objects that are visible but cannot be touched (instances, texts, curves) are reported with the remedy.
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
from hnf_core.material.ranking import expect_material, rank
from hnf_core.material.token import TOKEN_DIM, Token

from ..translations import tr
from .scene.material_definition import get_artist_choice
from .scene.meshes import compute_surface_frame, get_materials
from .scene.stored_data import TOKEN_ATTRIBUTE, read_tokens
from .splat_cloud import is_cloud

Float = NDArray[np.float64]

SEE_THROUGH_DISPLAY_TYPES = ("WIRE", "BOUNDS")
"""Display types that can be seen, and therefore drawn, through."""
MAX_RAY_HITS = 64
"""Maximum number of hits along one ray."""
RAY_STEP_FRACTION = 1e-5
"""Offset behind a hit at which a ray continues, as a fraction of the distance to it."""


@dataclass(frozen=True)
class Hit:
    """First surface hit by a viewport ray.

    Attributes
    ----------
    obj : bpy.types.Object
    local : (3,) array
        Hit point in the object's coordinates.
    world, normal : (3,) array
        Hit point [Blender units] and normal in the world frame.
    face : int
        Polygon of the evaluated mesh.
    """

    obj: Any
    local: Float
    world: Float
    normal: Float
    face: int


@dataclass(frozen=True)
class UntouchableObject:
    """A visible object that cannot be touched as it is.

    `name` is the object to select. `is_instance` is true if it shows other objects or geometry; otherwise it is not a
    mesh.
    """

    name: str
    is_instance: bool


def cast_on_surface(scene: Any, depsgraph: Any, viewport: Any, origin: Any, direction: Any) -> Hit | None:
    """Return the first visible mesh along a ray of the viewport, or None.

    Instances, and objects that the viewport hides or draws as wires, are passed through.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene that contains the objects.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    viewport : bpy.types.SpaceView3D or None
        Viewport whose local visibility applies; None uses the view layer's.
    origin, direction : (3,) vector
        Ray in world coordinates [Blender units].

    Returns
    -------
    Hit or None
    """
    from mathutils import Vector

    if any(is_cloud(obj) for obj in scene.objects):
        return _cast_per_object(scene, depsgraph, viewport, Vector(origin), Vector(direction))
    for world, normal, face, obj, matrix in iter_ray_hits(scene, depsgraph, origin, direction):
        if _is_surface(obj, matrix, scene, depsgraph, viewport):
            return Hit(obj, np.array(matrix.inverted_safe() @ world), np.array(world), np.array(normal), int(face))
    return None


def iter_ray_hits(scene: Any, depsgraph: Any, origin: Any, direction: Any) -> Iterator[tuple[Any, Any, int, Any, Any]]:
    """Yield (point, normal, face, object, its world matrix) of everything along a ray, the nearest first.

    Instances are included. At most MAX_RAY_HITS hits are returned.
    """
    from mathutils import Vector

    start, direction = Vector(origin), Vector(direction)
    for _ in range(MAX_RAY_HITS):
        is_hit, world, normal, face, obj, matrix = scene.ray_cast(depsgraph, start, direction)
        if not is_hit:
            return
        yield world, normal, face, obj.original, matrix
        start = world + direction * max((world - Vector(origin)).length * RAY_STEP_FRACTION, 1e-7)


def _cast_per_object(scene: Any, depsgraph: Any, viewport: Any, origin: Any, direction: Any) -> Hit | None:
    """Cast the ray of `cast_on_surface` object by object.

    Used in scenes with splat clouds: Blender's scene ray would visit a hundred thousand ellipsoids first.
    """
    nearest: Hit | None = None
    for obj in scene.objects:
        if obj.type != "MESH" or is_cloud(obj) or not obj.visible_get(view_layer=depsgraph.view_layer):
            continue
        evaluated = obj.evaluated_get(depsgraph)
        matrix = evaluated.matrix_world
        if len(evaluated.data.polygons) == 0 or not _is_surface(obj, matrix, scene, depsgraph, viewport):
            continue
        to_local = matrix.inverted_safe()
        is_hit, local, normal, face = evaluated.ray_cast(to_local @ origin, to_local.to_3x3() @ direction)
        world = matrix @ local
        if is_hit and (nearest is None or (world - origin).length < np.linalg.norm(nearest.world - np.array(origin))):
            world_normal = to_local.to_3x3().transposed() @ normal
            nearest = Hit(obj, np.array(local), np.array(world), np.array(world_normal.normalized()), int(face))
    return nearest


def _is_surface(obj: Any, matrix: Any, scene: Any, depsgraph: Any, viewport: Any) -> bool:
    """Return True if a hit object is a visible, solid mesh of the scene itself, not an instance of one."""
    if obj.type != "MESH" or obj.display_type in SEE_THROUGH_DISPLAY_TYPES or scene.objects.get(obj.name) != obj:
        return False
    if not obj.visible_get(view_layer=depsgraph.view_layer, viewport=viewport):
        return False
    object_matrix = np.array(obj.evaluated_get(depsgraph).matrix_world)
    return bool(np.allclose(object_matrix, np.array(matrix), rtol=1e-5, atol=1e-6))


def find_untouchable(scene: Any, depsgraph: Any, origin: Any, direction: Any) -> UntouchableObject | None:
    """Return the first object along a ray that is visible but cannot be touched, or None.

    Also None in scenes with splat clouds, where a ray is too slow.
    """
    if any(is_cloud(obj) for obj in scene.objects):
        return None
    for _, _, _, obj, matrix in iter_ray_hits(scene, depsgraph, origin, direction):
        if obj.display_type in SEE_THROUGH_DISPLAY_TYPES:
            continue
        instancer = _find_instancer(obj, matrix, depsgraph)
        if instancer is not None and (instancer != obj or obj.type == "MESH"):
            return UntouchableObject(str(instancer.name), is_instance=True)
        if obj.type != "MESH":  # Blender treats a text's mesh as an instance shown by the text itself
            return UntouchableObject(str(obj.name), is_instance=False)
    return None


def _find_instancer(obj: Any, matrix: Any, depsgraph: Any) -> Any:
    """Return the object that creates the instance of `obj` at world matrix `matrix`, or None if it is `obj` itself."""
    for instance in depsgraph.object_instances:
        if not instance.is_instance or instance.object.original != obj:
            continue
        if np.allclose(np.array(instance.matrix_world), np.array(matrix), rtol=1e-5, atol=1e-6):
            return instance.parent.original
    return None


def find_view_under_mouse(context: Any, event: Any) -> Any:
    """Return the 3D view area under the mouse, including its headers and sidebars, or None."""
    for area in context.window.screen.areas if context.window is not None else ():
        inside = area.x <= event.mouse_x < area.x + area.width and area.y <= event.mouse_y < area.y + area.height
        if inside and area.type == "VIEW_3D":
            return area
    return None


def find_region_under_mouse(context: Any, event: Any) -> Any:
    """Return the main region of the 3D view under the mouse; None if a sidebar or header covers it."""
    main_region = None
    for area in context.window.screen.areas if context.window is not None else ():
        for region in area.regions if area.type == "VIEW_3D" else ():
            inside = (
                region.x <= event.mouse_x < region.x + region.width
                and region.y <= event.mouse_y < region.y + region.height
            )
            if inside and region.type == "WINDOW":
                main_region = region
            elif inside and region.width > 1 and region.height > 1:
                return None
    return main_region


def pick_object(context: Any, x: int, y: int) -> tuple[Any, int] | None:
    """Return (object, material slot) of the surface at pixel (x, y) of the context's 3-D region, or None."""
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
    """Return (object, material slot) of the first surface along a ray, or None; see `cast_on_surface`."""
    hit = cast_on_surface(scene, depsgraph, viewport, origin, direction)
    if hit is None:
        return None
    mesh = hit.obj.evaluated_get(depsgraph).data
    slot = mesh.polygons[hit.face].material_index if 0 <= hit.face < len(mesh.polygons) else 0
    return hit.obj, min(slot, max(len(hit.obj.material_slots) - 1, 0))


def pick_surface(context: Any, area: Any, region: Any, at: tuple[float, float]) -> Any:
    """Return the Hit at a point `at` (x, y) [pixels] of a 3D view's region, or None."""
    from bpy_extras import view3d_utils

    return cast_on_surface(
        context.scene,
        context.evaluated_depsgraph_get(),
        area.spaces.active,
        view3d_utils.region_2d_to_origin_3d(region, region.data, at),
        view3d_utils.region_2d_to_vector_3d(region, region.data, at),
    )


def get_view_direction(region: Any, at: tuple[float, float]) -> Float:
    """Return the unit vector (3,) of the ray at a point `at` (x, y) [pixels] of a 3D view's region."""
    from bpy_extras import view3d_utils

    return np.array(view3d_utils.region_2d_to_vector_3d(region, region.data, at))


def explain_untouchable(context: Any, region: Any, at: tuple[float, float]) -> str:
    """Explain why the object at a point `at` (x, y) [pixels] of a region cannot be touched, and the remedy.

    Returns "" if nothing is visible there.
    """
    from bpy_extras import view3d_utils

    untouchable = find_untouchable(
        context.scene,
        context.evaluated_depsgraph_get(),
        view3d_utils.region_2d_to_origin_3d(region, region.data, at),
        view3d_utils.region_2d_to_vector_3d(region, region.data, at),
    )
    if untouchable is None:
        return ""
    if untouchable.is_instance:
        message = tr("'{name}' shows instances: select it, Object > Apply > Make Instances Real, then press again")
    else:
        message = tr("'{name}' is not a mesh: select it, Object > Convert > Mesh, then press again")
    return message.format(name=untouchable.name)


@dataclass(frozen=True)
class ContactPoint:
    """Point of contact on a surface.

    Attributes
    ----------
    point : (3,) array
        Position in the surface frame [m].
    axes : (2, 3) array
        Unit tangents: ∂p/∂u projected onto the face, and normal × that. Stroke directions and tactile maps use this
        frame.
    slot : int
        Material slot.
    token : int
        Palette index of the baked token, −1 if not baked.
    """

    point: Float
    axes: Float
    slot: int
    token: int


def find_contact_point(hit: Hit, depsgraph: Any, metres_per_unit: float) -> ContactPoint:
    """Return the contact point of a hit. Raises SceneError if its object is scaled to nothing."""
    evaluated = hit.obj.evaluated_get(depsgraph)
    mesh = evaluated.data
    rigid, stretch = compute_surface_frame(evaluated.matrix_world, metres_per_unit, f"object '{hit.obj.name}'")
    normal = rigid[:3, :3].T @ hit.normal
    length = float(np.linalg.norm(normal))
    normal = normal / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    corners, uv, slot, token = np.zeros((3, 3)), None, 0, -1
    if hit.face < len(mesh.polygons):  # a mesh subdivided on the GPU has more faces than this one
        face = mesh.polygons[hit.face]
        loops = list(face.loop_indices)[:3]
        corners = np.array([mesh.vertices[mesh.loops[loop].vertex_index].co for loop in loops]) @ stretch.T
        layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
        uv = None if layer is None else np.array([[layer.uv[loop].vector for loop in loops]], dtype=np.float64)
        slot, token = int(face.material_index), _read_face_token(mesh, hit.face)
    (along,), _ = compute_tangents(corners[None], uv, normal[None])
    return ContactPoint(stretch @ hit.local, np.stack([along, np.cross(normal, along)]), slot, token)


def _read_face_token(mesh: Any, face: int) -> int:
    """Return the palette index of the token baked on a face, −1 if there is none."""
    attribute = mesh.attributes.get(TOKEN_ATTRIBUTE)
    is_baked = attribute is not None and attribute.domain == "FACE" and attribute.data_type == "INT"
    return int(attribute.data[face].value) if is_baked else -1


def find_touched_material(obj: Any, depsgraph: Any, slot: int, token: int) -> MaterialFile:
    """Return the haptic material with which a slot of an object is felt.

    This is the baked material, unless another was chosen since; otherwise the user's choice; otherwise the library
    material that the slot's shader resembles most.

    Parameters
    ----------
    obj : bpy.types.Object
        Object to read.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    slot : int
        Material slot.
    token : int
        Palette index baked there, −1 if not baked.

    Returns
    -------
    MaterialFile

    Raises
    ------
    MaterialError
        If the chosen material is not in the library.
    FileError
        If the material's definition is damaged.
    """
    materials = get_materials(obj.evaluated_get(depsgraph), obj.evaluated_get(depsgraph).data)
    shader = materials[slot] if slot < len(materials) else None
    choice = get_artist_choice(shader) if shader is not None else ""
    if isinstance(choice, MaterialFile) and choice.field:
        return choice  # the bake stores only its token, not its field
    chosen = (
        with_library_defaults(choice) if isinstance(choice, MaterialFile) else get_material(choice) if choice else None
    )
    baked = _get_baked_material(obj, token)
    if baked is not None and (chosen is None or chosen.name == baked.name):
        return baked
    return from_library(chosen or _guess_material(obj, shader))


def _get_baked_material(obj: Any, token: int) -> MaterialFile | None:
    """Return the haptic material that a token's palette index of the bake stands for, or None if it is not baked."""
    tokens = read_tokens(obj.data) if token >= 0 else None
    if tokens is None or token >= len(tokens.palette):
        return None
    palette = tokens.palette
    known = np.ones(TOKEN_DIM, dtype=bool)
    return MaterialFile(
        palette.names[token],
        Token(palette.tokens[token], known),
        palette.mechanics[token],
        encoder=palette.encoder_id,
    )


def _guess_material(obj: Any, shader: Any) -> LibraryMaterial:
    """Return the library material that resembles a shader most, by its values, its names and those of its textures."""
    from .shader.closures import read_stated_appearance
    from .shader.images import list_texture_names

    appearance = Appearance() if shader is None else read_stated_appearance(shader)
    names = ["" if shader is None else shader.name, obj.name, obj.data.name]
    library = load_library()
    return expect_material(library, rank(library, appearance, names, image_names=list_texture_names(shader)))
