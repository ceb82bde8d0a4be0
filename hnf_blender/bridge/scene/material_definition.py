"""Haptic material definitions (`.hnf` files) stored on Blender materials.

The bytes of the file are kept in an ID property, so that the .blend needs no file next to it. A library material chosen
by hand (Material.hnf_touch.library) takes precedence over the definition.
"""

from __future__ import annotations

from typing import Any

from hnf_core.errors import SceneError
from hnf_core.material.hnf_file import MaterialFile, parse_hnf
from hnf_core.material.library import Appearance

from ... import compat
from ...props.material_settings import DEFINITION_NAME_PROPERTY, DEFINITION_PROPERTY
from .stored_data import set_property

PRINCIPLED_INPUTS = {
    "base_color": "Base Color",
    "roughness": "Roughness",
    "metallic": "Metallic",
    "sheen": "Sheen Weight",
    "transmission": "Transmission Weight",
}
"""Shading value → input of the Principled BSDF."""


def set_definition(material: Any, definition: MaterialFile) -> None:
    """Store a haptic definition on a Blender material, replacing an earlier one or a library material chosen by hand.

    Raises SceneError if the material is linked, or is a library override, which would lose it when the file is
    reloaded.
    """
    if not material.is_editable:
        raise SceneError(
            "it is linked from another file.",
            where=f"material '{material.name}'",
            remedy="Make it local.",
        )
    if material.override_library is not None:
        raise SceneError(
            "it is a library override, which keeps no definition.",
            where=f"material '{material.name}'",
            remedy="Make it local, or choose a material of the library.",
        )
    set_property(material, DEFINITION_PROPERTY, definition.to_bytes())
    set_property(material, DEFINITION_NAME_PROPERTY, definition.name)
    material.hnf_touch.library = ""
    material.update_tag()


def get_definition(material: Any) -> MaterialFile | None:
    """Return the haptic definition stored on a Blender material, or None.

    Raises FileError, naming the material, if the definition is damaged or was made by another encoder network.
    """
    data = material.get(DEFINITION_PROPERTY)
    if data is None:
        return None
    return parse_hnf(data if isinstance(data, bytes) else b"", f"material '{material.name}'")


def get_artist_choice(material: Any) -> str | MaterialFile:
    """Return the library name that the user chose for a material, else its stored haptic definition, else "".

    Raises FileError, naming the material, if the definition is damaged.
    """
    return material.hnf_touch.library or get_definition(material) or ""


def is_height_authored(material: Any) -> bool:
    """Return True if the user insists on the height of a material's relief; False for None."""
    return material is not None and bool(material.hnf_touch.height_as_authored)


def clear_definition(material: Any) -> None:
    """Remove the stored haptic definition from a Blender material."""
    for name in (DEFINITION_PROPERTY, DEFINITION_NAME_PROPERTY):
        if name in material:
            del material[name]


def assign_definition(obj: Any, slot: int, definition: MaterialFile) -> Any:
    """Assign a haptic definition to a slot of an object and return the slot's Blender material.

    An empty slot, or an object without slots, gets a new material with the definition's appearance. Raises SceneError
    if the object or its material is linked.
    """
    slots = obj.material_slots
    current = slots[slot].material if slot < len(slots) else None
    if current is not None:
        set_definition(current, definition)
        return current
    if not obj.is_editable or (slot >= len(slots) and not obj.data.is_editable):
        raise SceneError(
            "it is linked from another file.", where=f"object '{obj.name}'", remedy="Make it a library override first."
        )
    material = create_material(definition)
    if slot < len(slots):
        slots[slot].material = material
    else:
        obj.data.materials.append(material)
    return material


def create_material(definition: MaterialFile) -> Any:
    """Create a Blender material with a haptic definition, and with the shading values that belong to it."""
    import bpy

    material = bpy.data.materials.new(definition.name)
    set_appearance(material, definition.appearance)
    set_definition(material, definition)
    return material


def set_appearance(material: Any, appearance: Appearance) -> None:
    """Set the shading values that `appearance` knows on a material's Principled BSDF, and its viewport color."""
    compat.switch_nodes_on(material)
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for name, socket in PRINCIPLED_INPUTS.items():
        value = getattr(appearance, name)
        if value is not None:
            shader.inputs[socket].default_value = (*value, 1.0) if name == "base_color" else value
    if appearance.base_color is not None:
        material.diffuse_color = (*appearance.base_color, 1.0)
    material.roughness = 0.5 if appearance.roughness is None else appearance.roughness
    material.metallic = 0.0 if appearance.metallic is None else appearance.metallic
