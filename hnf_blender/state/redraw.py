"""Drawing the Touch tab or the 3-D views anew, in every window."""

from __future__ import annotations


def redraw_tab() -> None:
    """Mark the sidebars of all 3-D views to be drawn again; nothing without windows."""
    _tag_regions("UI")


def redraw_views() -> None:
    """Mark the 3-D views themselves, without their sidebars and headers."""
    _tag_regions("WINDOW")


def _tag_regions(kind: str) -> None:
    import bpy

    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == kind:
                        region.tag_redraw()
