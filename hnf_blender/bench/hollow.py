"""What the Touch tab's Python takes when Blender draws it: every panel's poll and draw, into a hollow layout."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

SIDEBAR_PX = 340
VISIBLE_ROWS = 5
"""Lines of the list of strokes."""


class FakeLayout:
    """A UILayout, or the properties of a button, that takes everything and keeps nothing."""

    def __getattr__(self, _name: str) -> Any:
        return self._accept

    def __setattr__(self, _name: str, _value: Any) -> None:
        """Kept nowhere."""

    def _accept(self, *_values: Any, **_named: Any) -> FakeLayout:
        return self


@contextmanager
def register_tab() -> Iterator[None]:
    """As in a window: the tab's buttons and panels are registered (their poll() asks for each other), and changes are
    told of; the caller passes Blender's on to note_changes()."""
    import bpy

    from .. import ops, ui
    from ..props.listed import CHANGES

    rooms = () if hasattr(bpy.types, "HNF_PT_scene") else (ops, ui)
    for room in rooms:
        room.register()
    was_told, CHANGES.is_notified = CHANGES.is_notified, True
    try:
        yield
    finally:
        CHANGES.is_notified = was_told
        CHANGES.mark_changed()
        for room in reversed(rooms):
            room.unregister()


def draw_tab(scene: Any, layer: Any) -> int:
    """As Blender does when the sidebar is redrawn, with every panel open; how many panels were drawn."""
    import bpy

    from ..props.scene import list_cached_strokes
    from ..rooms import collect_classes
    from ..ui import MODULES
    from ..ui.stroke_list import HNF_UL_strokes

    context, layout = make_tab_context(scene, layer, SIDEBAR_PX), FakeLayout()
    panels = [
        each
        for each in collect_classes(f"{__package__.rpartition('.')[0]}.ui", MODULES)
        if issubclass(each, bpy.types.Panel) and (not hasattr(each, "poll") or each.poll(context))
    ]
    for each in panels:
        for name in ("draw_header", "draw"):
            if hasattr(each, name):
                getattr(each, name)(SimpleNamespace(layout=layout, bl_rna=each.bl_rna), context)
    listed: Any = SimpleNamespace(filter_name="", bitflag_filter_item=1)
    HNF_UL_strokes.filter_items(listed, context, scene, "objects")
    for index, obj in enumerate(list_cached_strokes(scene)[:VISIBLE_ROWS]):
        HNF_UL_strokes.draw_item(listed, context, layout, scene, obj, 0, scene.hnf, "stroke_index", index)
    return len(panels)


def make_tab_context(scene: Any, layer: Any, width_px: int) -> Any:
    """What a panel is given in a region of this width; outside a window bpy.context has no region."""
    import bpy

    context = bpy.context
    return SimpleNamespace(
        scene=scene,
        view_layer=layer,
        window_manager=context.window_manager,
        workspace=context.workspace,
        screen=context.screen,
        window=context.window,
        area=None,
        mode=context.mode,
        object=layer.objects.active,
        active_object=layer.objects.active,
        selected_objects=list(layer.objects.selected),
        region=SimpleNamespace(width=width_px),
        preferences=SimpleNamespace(addons=context.preferences.addons, system=SimpleNamespace(ui_scale=1.0)),
    )
