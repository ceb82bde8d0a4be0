"""What lies under the mouse in a 3-D view."""

from __future__ import annotations

from typing import Any

from .drawn_stroke import cast_on_surface
from .splat_cloud import is_cloud


def object_under(context: Any, x: int, y: int) -> tuple[Any, int] | None:
    """(object, material slot) that the ray through pixel (x, y) of context's 3-D region meets first, or None."""
    from bpy_extras import view3d_utils

    region, view = context.region, context.region_data
    if region is None or view is None:
        return None
    origin = view3d_utils.region_2d_to_origin_3d(region, view, (x, y))
    direction = view3d_utils.region_2d_to_vector_3d(region, view, (x, y))
    return first_hit(context.scene, context.evaluated_depsgraph_get(), origin, direction)


def first_hit(scene: Any, depsgraph: Any, origin: Any, direction: Any) -> tuple[Any, int] | None:
    """(object, material slot) of the first visible face on a ray (scene units), or None."""
    hit, _, _, face, obj, _ = scene.ray_cast(depsgraph, origin, direction)
    if not hit:
        return None
    if is_cloud(obj.original):  # an ellipsoid: what it stands before is meant
        met = cast_on_surface(scene, depsgraph, None, origin, direction)
        if met is None:
            return None
        obj, face = met.obj, met.face
    mesh = obj.evaluated_get(depsgraph).data
    slot = mesh.polygons[face].material_index if 0 <= face < len(mesh.polygons) else 0
    return obj, min(slot, max(len(obj.material_slots) - 1, 0))
