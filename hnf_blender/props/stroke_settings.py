"""Property group Object.hnf_stroke: what makes a curve object a stroke, with its timing, force and probe.

The probe is the tip that touches, pen or finger. Force and progress are animated like any property, so the Graph Editor
edits them.
"""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import bpy

from hnf_core.material.probe import PROBE_NAMES

from .material_settings import OVERRIDABLE, register_pointer, unregister_pointer

FORCE_MAX_N = 20.0
"""Largest normal force of a stroke [N]."""

MOTION_PROFILE_ITEMS = (
    ("PROGRESS", "Progress Keys", "The keys of Progress say where along the curve the hand is at each frame"),
    ("SPEED", "Speed", "From end to end at a constant speed, unless Progress is keyed"),
    ("DURATION", "Duration", "From end to end in a given time, unless Progress is keyed"),
)


# No poll, no update: a Python callback in a property hangs bpy 4.5 and crashes 4.2 when the process ends.
class HnfStroke(bpy.types.PropertyGroup):  # type: ignore[misc]  # bpy has no types
    is_stroke: bpy.props.BoolProperty(
        name="Stroke",
        description="This curve is a stroke: a path along which the surface is touched",
        default=False,
        override=OVERRIDABLE,
    )
    was_curve: bpy.props.BoolProperty(
        name="Was a Curve",
        description="The artist's own curve, made a stroke: it is not deleted with the stroke",
        default=False,
        options={"HIDDEN"},
        override=OVERRIDABLE,
    )
    mute: bpy.props.BoolProperty(name="Mute", description="Skip this stroke", default=False, override=OVERRIDABLE)
    start: bpy.props.FloatProperty(
        name="Start", description="Frame at which the stroke begins", default=1.0, override=OVERRIDABLE
    )
    force: bpy.props.FloatProperty(
        name="Force",
        description="Normal force of the touch in newtons; 0 is no contact",
        default=1.0,
        min=0.0,
        max=FORCE_MAX_N,
        soft_max=5.0,
        precision=3,
        override=OVERRIDABLE,
    )
    progress: bpy.props.FloatProperty(
        name="Progress",
        description="Position along the curve, 0 to 1. Keys may go backward",
        default=0.0,
        min=0.0,
        max=1.0,
        precision=4,
        override=OVERRIDABLE,
    )
    law: bpy.props.EnumProperty(
        name="Timing",
        description="How the stroke is timed when Progress has no keys",
        items=MOTION_PROFILE_ITEMS,
        default="SPEED",
        override=OVERRIDABLE,
    )
    speed_mm_s: bpy.props.FloatProperty(
        name="Speed",
        description="Millimeters per second",
        default=100.0,
        min=0.1,
        max=10_000.0,
        soft_max=500.0,
        override=OVERRIDABLE,
    )
    duration_s: bpy.props.FloatProperty(
        name="Duration", description="Seconds from end to end", default=1.0, min=0.01, max=600.0, override=OVERRIDABLE
    )
    seed: bpy.props.IntProperty(
        name="Seed",
        description="The same stroke with the same seed gives the same signal",
        default=0,
        min=0,
        override=OVERRIDABLE,
    )
    probe: bpy.props.EnumProperty(
        name="Probe",
        description="What touches the surface",
        items=[(name, name.replace("-", " ").title(), f"Touch with the {name}") for name in PROBE_NAMES],
        default="pen",
        override=OVERRIDABLE,
    )
    surface: bpy.props.PointerProperty(
        name="Surface",
        description="Object that is touched; empty: every visible object under the stroke, in order",
        type=bpy.types.Object,
        override=OVERRIDABLE,
    )
    rides: bpy.props.BoolProperty(
        name="Ride on Surface",
        description="On a surface that deforms: the stroke keeps to the points that it lies on at its start, wherever "
        "these move. Off: the surface moves past it",
        default=False,
        override=OVERRIDABLE,
    )
    material: bpy.props.StringProperty(
        name="Material",
        description="Override what this stroke feels. Empty: the surface's own material",
        override=OVERRIDABLE,
    )
    kept: bpy.props.StringProperty(
        name="Kept",
        description="The bake of a stroke that is a library override: such a one saves registered text only",
        options={"HIDDEN"},
        override=OVERRIDABLE,
    )


def register() -> None:
    register_pointer(bpy.types.Object, "hnf_stroke", HnfStroke)


def unregister() -> None:
    unregister_pointer(bpy.types.Object, "hnf_stroke", HnfStroke)
