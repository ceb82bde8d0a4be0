"""Files dropped on the 3-D view: a `.hnf` material goes onto the surface under the mouse, a WAV becomes a Speaker."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import FileError, HnfError, SceneError

from ..bridge.scene_names import find_object, get_scene_name
from ..compat import beside_the_file
from ..props.scene import get_active_stroke, list_strokes
from ..state.session import STATE
from ..translations import tr
from .greyed import fail_poll
from .materials import find_material_object
from .strokes import UNDOABLE

if TYPE_CHECKING:  # what reads files is loaded with the first drop, not when the add-on is switched on
    from hnf_core.material.hnf_file import MaterialFile
    from hnf_core.signal import Signal

SPEAKER_PEAK_SHARE = 0.9
"""Share of full scale that a signal in m/s² is played at, at its loudest: Blender clips what lies above 1."""


class HNF_OT_import_material(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    bl_idname = "hnf.import_material"
    bl_label = "Touch Material (.hnf)"
    bl_description = "Make a surface feel like the material in a .hnf file. The choice is locked: no bake overwrites it"
    bl_options = UNDOABLE

    filepath: bpy.props.StringProperty(
        name="File", description="The .hnf file", subtype="FILE_PATH", options={"SKIP_SAVE"} | beside_the_file()
    )
    filter_glob: bpy.props.StringProperty(default="*.hnf", options={"HIDDEN"})
    target: bpy.props.StringProperty(
        name="Object", description="Object that receives it; empty: the active object", options={"SKIP_SAVE"}
    )
    slot: bpy.props.IntProperty(
        name="Slot", description="Material slot, counted from 0; −1: the active one", default=-1, options={"SKIP_SAVE"}
    )

    def invoke(self, context: Any, event: Any) -> set[str]:
        if not self.filepath:
            context.window_manager.fileselect_add(self)
            return {"RUNNING_MODAL"}
        from ..bridge.under_cursor import pick_object

        found = pick_object(context, event.mouse_region_x, event.mouse_region_y)
        if found is not None and not self.target:
            self.target, self.slot = get_scene_name(context.scene, found[0]), found[1]
        return self.execute(context)

    def execute(self, context: Any) -> set[str]:
        from hnf_core.material.hnf_file import read_hnf

        from ..bridge.own_material import assign_definition, create_material

        try:
            definition = read_hnf(Path(bpy.path.abspath(self.filepath)))
            obj = self._find_target(context)
            material = (
                create_material(definition) if obj is None else assign_definition(obj, self._find_slot(obj), definition)
            )
        except HnfError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        STATE.dirty_names.add(material.name)
        self.report({"INFO"}, _describe_assignment(definition, obj, material))
        return {"FINISHED"}

    def _find_target(self, context: Any) -> Any:
        """Raises SceneError where the target is not there."""
        if not self.target:
            return find_material_object(context)
        obj = find_object(context.scene, self.target)
        if obj is None or not hasattr(obj.data, "materials"):
            raise SceneError(
                "there is no such object with materials in the scene.",
                where=f"object '{self.target}'",
                remedy="Drop the file on a mesh.",
            )
        return obj.hnf_stroke.surface or obj if obj.hnf_stroke.is_stroke else obj

    def _find_slot(self, obj: Any) -> int:
        """Raises SceneError where the object has slots, and not this one."""
        slot = obj.active_material_index if self.slot < 0 else self.slot
        if slot > max(len(obj.material_slots) - 1, 0):
            raise SceneError(
                f"it has no material slot {slot}.",
                where=f"object '{obj.name}'",
                remedy=f"Its slots go from 0 to {max(len(obj.material_slots) - 1, 0)}.",
            )
        return int(slot)


class HNF_OT_import_sound(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.import_sound"
    bl_label = "Sound as Speaker (.wav)"
    bl_description = "Add a Speaker with a WAV file: at its stroke, at the active stroke, or else at the 3-D cursor"
    bl_options = UNDOABLE

    filepath: bpy.props.StringProperty(
        name="File", description="The .wav file", subtype="FILE_PATH", options={"SKIP_SAVE"} | beside_the_file()
    )
    filter_glob: bpy.props.StringProperty(default="*.wav", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: Any) -> bool:
        if context.mode != "OBJECT":
            return fail_poll(cls, "Leave Edit Mode first: a Speaker is added in Object Mode")
        return True

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if not self.filepath:
            context.window_manager.fileselect_add(self)
            return {"RUNNING_MODAL"}
        return self.execute(context)

    def execute(self, context: Any) -> set[str]:
        from ..bridge.speakers import add_speaker, get_bounding_box_centre

        path = Path(bpy.path.abspath(self.filepath))
        try:
            signal = read_hnf_signal(path)
            sound = _load_sound(path)
        except HnfError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        stroke = _find_signal_stroke(signal, context)
        place = context.scene.cursor.location if stroke is None else get_bounding_box_centre(stroke)
        frame = context.scene.frame_current if stroke is None else stroke.hnf_stroke.start
        speaker = add_speaker(sound, path.stem, place, frame, stroke)
        if signal is not None and signal.samples.size:
            speaker.data.volume = min(1.0, SPEAKER_PEAK_SHARE / max(float(abs(signal.samples).max()), 1e-9))
        where = tr("at the 3-D cursor") if stroke is None else tr("at stroke '{name}'").format(name=stroke.name)
        self.report({"INFO"}, f"{speaker.name}: {where}")
        return {"FINISHED"}


def read_hnf_signal(path: Path) -> "Signal | None":
    """The signal in a WAV of this project; None for any other sound that Blender may know. Raises FileError where
    there is no file."""
    from hnf_core.export.wav import UNITS, read_wav

    if not path.is_file():
        raise FileError("there is no such file.", where=str(path), remedy="Check the file's path.")
    try:
        signal = read_wav(path)
    except FileError:  # stereo, compressed: Blender's own reader has the last word
        return None
    return signal if signal.provenance.get("units", UNITS) == UNITS else None


def _load_sound(path: Path) -> Any:
    try:
        return bpy.data.sounds.load(str(path), check_existing=True)
    except RuntimeError as error:
        raise FileError("Blender cannot read this sound.", where=str(path), remedy="Give a .wav file.") from error


def _find_signal_stroke(signal: "Signal | None", context: Any) -> Any:
    """The stroke that a signal was made of, where it is in the scene; else the active stroke; else None."""
    name = "" if signal is None else signal.provenance.get("stroke", "")
    own = [stroke for stroke in list_strokes(context.scene) if stroke.name == name]
    return own[0] if own else get_active_stroke(context)


def _describe_assignment(definition: "MaterialFile", obj: Any, material: Any) -> str:
    if obj is None:
        return tr("'{name}' is a new material; no object was under the mouse or active").format(name=material.name)
    return tr("{object}: material '{material}' now feels like {name}").format(
        object=obj.name, material=material.name, name=definition.name
    )


class HNF_FH_material(bpy.types.FileHandler):  # type: ignore[misc]  # noqa: N801
    bl_idname = "HNF_FH_material"
    bl_label = "Touch material"
    bl_import_operator = "hnf.import_material"
    bl_file_extensions = ".hnf"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return _is_over_3d_view(context)


class HNF_FH_sound(bpy.types.FileHandler):  # type: ignore[misc]  # noqa: N801
    bl_idname = "HNF_FH_sound"
    bl_label = "Sound as Speaker"
    bl_import_operator = "hnf.import_sound"
    bl_file_extensions = ".wav"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return _is_over_3d_view(context)


def _is_over_3d_view(context: Any) -> bool:
    return context.area is not None and context.area.type == "VIEW_3D"


FILE_CLASSES = (HNF_OT_import_material, HNF_OT_import_sound, HNF_FH_material, HNF_FH_sound)
