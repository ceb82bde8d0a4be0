"""What lies under the mouse in a 3-D view."""

from __future__ import annotations

from typing import Any

from ..translations import tr
from .drawn_stroke import cast_on_surface


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

    from .untouchable import find_untouchable

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
