"""What a Blender material feels like: suggestions, the artist's own choice, and back to automatic."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from functools import lru_cache
from typing import Any

import bpy

from hnf_core.errors import HnfError

from ..bridge.scene_names import find_object
from ..props.scene import get_active_stroke
from ..state.session import STATE
from ..translations import tr
from .active import get_surface_in_layer
from .greyed import fail_poll
from .strokes import UNDOABLE, poll_editable_stroke

ACRONYMS = {"Eva": "EVA"}


@lru_cache(maxsize=1)
def list_library_items() -> tuple[tuple[str, str, str], ...]:
    """The library as a list to search, grouped by category: "Wood ▸ Oak wood". Kept, for Blender keeps no texts."""
    from hnf_core.material.library import load_library  # here: switching the add-on on needs no library

    shown = sorted((material.category, material.name, material.words) for material in load_library())
    return tuple(
        (name, f"{category.capitalize()} ▸ {format_display_name(name)}", "Also found as: " + ", ".join(words))
        for category, name, words in shown
    )


def get_library_items(_properties: Any, _context: Any) -> tuple[tuple[str, str, str], ...]:
    return list_library_items()


def format_display_name(name: str) -> str:
    """A library name for people: "oak-wood" → "Oak wood", "eva-foam" → "EVA foam"."""
    return " ".join(ACRONYMS.get(word, word) for word in name.replace("-", " ").capitalize().split(" "))


def find_material_object(context: Any) -> Any:
    """The object whose materials are meant, or None: the active mesh, else the surface of the active stroke."""
    active = context.view_layer.objects.active
    if active is not None and active.type == "MESH":
        return active
    stroke = get_active_stroke(context)
    if stroke is None:
        return None
    if stroke.hnf_stroke.surface is not None:
        return get_surface_in_layer(context, stroke)
    status = STATE.get_status(context.scene, stroke)
    return None if status is None else find_object(context.scene, status.object_name)


def list_materials(obj: Any) -> list[Any]:
    """The materials in the object's slots, each once."""
    found = {slot.material.name_full: slot.material for slot in obj.material_slots if slot.material is not None}
    return list(found.values())


class HNF_OT_suggest(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    bl_idname = "hnf.suggest"
    bl_label = "Suggest Materials"
    bl_description = (
        "Rank the library by the names, pictures and shader values of this object's materials, and by their relief "
        "if a place was examined. Renders nothing and chooses nothing"
    )
    bl_options = {"REGISTER"}  # noqa: RUF012  # Blender reads a set

    @classmethod
    def poll(cls, context: Any) -> bool:
        obj = find_material_object(context)
        if obj is None:
            return fail_poll(cls, "Select a mesh, or a stroke that has a surface")
        if not list_materials(obj):
            return fail_poll(cls, "This object has no material to suggest for")
        return True

    def execute(self, context: Any) -> set[str]:
        from hnf_core.material.library import load_library
        from hnf_core.material.prior import rank
        from hnf_core.tactile.tactile_map import Route

        from ..bridge.picture_names import list_texture_names
        from ..bridge.shader_values import read_stated_appearance

        obj = find_material_object(context)
        try:
            for material in list_materials(obj):
                relief = STATE.reliefs.get(material.name_full)
                STATE.suggestions[material.name_full] = rank(
                    load_library(),
                    read_stated_appearance(material),
                    [material.name, obj.name, obj.data.name],
                    image_names=list_texture_names(material),
                    token=None if relief is None else relief.token,
                    route=Route.PRIOR if relief is None else relief.route,
                )
        except HnfError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class HNF_OT_material_choose(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.material_choose"
    bl_label = "Choose What It Feels Like"
    bl_description = "Choose what this material feels like. The choice is locked: no bake overwrites it"
    bl_options = UNDOABLE
    bl_property = "name"

    material: bpy.props.StringProperty(
        name="Material",
        description="Full name of the Blender material, to tell linked ones from those of this file",
        options={"HIDDEN"},
    )
    name: bpy.props.EnumProperty(name="Feels like", description="Material of the library", items=get_library_items)

    @classmethod
    def description(cls, _context: Any, properties: Any) -> str:
        """The tooltip: of a suggestion, why it was suggested."""
        ranked = STATE.suggestions.get(properties.material, ()) if properties.is_property_set("name") else ()
        why = next((each.reason for each in ranked if each.name == properties.name), "")
        text = tr(cls.bl_description)
        return f"{format_display_name(properties.name)}: {why}. {text}" if why else text

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if self.properties.is_property_set("name"):
            return self.execute(context)
        context.window_manager.invoke_search_popup(self)
        return {"INTERFACE"}  # "RUNNING_MODAL", as in Blender's examples, would never free the operator

    def execute(self, _context: Any) -> set[str]:
        return _assign_library_material(self, self.material, self.name)


class HNF_OT_material_auto(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.material_auto"
    bl_label = "Back to Automatic"
    bl_description = "Forget your choice: the look of the material decides again"
    bl_options = UNDOABLE

    material: bpy.props.StringProperty(
        name="Material",
        description="Full name of the Blender material, to tell linked ones from those of this file",
        options={"HIDDEN"},
    )

    def execute(self, _context: Any) -> set[str]:
        return _assign_library_material(self, self.material, "")


class HNF_OT_stroke_material(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.stroke_material"
    bl_label = "Choose for This Stroke"
    bl_description = "Choose what this stroke feels, whatever its surface looks like"
    bl_options = UNDOABLE
    bl_property = "name"

    name: bpy.props.EnumProperty(name="Feels like", description="Material of the library", items=get_library_items)

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_editable_stroke(cls, context)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        context.window_manager.invoke_search_popup(self)
        return {"INTERFACE"}  # "RUNNING_MODAL", as in Blender's examples, would never free the operator

    def execute(self, context: Any) -> set[str]:
        get_active_stroke(context).hnf_stroke.material = self.name
        return {"FINISHED"}


class HNF_OT_stroke_material_auto(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.stroke_material_auto"
    bl_label = "Feel the Surface Material"
    bl_description = "Forget the stroke's own material: it feels its surface's material again"
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_editable_stroke(cls, context)

    def execute(self, context: Any) -> set[str]:
        get_active_stroke(context).hnf_stroke.material = ""
        return {"FINISHED"}


def _find_material(name: str) -> Any:
    """The material of this full name, since a linked one may be called like one of this file; else of this name, as
    scripts give it; else None."""
    return next((each for each in bpy.data.materials if each.name_full == name), bpy.data.materials.get(name))


def _assign_library_material(operator: Any, material_name: str, library_name: str) -> set[str]:
    material = _find_material(material_name)
    if material is None:
        operator.report({"ERROR"}, tr("There is no material '{name}' in this file").format(name=material_name))
        return {"CANCELLED"}
    if not material.is_editable:
        operator.report(
            {"ERROR"},
            tr("Material '{name}' is linked from another file. Make it local or a library override").format(
                name=material_name
            ),
        )
        return {"CANCELLED"}
    if not library_name:
        from ..bridge.own_material import clear_definition

        clear_definition(material)
    material.hnf_touch.library = library_name
    material.update_tag()
    STATE.dirty_names.add(material.name)
    return {"FINISHED"}


MATERIAL_CLASSES = (
    HNF_OT_suggest,
    HNF_OT_material_choose,
    HNF_OT_material_auto,
    HNF_OT_stroke_material,
    HNF_OT_stroke_material_auto,
)
