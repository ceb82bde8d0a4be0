"""All properties of the add-on may be overridden: a stroke linked from another file can be felt otherwise here."""

from __future__ import annotations

from typing import Any

import bpy

OVERRIDABLE = {"LIBRARY_OVERRIDABLE"}
"""For `override=`. Without it Blender takes a change on a library override and forgets it with the next load."""


def register_pointer(kind: Any, name: str, group: Any) -> None:
    """Register a group of properties and give it to a kind of datablock under a name: both, or neither."""
    bpy.utils.register_class(group)
    try:
        setattr(kind, name, bpy.props.PointerProperty(type=group, override=OVERRIDABLE))
    except Exception:
        bpy.utils.unregister_class(group)
        raise


def unregister_pointer(kind: Any, name: str, group: Any) -> None:
    """What give() did."""
    delattr(kind, name)
    bpy.utils.unregister_class(group)
