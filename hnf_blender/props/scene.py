"""Scene.hnf: what the Touch tab keeps with the scene."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import bpy


class HnfScene(bpy.types.PropertyGroup):  # type: ignore[misc]  # bpy has no types
    stroke_index: bpy.props.IntProperty(
        name="Active stroke", description="The stroke the panels below speak of", default=0, min=0
    )
    metres_per_unit: bpy.props.FloatProperty(
        name="Metres per unit",
        description="Length of one scene unit in metres; 0 uses the scene's own unit scale",
        default=0.0,
        min=0.0,
        soft_max=1.0,
        precision=4,
    )
    monitor_gain_db: bpy.props.FloatProperty(
        name="Monitor gain",
        description="Loudness of the preview on headphones in dB. The signal itself keeps its m/s²",
        default=0.0,
        min=-60.0,
        max=60.0,
        precision=1,
    )
    loop: bpy.props.BoolProperty(name="Loop", description="Play the stroke over and over", default=False)
    follow_timeline: bpy.props.BoolProperty(
        name="Follow the timeline",
        description="Sound the strokes at their place in time while the timeline plays",
        default=True,
    )
    actuator: bpy.props.StringProperty(
        name="Actuator", description="Profile whose limits the preview is shown against", default="generic-voice-coil"
    )
    export_folder: bpy.props.StringProperty(
        name="Folder", description="Where exported signals are written", default="//touch", subtype="DIR_PATH"
    )


def register() -> None:
    bpy.utils.register_class(HnfScene)
    bpy.types.Scene.hnf = bpy.props.PointerProperty(type=HnfScene)


def unregister() -> None:
    del bpy.types.Scene.hnf
    bpy.utils.unregister_class(HnfScene)
