"""Drawing the Touch tab anew, in every window."""

from __future__ import annotations


def redraw_tab() -> None:
    """Mark the sidebars of all 3-D views to be drawn again; nothing without windows."""
    import bpy

    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()
