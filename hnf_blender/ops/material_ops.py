"""Operators of the Materials panel: suggest and choose library materials, and examine a point by a touch query.

A touch query asks what one point of a surface feels like.
"""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import HnfError

from ..bridge.scene.scene_names import find_object, get_scene_name
from ..jobs import manager
from ..props.scene_settings import get_active_stroke
from ..state.labels import format_time_left
from ..state.session_state import STATE, JobStatus, LastJob
from ..translations import tr
from .operator_base import ModalJob, fail_poll, get_surface_in_layer, poll_no_job, report_errors
from .stroke_ops import UNDOABLE, poll_editable_stroke

if TYPE_CHECKING:
    from hnf_core.touch_request import TouchQuery


ACRONYMS = {"Eva": "EVA"}
"""Words of display names that are written in capitals."""


@lru_cache(maxsize=1)
def list_library_items() -> tuple[tuple[str, str, str], ...]:
    """Return the library of haptic materials as menu items, grouped by category: "Wood ▸ Oak wood".

    Cached, because Blender keeps no reference to the strings of dynamic items.
    """
    from hnf_core.material.library import load_library  # Imported here, since enabling needs no library.

    materials = sorted((material.category, material.name, material.words) for material in load_library())
    return tuple(
        (name, f"{category.capitalize()} ▸ {format_display_name(name)}", "Also found as: " + ", ".join(search_words))
        for category, name, search_words in materials
    )


def get_library_items(_properties: Any, _context: Any) -> tuple[tuple[str, str, str], ...]:
    return list_library_items()


def format_display_name(name: str) -> str:
    """Format a library name: "oak-wood" → "Oak wood", "eva-foam" → "EVA foam"."""
    return " ".join(ACRONYMS.get(word, word) for word in name.replace("-", " ").capitalize().split(" "))


def find_material_object(context: Any) -> Any:
    """Return the object whose materials are shown, or None: the active mesh, else the surface of the active stroke."""
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
    """Return the materials in the object's slots, each once."""
    materials = {slot.material.name_full: slot.material for slot in obj.material_slots if slot.material is not None}
    return list(materials.values())


class HNF_OT_suggest(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types, Blender's naming
    bl_idname = "hnf.suggest"
    bl_label = "Suggest Materials"
    bl_description = (
        "Rank the library by the names, pictures and shader values of this object's materials, and by their relief "
        "if a place was examined. Renders nothing and chooses nothing"
    )
    bl_options = {"REGISTER"}  # Blender reads a set

    @classmethod
    def poll(cls, context: Any) -> bool:
        obj = find_material_object(context)
        if obj is None:
            return fail_poll(cls, "Select a mesh, or a stroke that has a surface")
        if not list_materials(obj):
            return fail_poll(cls, "This object has no material to suggest for")
        return True

    @report_errors(text=str)
    def execute(self, context: Any) -> set[str]:
        from hnf_core.material.library import load_library
        from hnf_core.material.ranking import rank
        from hnf_core.tactile.tactile_map import Route

        from ..bridge.shader.closures import read_stated_appearance
        from ..bridge.shader.images import list_texture_names

        obj = find_material_object(context)
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
        return {"FINISHED"}


class HNF_OT_material_choose(bpy.types.Operator):  # type: ignore[misc]
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
    name: bpy.props.EnumProperty(name="Feels Like", description="Material of the library", items=get_library_items)

    @classmethod
    def description(cls, _context: Any, properties: Any) -> str:
        """Return the tooltip of the button; for a suggested material with the reason of its rank."""
        ranked = STATE.suggestions.get(properties.material, ()) if properties.is_property_set("name") else ()
        reason = next((suggestion.reason for suggestion in ranked if suggestion.name == properties.name), "")
        text = tr(cls.bl_description)
        return f"{format_display_name(properties.name)}: {reason}. {text}" if reason else text

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if self.properties.is_property_set("name"):
            return self.execute(context)
        context.window_manager.invoke_search_popup(self)
        return {"INTERFACE"}  # With "RUNNING_MODAL", as in Blender's examples, the operator would never be freed.

    def execute(self, _context: Any) -> set[str]:
        return _assign_library_material(self, self.material, self.name)


class HNF_OT_material_auto(bpy.types.Operator):  # type: ignore[misc]
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


class HNF_OT_stroke_material(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_material"
    bl_label = "Choose for This Stroke"
    bl_description = "Choose what this stroke feels, whatever its surface looks like"
    bl_options = UNDOABLE
    bl_property = "name"

    name: bpy.props.EnumProperty(name="Feels Like", description="Material of the library", items=get_library_items)

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_editable_stroke(cls, context)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        context.window_manager.invoke_search_popup(self)
        return {"INTERFACE"}  # With "RUNNING_MODAL", as in Blender's examples, the operator would never be freed.

    def execute(self, context: Any) -> set[str]:
        get_active_stroke(context).hnf_stroke.material = self.name
        return {"FINISHED"}


class HNF_OT_stroke_material_auto(bpy.types.Operator):  # type: ignore[misc]
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
    """Return the Blender material with a full name (which includes a library's file), else with the name, or None.

    A linked material may have the name of a local one; scripts give the plain name.
    """
    return next(
        (material for material in bpy.data.materials if material.name_full == name), bpy.data.materials.get(name)
    )


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
        from ..bridge.scene.material_definition import clear_definition

        clear_definition(material)
    material.hnf_touch.library = library_name
    material.update_tag()
    STATE.dirty_names.add(material.name)
    return {"FINISHED"}


class HNF_OT_probe(ModalJob, bpy.types.Operator):  # type: ignore[misc]  # bpy has no types, Blender's naming
    """Touch query (what a point feels like): waits for a click, then runs the job.

    Without REGISTER, since redoing would run it again.
    """

    bl_idname = "hnf.probe"
    bl_label = "Examine a Place"
    bl_description = (
        "Click on a surface: its tactile map, roughness, friction and the closest materials are shown below. Nothing "
        "in the file changes; Esc cancels"
    )
    bl_options = frozenset[str]()  # Nothing changes, so there is nothing to redo or undo.

    surface: bpy.props.StringProperty(
        name="Surface", description="Object to examine; empty: click on one", options={"SKIP_SAVE"}
    )
    at: bpy.props.FloatVectorProperty(
        name="Place", description="In the object's own coordinates", size=3, options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not poll_no_job(cls):
            return False
        if context.mode != "OBJECT":
            return fail_poll(cls, "Surfaces are touched in Object Mode: choose it in the header")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..jobs.bake_job import query_blocking

        return self.run_blocking(lambda: query_blocking(context.scene, context.view_layer, self._get_point()))

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        if not self.surface:
            context.window.cursor_modal_set("EYEDROPPER")
            context.workspace.status_text_set(tr("Click on a surface to examine it.  Esc or right click: cancel"))
        elif not self._start(context, self._get_point()):
            return {"CANCELLED"}
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        return self._wait_for_click(context, event) if self._timer is None else super().modal(context, event)

    def _wait_for_click(self, context: Any, event: Any) -> set[str]:
        """Wait for a click on a surface; the view can be turned and other editors used meanwhile."""
        from ..bridge.viewport_pick import explain_untouchable, find_region_under_mouse
        from .pen import is_cancel_event

        if is_cancel_event(context, event):
            return self.finish(context, None)
        region = find_region_under_mouse(context, event)
        if event.type != "LEFTMOUSE" or event.value != "PRESS" or region is None:
            return {"PASS_THROUGH"}
        point = find_clicked_point(context, event)
        if point is None:
            reason = explain_untouchable(context, region, (event.mouse_x - region.x, event.mouse_y - region.y))
            self.report({"INFO"}, reason or tr("There is no surface under the mouse"))
            return {"RUNNING_MODAL"}
        context.window.cursor_modal_restore()
        return {"RUNNING_MODAL"} if self._start(context, point) else self.finish(context, None)

    def _start(self, context: Any, point: "TouchQuery") -> bool:
        return self.start_job(context, lambda: manager.start_bake(context.scene, context.view_layer, point=point))

    def _get_point(self) -> "TouchQuery":
        from hnf_core.touch_request import TouchQuery

        if not self.surface:
            raise HnfError("no place was named.", remedy="Give surface and at, or click on one in a window.")
        return TouchQuery(self.surface, tuple(float(value) for value in self.at))

    def format_status(self, job: JobStatus) -> str:
        return f"{tr('Examining a place')}: {format_time_left(job)}"

    def clean_up(self, context: Any) -> None:
        super().clean_up(context)
        if context.window is not None:
            context.window.cursor_modal_restore()

    def report_end(self, ended: LastJob) -> set[str]:
        self.report({"INFO"} if ended.ok else {"ERROR"}, ended.message)
        return {"FINISHED"} if ended.ok else {"CANCELLED"}


def find_clicked_point(context: Any, event: Any) -> "TouchQuery | None":
    """Return the point under the mouse in a 3D view, in the coordinates of its object; None if there is no surface."""
    from hnf_core.touch_request import TouchQuery

    from ..bridge.viewport_pick import find_region_under_mouse, pick_surface

    region = find_region_under_mouse(context, event)
    if region is None:
        return None
    area = next((area for area in context.window.screen.areas if region in tuple(area.regions)), None)
    position = (event.mouse_x - region.x, event.mouse_y - region.y)
    hit = None if area is None else pick_surface(context, area, region, position)
    return (
        None
        if hit is None
        else TouchQuery(get_scene_name(context.scene, hit.obj), tuple(float(value) for value in hit.local))
    )


CLASSES = (
    HNF_OT_suggest,
    HNF_OT_material_choose,
    HNF_OT_material_auto,
    HNF_OT_stroke_material,
    HNF_OT_stroke_material_auto,
    HNF_OT_probe,
)
