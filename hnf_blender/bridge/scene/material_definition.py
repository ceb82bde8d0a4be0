"""A Blender material that carries its own `.hnf` definition: what it feels like is said by the material itself.

The bytes of the file lie in an ID property, so that the .blend needs no file beside it. A library material chosen by
hand (Material.hnf_touch.library) goes before the definition; back to automatic forgets both.
"""

from __future__ import annotations

from typing import Any

from hnf_core.errors import SceneError
from hnf_core.material.hnf_file import MaterialFile, parse_hnf
from hnf_core.material.library import Appearance

from ... import compat
from ...props.material_settings import DEFINITION_NAME_PROPERTY, DEFINITION_PROPERTY
from .id_properties import set_property

PRINCIPLED_INPUTS = {
    "base_color": "Base Color",
    "roughness": "Roughness",
    "metallic": "Metallic",
    "sheen": "Sheen Weight",
    "transmission": "Transmission Weight",
}
"""Shading value → input of the Principled BSDF."""


def set_definition(material: Any, definition: MaterialFile) -> None:
    """Make definition what material feels like, in place of a choice made before. Raises SceneError where material is
    linked from another file, or a library override, which would forget it with the next load."""
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
    """The definition that material carries, or None. Raises FileError, naming the material, where it is damaged or
    belongs to another encoder."""
    data = material.get(DEFINITION_PROPERTY)
    if data is None:
        return None
    return parse_hnf(data if isinstance(data, bytes) else b"", f"material '{material.name}'")


def get_artist_choice(material: Any) -> str | MaterialFile:
    """What a Blender material itself says it feels like: the library material chosen by hand, else the definition that
    it carries, else "". Raises FileError, naming the material, where that definition is damaged."""
    return material.hnf_touch.library or get_definition(material) or ""


def clear_definition(material: Any) -> None:
    """Take the definition off again."""
    for each in (DEFINITION_PROPERTY, DEFINITION_NAME_PROPERTY):
        if each in material:
            del material[each]


def assign_definition(obj: Any, slot: int, definition: MaterialFile) -> Any:
    """Make definition what a slot of obj feels like; its Blender material. An empty slot, or an object without slots,
    gets a new material that looks like it too. Raises SceneError where the object or its material is linked."""
    slots = obj.material_slots
    held = slots[slot].material if slot < len(slots) else None
    if held is not None:
        set_definition(held, definition)
        return held
    if not obj.is_editable or (slot >= len(slots) and not obj.data.is_editable):
        raise SceneError(
            "it is linked from another file.", where=f"object '{obj.name}'", remedy="Make it a library override first."
        )
    made = create_material(definition)
    if slot < len(slots):
        slots[slot].material = made
    else:
        obj.data.materials.append(made)
    return made


def create_material(definition: MaterialFile) -> Any:
    """A Blender material that looks and feels like definition."""
    import bpy

    material = bpy.data.materials.new(definition.name)
    set_appearance(material, definition.appearance)
    set_definition(material, definition)
    return material


def set_appearance(material: Any, appearance: Appearance) -> None:
    """Set the known shading values on the material's Principled BSDF, and the viewport's colour."""
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
