"""Material.hnf_touch: the artist's own word on what a material feels like."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import bpy

from .overriding import OVERRIDABLE, register_pointer, unregister_pointer

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
