"""Property group Material.hnf_touch: the library material chosen for a Blender material, and its height's right.

Also here: registration of property groups, all of which allow library overrides, so that a linked stroke can be set
differently in this file.
"""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

OVERRIDABLE = {"LIBRARY_OVERRIDABLE"}
"""Value of `override=`; without it Blender loses a change to a library override when the file is loaded again."""


def register_pointer(kind: Any, name: str, group: Any) -> None:
    """Register a property group and attach it to a datablock type as `name`; undo the first if the second fails."""
    bpy.utils.register_class(group)
    try:
        setattr(kind, name, bpy.props.PointerProperty(type=group, override=OVERRIDABLE))
    except Exception:
        bpy.utils.unregister_class(group)
        raise


def unregister_pointer(kind: Any, name: str, group: Any) -> None:
    """Undo `register_pointer`."""
    delattr(kind, name)
    bpy.utils.unregister_class(group)


DEFINITION_PROPERTY = "hnf_material"
"""ID property with the bytes of a `.hnf` file that the material carries; `hnf_touch.library` takes precedence."""
DEFINITION_NAME_PROPERTY = "hnf_material_name"
"""ID property with the name in those bytes, so that panels need not read them."""


class HnfMaterial(bpy.types.PropertyGroup):  # type: ignore[misc]  # bpy has no types
    library: bpy.props.StringProperty(
        name="Feels Like",
        description=(
            "Library material that you chose; no bake overwrites it. Empty: chosen automatically from the material's "
            "look"
        ),
        default="",
        override=OVERRIDABLE,
    )
    height_as_authored: bpy.props.BoolProperty(
        name="Height as Authored",
        description=(
            "Feel the shader's relief as high as it is drawn, although no surface is known to be so high. Off: its "
            "shape is felt at the height of the material that it is taken for"
        ),
        default=False,
        override=OVERRIDABLE,
    )


def register() -> None:
    register_pointer(bpy.types.Material, "hnf_touch", HnfMaterial)


def unregister() -> None:
    unregister_pointer(bpy.types.Material, "hnf_touch", HnfMaterial)
