"""A Graph Editor that shows one F-curve."""

from __future__ import annotations

from functools import partial
from typing import Any

from hnf_core.errors import HnfError

from .. import compat
from ..props.scene import find_index

GRAPH_AREA_SHARE = 0.38
"""Of the 3-D view's height, where an area must be split off for it."""
FLAT_RANGE_N = 0.05
"""A curve that varies by less is framed as a line without a scale..."""
FLAT_MARGIN_N = 1.5
"""... and gets this much above and below."""
LAYOUT_DELAY_S = 0.1
"""A new area has no size before the next redraw; only then can its curve be fitted in."""


def show_curve(context: Any, obj: Any, data_path: str, area: Any) -> None:
    """Show this F-curve of the active object alone, whole, in a Graph Editor of context's window: see graph_area()."""
    import bpy

    window = context.window
    for fcurve in compat.fcurves_of(obj):
        fcurve.hide, fcurve.select = fcurve.data_path != data_path, fcurve.data_path == data_path
    layer = context.view_layer
    if find_index(layer.objects, obj) >= 0:
        obj.select_set(True, view_layer=layer)
        layer.objects.active = obj
    space = area.spaces.active
    space.dopesheet.show_only_selected = True
    space.dopesheet.show_hidden = False
    space.use_normalization = False
    area.tag_redraw()
    fit = partial(_fit_view, window.screen.name, list(window.screen.areas).index(area), _is_flat(obj, data_path))
    bpy.app.timers.register(fit, first_interval=LAYOUT_DELAY_S)


def open_graph_editor(context: Any) -> Any:
    """The Graph Editor of context's window: the one there is, or one split off the largest 3-D view. Raises HnfError
    where there is none and none can be made; then every editor stays what it is."""
    import bpy

    window = context.window
    areas = window.screen.areas
    for area in areas:
        if area.ui_type == "FCURVES":
            return area
    if window.screen.show_fullscreen:  # Blender splits no area that fills its window
        raise HnfError(
            "the 3-D view fills the window, so there is no room for a Graph Editor.",
            remedy="Press Ctrl Space with the mouse over it (or Back to Previous at the top), then this button again.",
        )
    views = [area for area in areas if area.type == "VIEW_3D"] or list(areas)
    largest = max(views, key=lambda area: area.width * area.height)
    before = {area.as_pointer() for area in areas}
    with context.temp_override(window=window, area=largest):
        split = bpy.ops.screen.area_split(direction="HORIZONTAL", factor=GRAPH_AREA_SHARE)
    added = [area for area in window.screen.areas if area.as_pointer() not in before]
    if "FINISHED" not in split or not added:
        raise HnfError(
            "the 3-D view is too small to split a Graph Editor off it.", remedy="Open a Graph Editor, then press again."
        )
    area = min([*added, largest], key=lambda area: area.y)
    area.ui_type = "FCURVES"
    area.spaces.active.show_region_ui = False  # small as it is, the curve needs the room
    return area


def _is_flat(obj: Any, data_path: str) -> bool:
    curves = [curve for curve in compat.fcurves_of(obj) if curve.data_path == data_path]
    values = [point.co[1] for curve in curves for point in curve.keyframe_points]
    return bool(values) and max(values) - min(values) < FLAT_RANGE_N


def _fit_view(screen_name: str, area_index: int, flat: bool) -> None:
    """Timer, once: frame the whole curve, with room to drag a flat one."""
    import bpy

    for window in bpy.context.window_manager.windows:
        if window.screen.name != screen_name or area_index >= len(window.screen.areas):
            continue
        area = window.screen.areas[area_index]
        region = next((region for region in area.regions if region.type == "WINDOW"), None)
        if area.type == "GRAPH_EDITOR" and region is not None:
            with bpy.context.temp_override(window=window, area=area, region=region):
                _frame_all(flat)


def _frame_all(flat: bool) -> None:
    """At once, not smoothly: the second step starts where the first one ends."""
    import bpy

    preferences = bpy.context.preferences
    smooth, was_dirty = preferences.view.smooth_view, preferences.is_dirty
    try:
        preferences.view.smooth_view = 0
        bpy.ops.graph.view_all(include_handles=False)
        if flat:
            bpy.ops.view2d.zoom(deltax=0.0, deltay=-FLAT_MARGIN_N, use_cursor_init=False)
    finally:
        preferences.view.smooth_view, preferences.is_dirty = smooth, was_dirty
