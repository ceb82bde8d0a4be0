"""All properties of the add-on may be overridden: a stroke linked from another file can be felt otherwise here.

Material.hnf_touch: the artist's own word on what a material feels like.
"""

# No `from __future__ import annotations`: Blender reads these annotations as values.

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


DEFINITION_PROPERTY = "hnf_material"
"""ID property: the bytes of a `.hnf` file that the material carries. hnf_touch.library goes before it."""
DEFINITION_NAME_PROPERTY = "hnf_material_name"
"""ID property: the name in those bytes, for panels, which open no file."""


class HnfMaterial(bpy.types.PropertyGroup):  # type: ignore[misc]  # bpy has no types
    library: bpy.props.StringProperty(
        name="Feels like",
        description=(
            "Library material that you chose; no bake overwrites it. Empty: chosen automatically from the material's "
            "look"
        ),
        default="",
        override=OVERRIDABLE,
    )


def register() -> None:
    register_pointer(bpy.types.Material, "hnf_touch", HnfMaterial)


def unregister() -> None:
    unregister_pointer(bpy.types.Material, "hnf_touch", HnfMaterial)
