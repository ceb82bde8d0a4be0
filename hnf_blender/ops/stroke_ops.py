"""Operators on complete strokes: add, convert from and to a curve, duplicate, delete, select, solo."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.action.primitives import PRIMITIVES, Primitive
from hnf_core.errors import HnfError, SceneError

from ..bridge.scene.object_size import get_metres_per_unit
from ..compat import own_action
from ..props.object_cache import CHANGES, ChangeCache
from ..props.scene_settings import (
    find_index,
    find_stroke,
    get_active_stroke,
    has_strokes,
    list_cached_strokes,
    list_strokes,
)
from ..state.labels import wrap_text
from ..translations import tr
from .draw_ops import PROBE_ITEMS
from .operator_base import (
    DEFAULT_PROBE,
    fail_poll,
    format_error,
    get_surface_in_layer,
    make_active,
    make_active_and_visible,
    report_errors,
    resolve_probe,
)

UNDOABLE = {"REGISTER", "UNDO"}
"""Options of operators that can be redone and undone."""
LINKED_REASON = "It is linked from another file: make it local or override it (Object > Library Override)"
NOT_SELECTED_REASON = "No stroke is selected: click one in the Touch tab, or draw one with the stroke tool"


def describe_primitive(primitive: Primitive) -> str:
    """Describe a primitive (predefined stroke) for its tooltip: "Scrape at 0.5 N and 100 mm/s"."""
    return f"{primitive.kind.capitalize()} at {primitive.force:g} N and {primitive.speed * 1e3:g} mm/s"


PRIMITIVE_ITEMS = [
    (name, name.replace("-", " ").title(), describe_primitive(primitive)) for name, primitive in PRIMITIVES.items()
]


DIALOG_PX, LINE_CHARACTERS = 480, 64
"""Width of the dialog for words [px], and of a line of text in it [characters]."""


def describe_words(words: str) -> tuple[str, str]:
    """Return an icon, and what was understood of a stroke in words, or why it was not."""
    from hnf_core.action.parse_stroke import parse_stroke

    if not words.strip():
        return "INFO", tr("For example: {words}").format(words="tap twice, then rub slowly in circles, 1 N")
    try:
        name = parse_stroke(words).name
    except HnfError as error:
        return "ERROR", format_error(error)
    return "CHECKMARK", name.replace("mm-s", "mm/s").replace("-then-", ", then ").replace("-", " ")


def find_surface_for_new_stroke(context: Any) -> Any:
    """Return the mesh object for a new stroke, or None.

    It is the active or a selected mesh, else the surface of the active stroke, else the only visible mesh.
    """
    active = context.view_layer.objects.active
    selected = [obj for obj in context.view_layer.objects.selected if obj.type == "MESH"]
    if active is not None and active.type == "MESH" and (active in selected or not selected):
        return active
    if selected:
        return selected[0]
    stroke = get_active_stroke(context)
    surface = None if stroke is None else get_surface_in_layer(context, stroke)
    if surface is not None:
        return surface
    visible = [obj for obj in context.view_layer.objects if obj.type == "MESH" and obj.visible_get()]
    return visible[0] if len(visible) == 1 else None


def poll_object_mode(cls: Any, context: Any) -> bool:
    """Return whether Blender is in Object Mode; for poll(), with the reason if not."""
    if context.mode != "OBJECT":
        return fail_poll(cls, "Strokes are made in Object Mode: choose it in the header")
    return True


def poll_active_stroke(cls: Any, context: Any) -> bool:
    """Return whether there is an active stroke; for poll(), with the reason if not."""
    if get_active_stroke(context) is None:
        return fail_poll(cls, NOT_SELECTED_REASON)
    return True


def poll_editable_stroke(cls: Any, context: Any) -> bool:
    """Return whether the active stroke can be changed; for poll(), with the reason if not.

    Blender accepts a change to a linked stroke, but loses it when the file is loaded again.
    """
    if not poll_active_stroke(cls, context):
        return False
    if not get_active_stroke(context).is_editable:
        return fail_poll(cls, LINKED_REASON)
    return True


class HNF_OT_stroke_add(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types, Blender's naming
    bl_idname = "hnf.stroke_add"
    bl_label = "Add Touch Stroke"
    bl_description = "Lay a ready stroke on the selected mesh, where it is flat, free and large enough"
    bl_options = UNDOABLE

    primitive: bpy.props.EnumProperty(
        name="Stroke", description="Kind of motion, force in newtons and speed", items=PRIMITIVE_ITEMS
    )
    words: bpy.props.StringProperty(
        name="In Words",
        description="Instead of a ready one: 'scrape right to left, 1.5 N, 80 mm/s', 'tap twice, then rub in circles'",
        options={"SKIP_SAVE"},
    )
    dialog: bpy.props.BoolProperty(
        name="Dialog", description="Ask for the words in a dialog", default=False, options={"HIDDEN", "SKIP_SAVE"}
    )
    slot: bpy.props.IntProperty(
        name="Material Slot",
        description="Slot that is touched, counted from 0; -1 takes the one that covers the most",
        default=-1,
        min=-1,
    )
    seed: bpy.props.IntProperty(
        name="Seed", description="The same seed gives the same wandering and the same signal", default=0, min=0
    )
    probe: bpy.props.EnumProperty(
        name="Probe", description="What touches the surface", items=PROBE_ITEMS, default=DEFAULT_PROBE
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not poll_object_mode(cls, context):
            return False
        if find_surface_for_new_stroke(context) is None:
            return fail_poll(cls, "Select the mesh object to touch")
        return True

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if not self.dialog:
            return self.execute(context)
        return set(context.window_manager.invoke_props_dialog(self, width=DIALOG_PX))

    def draw(self, _context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        if not self.dialog:
            layout.prop(self, "primitive")
        layout.prop(self, "words")
        if self.dialog or self.words.strip():
            icon, text = describe_words(str(self.words))
            column = layout.column(align=True)
            column.scale_y = 0.8
            for index, line in enumerate(wrap_text(text, LINE_CHARACTERS)):
                column.label(text=line, icon="BLANK1" if index else icon, translate=False)
        for name in ("slot", "seed", "probe"):
            layout.prop(self, name)

    def execute(self, context: Any) -> set[str]:
        from hnf_core.action.parse_stroke import parse_stroke

        from ..bridge.stroke.new_stroke import link_to_collection
        from ..bridge.stroke.place_primitive import place_primitive

        scene, surface = context.scene, find_surface_for_new_stroke(context)
        if self.slot >= max(1, len(surface.material_slots)):
            template = tr("'{name}' has no material slot {slot}; the first is 0")
            self.report({"ERROR"}, template.format(name=surface.name, slot=self.slot))
            return {"CANCELLED"}
        if self.dialog and not self.words.strip():
            self.report({"ERROR"}, tr("Say a stroke in words, e.g. 'rub slowly in circles'"))
            return {"CANCELLED"}
        window = context.window
        if window is not None:
            window.cursor_modal_set("WAIT")  # The search for a location takes a second on a dense mesh.
        try:
            placed = place_primitive(
                scene,
                surface,
                None if self.slot < 0 else int(self.slot),
                parse_stroke(self.words) if self.words.strip() else str(self.primitive),
                get_metres_per_unit(scene),
                context.evaluated_depsgraph_get(),
                seed=int(self.seed),
                start_frame=float(scene.frame_current_final),
            )
        except HnfError as error:
            self.report({"ERROR"}, format_error(error))
            return {"CANCELLED"}
        finally:
            if window is not None:
                window.cursor_modal_restore()
        link_to_collection(placed.curve, scene)
        placed.curve.hnf_stroke.probe = resolve_probe(context, str(self.probe))
        visibility_note = make_active_and_visible(context, placed.curve)
        self.report({"INFO"}, f"{placed.curve.name}: {placed.size_m * 1e3:.0f} mm{visibility_note}")
        return {"FINISHED"}


class HNF_OT_stroke_from_curve(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_from_curve"
    bl_label = "Make Curve a Touch Stroke"
    bl_description = "Turn every selected curve into a stroke that begins at the current frame"
    bl_options = UNDOABLE

    speed_mm_s: bpy.props.FloatProperty(
        name="Speed", description="Millimeters per second", default=100.0, min=0.1, max=10_000.0, soft_max=500.0
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not poll_object_mode(cls, context):
            return False
        selected = context.view_layer.objects.selected
        if any(obj.type == "CURVE" and not obj.is_editable for obj in selected):
            return fail_poll(cls, LINKED_REASON)
        if not list_convertible_curves(context):
            return fail_poll(cls, "Select a curve that is not a stroke yet")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..bridge.stroke.read_stroke import read_curve

        strokes = []
        for obj in list_convertible_curves(context):
            try:
                read_curve(obj)
            except HnfError as error:
                self.report({"WARNING"}, format_error(error))
                continue
            group = obj.hnf_stroke
            group.is_stroke, group.was_curve = True, True
            group.law, group.speed_mm_s = "SPEED", self.speed_mm_s
            group.start, group.probe = float(context.scene.frame_current_final), resolve_probe(context, DEFAULT_PROBE)
            strokes.append(obj)
        CHANGES.mark_changed()  # Blender reports no change, since no object is new.
        if not strokes:
            return {"CANCELLED"}
        active = context.view_layer.objects.active
        context.view_layer.objects.active = active if active in strokes else strokes[0]
        context.scene.hnf.stroke_index = max(0, find_index(context.scene.objects, context.view_layer.objects.active))
        self.report({"INFO"}, tr("Strokes: {names}").format(names=", ".join(obj.name for obj in strokes)))
        return {"FINISHED"}


def list_convertible_curves(context: Any) -> list[Any]:
    """Return the selected curve objects that can become strokes."""
    selected = context.view_layer.objects.selected
    return [obj for obj in selected if obj.type == "CURVE" and obj.is_editable and not obj.hnf_stroke.is_stroke]


class StrokeOperator:
    """Mixin of operators that work on the named stroke, or else on the active one."""

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not has_strokes(context.scene):
            return fail_poll(cls, "There is no stroke yet: draw one with the stroke tool")
        return True

    @report_errors()
    def execute(self, context: Any) -> set[str]:
        named = find_stroke(context.scene, self.name) if self.name else None  # type: ignore[attr-defined]
        stroke = get_active_stroke(context) if named is None else named
        if stroke is None:
            self.report({"ERROR"}, tr(NOT_SELECTED_REASON))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        self.report({"INFO"}, self.work(context, stroke))  # type: ignore[attr-defined]
        return {"FINISHED"}


class StrokeObjectOperator(StrokeOperator):
    """Mixin of stroke operators that add or remove objects, which would disturb Edit Mode."""

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_object_mode(cls, context) and super().poll(context)


NAME_PROPERTY = {
    "name": "Name",
    "description": "Stroke object; empty: the active one",
    "options": {"HIDDEN", "SKIP_SAVE"},
}


class HNF_OT_stroke_delete(StrokeObjectOperator, bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_delete"
    bl_label = "Delete Stroke"
    bl_description = (
        "Delete this stroke with its curve and keyframes. A curve that you made yourself becomes a plain curve again"
    )
    bl_options = UNDOABLE

    name: bpy.props.StringProperty(**NAME_PROPERTY)

    def work(self, context: Any, stroke: Any) -> str:
        scene = context.scene
        name = stroke.name
        require_local(stroke, "Delete it in that file, or unlink its collection in the Outliner. Nothing was deleted.")
        if stroke.hnf_stroke.was_curve:
            return convert_to_curve(stroke)
        delete_stroke(scene, stroke)
        return tr("Deleted {name}").format(name=name)


def delete_stroke(scene: Any, stroke: Any) -> None:
    """Delete a stroke with its curve and keyframes, and select the next one in the list."""
    strokes, curve = list_strokes(scene), stroke.data
    index = strokes.index(stroke)
    remaining = [candidate for candidate in strokes if candidate != stroke]
    animation = stroke.animation_data
    action = None if animation is None else animation.action
    bpy.data.objects.remove(stroke)
    for data, collection in ((curve, bpy.data.curves), (action, bpy.data.actions)):
        if data is not None and data.users == 0:
            collection.remove(data)
    if remaining:
        scene.hnf.stroke_index = max(0, find_index(scene.objects, remaining[min(index, len(remaining) - 1)]))


def list_orphans(scene: Any) -> list[Any]:
    """Return the strokes whose chosen surface was deleted from the scene: their settings alone keep it in the file."""
    surfaces = ((obj, obj.hnf_stroke.surface) for obj in list_cached_strokes(scene))
    return [obj for obj, surface in surfaces if surface is not None and find_index(scene.objects, surface) < 0]


ORPHANS = ChangeCache()
"""Number of a scene's orphans, which a panel asks for at each redraw."""


def count_orphans(scene: Any) -> int:
    """Return the number of strokes whose surface was deleted, from the cache."""
    return int(ORPHANS.get(scene.session_uid, lambda: len(list_orphans(scene))))


class HNF_OT_strokes_delete_orphans(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.strokes_delete_orphans"
    bl_label = "Delete Orphaned Strokes"
    bl_description = "Delete all strokes whose surface was deleted from the scene; your own curves become plain ones"
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not poll_object_mode(cls, context):
            return False
        if not count_orphans(context.scene):
            return fail_poll(cls, "Every stroke still has its surface")
        return True

    def invoke(self, context: Any, event: Any) -> set[str]:
        names = ", ".join(obj.name for obj in list_orphans(context.scene))
        return set(
            context.window_manager.invoke_confirm(
                self, event, title=tr("Delete Orphaned Strokes"), message=names, confirm_text=tr("Delete")
            )
        )

    def execute(self, context: Any) -> set[str]:
        orphans = list_orphans(context.scene)
        linked = [obj.name for obj in orphans if obj.library is not None]
        names = [obj.name for obj in orphans if obj.library is None]
        for obj in (obj for obj in orphans if obj.name in names):
            if obj.hnf_stroke.was_curve:
                convert_to_curve(obj)
            else:
                delete_stroke(context.scene, obj)
        CHANGES.mark_changed()
        if linked:
            template = tr("Linked and not changed: {names}")
            self.report({"WARNING"}, template.format(names=", ".join(linked)))
        if not names:
            return {"CANCELLED"}
        self.report({"INFO"}, tr("Deleted {name}").format(name=", ".join(names)))
        return {"FINISHED"}


class HNF_OT_stroke_to_curve(StrokeObjectOperator, bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_to_curve"
    bl_label = "Back to a Plain Curve"
    bl_description = "Turn the stroke back into a plain curve: removes its bake, keeps its keyframes"
    bl_options = UNDOABLE

    name: bpy.props.StringProperty(**NAME_PROPERTY)

    def work(self, _context: Any, stroke: Any) -> str:
        require_local(stroke, "Make it local or override it (Object > Library Override).")
        return convert_to_curve(stroke)


def require_local(stroke: Any, remedy: str) -> None:
    """Raise SceneError if the stroke is linked from another file."""
    if stroke.library is not None:
        raise SceneError(f"it is linked from {stroke.library.name}.", where=f"stroke '{stroke.name}'", remedy=remedy)


def convert_to_curve(stroke: Any) -> str:
    """Turn a stroke into a plain curve object and return a message for the user."""
    from ..touch.bake_storage import clear_bake

    clear_bake(stroke)
    stroke.hnf_stroke.is_stroke = stroke.hnf_stroke.was_curve = False
    return tr("'{name}' is a plain curve again").format(name=stroke.name)


class HNF_OT_stroke_duplicate(StrokeObjectOperator, bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_duplicate"
    bl_label = "Duplicate Stroke"
    bl_description = "A second stroke like this one, with a curve and keyframes of its own"
    bl_options = UNDOABLE

    name: bpy.props.StringProperty(**NAME_PROPERTY)

    def work(self, context: Any, stroke: Any) -> str:
        copy = stroke.copy()
        copy.data = stroke.data.copy()
        copy.hnf_stroke.was_curve = False
        own_action(copy)
        for collection in stroke.users_collection:
            if collection.library is None:
                collection.objects.link(copy)
        if not copy.users_collection:
            context.scene.collection.objects.link(copy)
        context.view_layer.update()
        make_active(context, copy)
        return tr("{copy} is a copy of {name}").format(copy=copy.name, name=stroke.name)


class HNF_OT_stroke_select(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_select"
    bl_label = "Select Stroke"
    bl_description = "Select this stroke in the scene. Shift: add it to what is selected"
    bl_options = UNDOABLE

    name: bpy.props.StringProperty(name="Name", description="Stroke object", options={"HIDDEN", "SKIP_SAVE"})
    extend: bpy.props.BoolProperty(
        name="Extend", description="Keep what is selected", default=False, options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_object_mode(cls, context)

    def invoke(self, context: Any, event: Any) -> set[str]:
        self.extend = bool(event.shift)
        return self.execute(context)

    def execute(self, context: Any) -> set[str]:
        stroke = find_stroke(context.scene, self.name)
        if stroke is None:
            self.report({"ERROR"}, tr("There is no stroke '{name}' in this scene").format(name=self.name))
            return {"CANCELLED"}
        if find_index(context.view_layer.objects, stroke) < 0 or not stroke.visible_get():
            self.report({"WARNING"}, tr("'{name}' is hidden in this view layer").format(name=stroke.name))
        if self.extend:
            previous_selection = [obj for obj in context.view_layer.objects.selected if obj != stroke]
        make_active(context, stroke)
        for obj in previous_selection if self.extend else ():
            obj.select_set(True)
        return {"FINISHED"}


class HNF_OT_stroke_solo(StrokeOperator, bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_solo"
    bl_label = "Solo"
    bl_description = "Mute all other strokes of the scene; click again to hear them all"
    bl_options = UNDOABLE

    name: bpy.props.StringProperty(**NAME_PROPERTY)

    def work(self, context: Any, stroke: Any) -> str:
        strokes = list_strokes(context.scene)
        editable_strokes = [candidate for candidate in strokes if candidate.is_editable]
        other_mutes = [candidate.hnf_stroke.mute for candidate in editable_strokes if candidate != stroke]
        was_solo = not stroke.hnf_stroke.mute and bool(other_mutes) and all(other_mutes)
        for candidate in editable_strokes:
            candidate.hnf_stroke.mute = candidate != stroke and not was_solo
        message = tr("All strokes") if was_solo else tr("Only {name}").format(name=stroke.name)
        unchanged = [
            candidate.name
            for candidate in strokes
            if candidate.hnf_stroke.mute != (candidate != stroke and not was_solo)
        ]
        if not unchanged:
            return message
        return f"{message}. {tr('Linked and not changed: {names}').format(names=', '.join(unchanged))}"


CLASSES = (
    HNF_OT_stroke_add,
    HNF_OT_stroke_from_curve,
    HNF_OT_stroke_delete,
    HNF_OT_strokes_delete_orphans,
    HNF_OT_stroke_to_curve,
    HNF_OT_stroke_duplicate,
    HNF_OT_stroke_select,
    HNF_OT_stroke_solo,
)
