"""Operators that draw strokes on surfaces in the 3D view with a mouse or pen, and activate the stroke tool."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy
import numpy as np

from hnf_core.errors import HnfError, SceneError
from hnf_core.material.probe import PROBE_NAMES
from hnf_core.units import m_to_mm, mm_to_m

from ..bridge.scene.object_size import get_metres_per_unit
from ..props.stroke_settings import FORCE_MAX_N
from ..translations import tr
from .operator_base import DEFAULT_PROBE, fail_poll, format_error, make_active_and_visible, report_errors, resolve_probe

PROBE_ITEMS = [
    (DEFAULT_PROBE, "Default", "The default probe set in the preferences"),
    *((name, name.replace("-", " ").title(), f"Touch with the {name}") for name in PROBE_NAMES),
]
TIMING_ITEMS = (
    ("HAND", "As Drawn", "The stroke takes as long as your hand did: its timing becomes progress keys"),
    ("SPEED", "Constant", "One speed from end to end, however fast you draw; change it later under Time and Seed"),
)


class HnfPenSample(bpy.types.PropertyGroup):  # type: ignore[misc]  # bpy has no types
    """Sample of the pen as an operator property; Python callers give every field.

    `name` is the object under the pen; where it is empty, that is the operator's surface.
    """

    location: bpy.props.FloatVectorProperty(name="Location", description="In world coordinates", size=3)
    pressure: bpy.props.FloatProperty(name="Pressure", description="0 to 1; 1 throughout means a mouse", default=1.0)
    time: bpy.props.FloatProperty(name="Time", description="Seconds since the first sample")
    touching: bpy.props.BoolProperty(name="Touching", description="On the surface", default=True)


class HNF_OT_stroke_draw(bpy.types.Operator):  # type: ignore[misc]  # Blender's naming
    bl_idname = "hnf.stroke_draw"
    bl_label = "Draw Touch Stroke"
    bl_description = (
        "Press on a surface and drag, over neighboring ones too. Pen pressure becomes force in newtons, your hand's "
        "timing becomes progress keys. Esc or right click cancels"
    )
    bl_options = {"REGISTER", "UNDO"}  # Blender reads a set

    stroke: bpy.props.CollectionProperty(type=HnfPenSample, options={"HIDDEN", "SKIP_SAVE"})
    surface: bpy.props.StringProperty(
        name="Surface",
        description="Object that is touched; empty: the nearest visible mesh",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    wait_for_input: bpy.props.BoolProperty(
        name="Wait", description="Begin at the next press", default=True, options={"HIDDEN", "SKIP_SAVE"}
    )
    force_min_n: bpy.props.FloatProperty(
        name="Lightest",
        description="Normal force in newtons at the lightest pen pressure",
        default=0.1,
        min=0.0,
        max=FORCE_MAX_N,
        soft_max=2.0,
        precision=2,
    )
    force_max_n: bpy.props.FloatProperty(
        name="Hardest",
        description="Normal force in newtons at full pen pressure",
        default=3.0,
        min=0.01,
        max=FORCE_MAX_N,
        soft_max=5.0,
        precision=2,
    )
    force_n: bpy.props.FloatProperty(
        name="Mouse",
        description="Normal force in newtons when there is no pen pressure",
        default=1.0,
        min=0.01,
        max=FORCE_MAX_N,
        soft_max=5.0,
        precision=2,
    )
    timing: bpy.props.EnumProperty(
        name="Timing", description="Where the speed comes from", items=TIMING_ITEMS, default="HAND"
    )
    speed_mm_s: bpy.props.FloatProperty(
        name="Speed",
        description="Constant speed in millimeters per second",
        default=100.0,
        min=0.1,
        max=10_000.0,
        soft_max=500.0,
        precision=1,
    )
    smoothing_ms: bpy.props.FloatProperty(
        name="Smoothing",
        description="Evens out hand tremble and pixel steps over this many milliseconds",
        default=20.0,
        min=0.0,
        max=500.0,
        soft_max=100.0,
        precision=0,
    )
    probe: bpy.props.EnumProperty(
        name="Probe", description="What touches the surface", items=PROBE_ITEMS, default=DEFAULT_PROBE
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if context.mode != "OBJECT":
            return fail_poll(cls, "Strokes are drawn in Object Mode: choose it in the header")
        return True

    def draw(self, _context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        has_pressure = any(sample.pressure != 1.0 for sample in self.stroke)
        draw_style(layout, self, pen=has_pressure or not self.stroke, mouse=not has_pressure)

    @report_errors()
    def execute(self, context: Any) -> set[str]:
        message = self._make_stroke(context)
        self.report({"INFO"}, message)
        return {"FINISHED"}

    def invoke(self, context: Any, event: Any) -> set[str]:
        if len(self.stroke):
            return self.execute(context)
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"WARNING"}, tr("Strokes are drawn in a 3D view"))
            return {"CANCELLED"}
        from .pen import Pen

        self._pen = Pen(context, self.force_at)
        try:
            is_started = self.wait_for_input or self._pen.press(context, event, context.region)
        except Exception:
            self._pen.close(context)
            raise
        if not is_started:
            self._pen.close(context)
            self.report({"WARNING"}, self._pen.reject_reason)
            return {"CANCELLED"}
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        try:
            return self._step(context, event)
        except Exception:
            self._pen.close(context)
            raise

    def _step(self, context: Any, event: Any) -> set[str]:
        from ..bridge.viewport_pick import find_region_under_mouse
        from .pen import is_cancel_event

        pen = self._pen
        if is_cancel_event(context, event, pressed=pen.is_down):
            pen.close(context)
            return {"CANCELLED"}
        if not pen.is_down:
            pressed = event.type == "LEFTMOUSE" and event.value == "PRESS"
            region = find_region_under_mouse(context, event) if pressed else None
            if region is None:
                return {"PASS_THROUGH"}
            if not pen.press(context, event, region):
                self.report({"WARNING"}, pen.reject_reason)
            return {"RUNNING_MODAL"}
        if event.type in {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}:
            pen.move(context, event)
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            pen.move(context, event)
            pen.close(context)
            return self._finish(context)
        return {"RUNNING_MODAL"}

    def cancel(self, context: Any) -> None:
        """Remove the line drawn so far; called by Blender if the file or window is closed."""
        self._pen.close(context)

    def _finish(self, context: Any) -> set[str]:
        pen = self._pen
        if pen.is_click:
            self.report({"WARNING"}, tr("Drag to draw a stroke; a click is too short"))
            return {"CANCELLED"}
        self.surface = pen.surface
        self.stroke.clear()
        for sample, name in zip(pen.samples(context), pen.touched, strict=True):
            item = self.stroke.add()
            item.location, item.pressure, item.time, item.touching = sample
            item.name = name
        try:
            message = self._make_stroke(context)
        except HnfError as error:
            self.report({"WARNING"}, format_error(error))
            return {"CANCELLED"}
        self.report({"INFO"}, message)
        return {"FINISHED"}

    def force_at(self, pressure: float, is_pen: bool) -> float:
        """Return the force [N] at a pen pressure of 0 to 1, or of the mouse."""
        low, high = sorted((float(self.force_min_n), float(self.force_max_n)))
        return low + (high - low) * pressure if is_pen else float(self.force_n)

    def _make_stroke(self, context: Any) -> str:
        """Make the stroke object, select it and return a message. Raises HnfError if no stroke can be made."""
        from hnf_core.action.contacts import CONTACT_TOLERANCE_M
        from hnf_core.action.crossing import choose_touched
        from hnf_core.action.pen_stroke import PenSamples, PenStyle

        from ..bridge.stroke.new_stroke import create_drawn_stroke, mask_points_near_surface

        scene, depsgraph, metres = context.scene, context.evaluated_depsgraph_get(), get_metres_per_unit(context.scene)
        if len(self.stroke) == 0:
            raise SceneError("nothing was drawn.", remedy="Take the stroke tool and drag over a surface.")
        time, pressure, touching = (
            np.array([getattr(sample, name) for sample in self.stroke]) for name in ("time", "pressure", "touching")
        )
        points = np.array([tuple(sample.location) for sample in self.stroke], dtype=np.float64)
        names = [(sample.name or self.surface) if sample.touching else "" for sample in self.stroke]
        chosen = [self._get_surface(context, name) for name in choose_touched(names, points)]
        if len(chosen) > 1:
            touching &= np.isin(names, [obj.name for obj in chosen])
        else:
            surface = chosen[0] if chosen else self._find_surface(context, points[touching], depsgraph, metres)
            chosen = [surface]
            touching &= np.isin(names, ["", surface.name])
        near = [
            mask_points_near_surface(points[touching], obj, depsgraph, metres, CONTACT_TOLERANCE_M) for obj in chosen
        ]
        touching[touching] = np.any(near, axis=0)
        low, high = sorted((float(self.force_min_n), float(self.force_max_n)))
        speed = mm_to_m(float(self.speed_mm_s)) if self.timing == "SPEED" else None
        drawn = create_drawn_stroke(
            scene,
            depsgraph,
            chosen,
            PenSamples(time.astype(np.float64), points, pressure.astype(np.float64), touching.astype(bool)),
            PenStyle((low, high), float(self.force_n), float(self.smoothing_ms) * 1e-3, speed),
            start_frame=float(scene.frame_current_final),
            probe=resolve_probe(context, str(self.probe)),
            metres_per_unit=metres,
        )
        visibility_note = make_active_and_visible(context, drawn.obj)
        lifted_note = tr("; silent where it left the surface") if drawn.pen_stroke.lifted else ""
        template = tr("{name}: {length} mm in {time} s")
        length, seconds = m_to_mm(drawn.pen_stroke.length_m), drawn.pen_stroke.duration_s
        return (
            template.format(name=drawn.obj.name, length=f"{length:.0f}", time=f"{seconds:.2f}")
            + lifted_note
            + visibility_note
        )

    def _get_surface(self, context: Any, name: str) -> Any:
        surface = context.scene.objects.get(name)
        if surface is None or surface.type != "MESH":
            raise SceneError("there is no such mesh in this scene.", where=f"object '{name}'", remedy="Name another.")
        if not surface.visible_get(view_layer=context.view_layer):
            raise SceneError("it is hidden.", where=f"object '{name}'", remedy="Show it, then draw on it.")
        return surface

    def _find_surface(self, context: Any, points: Any, depsgraph: Any, metres: float) -> Any:
        from ..bridge.scene.meshes import read_surface
        from ..bridge.stroke.read_stroke import find_nearest_surface

        if self.surface:
            return self._get_surface(context, self.surface)
        if len(points) == 0:
            raise SceneError("the stroke touches no surface.", remedy="Draw on a visible mesh.")
        return find_nearest_surface(
            points,
            context.scene,
            depsgraph,
            lambda candidate: read_surface(candidate, depsgraph, metres),
            metres,
            where="the drawn stroke",
        )


def draw_style(layout: Any, props: Any, *, pen: bool = True, mouse: bool = True) -> None:
    """Draw the settings of a drawn stroke, in the tool's header and the redo panel."""
    if pen:
        row = layout.row(align=True)
        row.prop(props, "force_min_n", text="Pen (N)")
        row.prop(props, "force_max_n", text="")
    if mouse:
        layout.prop(props, "force_n", text="Mouse (N)")
    layout.prop(props, "timing")
    if props.timing == "SPEED":
        layout.prop(props, "speed_mm_s", text="Speed (mm/s)")
    layout.prop(props, "smoothing_ms", text="Smoothing (ms)")
    layout.prop(props, "probe")


TOOL_ID = "hnf.stroke"
"""Value of bl_idname of the tool (tool/stroke_tool.py)."""


class HNF_OT_stroke_tool(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
    bl_idname = "hnf.stroke_tool"
    bl_label = "Stroke Tool"
    bl_description = "Switch to the tool that draws strokes: drag over a surface with a pen or the mouse"
    bl_options = frozenset[str]()  # Switching tools needs no undo.

    @classmethod
    def poll(cls, context: Any) -> bool:
        if context.mode != "OBJECT":
            return fail_poll(cls, "Strokes are drawn in Object Mode: choose it in the header")
        if context.area is None or context.area.type != "VIEW_3D":
            return fail_poll(cls, "Strokes are drawn in a 3D view")
        return True

    def execute(self, _context: Any) -> set[str]:
        return set(bpy.ops.wm.tool_set_by_id(name=TOOL_ID))


CLASSES = (HnfPenSample, HNF_OT_stroke_draw, HNF_OT_stroke_tool)
