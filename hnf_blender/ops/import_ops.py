"""Operators and drop handlers that import files: `.hnf` materials, WAV files as speakers, Gaussian splats.

The surface of splats is reconstructed in a thread, so that the window stays responsive.
"""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import FileError, HnfError, SceneError
from hnf_core.progress import Cancelled, Progress

from ..bridge.scene.scene_names import find_object, get_scene_name
from ..compat import WORK_LOCK, beside_the_file
from ..props.scene_settings import get_active_stroke, list_strokes
from ..state.addon_settings import get_cache_folder
from ..state.session_state import STATE
from ..translations import tr
from .material_ops import find_material_object
from .operator_base import fail_poll, format_error, make_active
from .stroke_ops import UNDOABLE

if TYPE_CHECKING:
    from hnf_core.material.hnf_file import MaterialFile
    from hnf_core.scene.splats.gaussians import SplatSource
    from hnf_core.signal import Signal

    from ..bridge.splat_reconstruction import Reconstruction


class HNF_OT_import_material(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types, Blender's naming
    bl_idname = "hnf.import_material"
    bl_label = "Touch Material (.hnf)"
    bl_description = (
        "Make a surface feel like the material in a .hnf file, or in weights of hnf train field (.safetensors). The "
        "choice is locked: no bake overwrites it"
    )
    bl_options = UNDOABLE

    filepath: bpy.props.StringProperty(
        name="File",
        description="The .hnf or .safetensors file",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"} | beside_the_file(),
    )
    filter_glob: bpy.props.StringProperty(default="*.hnf;*.safetensors", options={"HIDDEN"})
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
        from ..bridge.viewport_pick import pick_object

        picked = pick_object(context, event.mouse_region_x, event.mouse_region_y)
        if picked is not None and not self.target:
            self.target, self.slot = get_scene_name(context.scene, picked[0]), picked[1]
        return self.execute(context)

    def execute(self, context: Any) -> set[str]:
        from hnf_core.field.weights import read_material_file

        from ..bridge.scene.material_definition import assign_definition, create_material

        try:
            definition = read_material_file(Path(bpy.path.abspath(self.filepath)))
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
        """Return the object that gets the imported material. Raises SceneError if it does not exist."""
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
        """Return the index of the material slot for the imported material.

        Raises SceneError if the object has no such slot.
        """
        slot = obj.active_material_index if self.slot < 0 else self.slot
        if slot > max(len(obj.material_slots) - 1, 0):
            raise SceneError(
                f"it has no material slot {slot}.",
                where=f"object '{obj.name}'",
                remedy=f"Its slots go from 0 to {max(len(obj.material_slots) - 1, 0)}.",
            )
        return int(slot)


class HNF_OT_import_sound(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.import_sound"
    bl_label = "Sound as Speaker (.wav)"
    bl_description = "Add a Speaker with a WAV file: at its stroke, at the active stroke, or else at the 3D cursor"
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
        from ..preview.strips_and_speakers import add_speaker, get_bounding_box_centre

        path = Path(bpy.path.abspath(self.filepath))
        try:
            signal = read_hnf_signal(path)
            sound = _load_sound(path)
        except HnfError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        stroke = _find_signal_stroke(signal, context)
        location = context.scene.cursor.location if stroke is None else get_bounding_box_centre(stroke)
        frame = context.scene.frame_current if stroke is None else stroke.hnf_stroke.start
        peak = 0.0 if signal is None else float(abs(signal.samples).max(initial=0.0))
        speaker = add_speaker(sound, path.stem, location, frame, stroke, peak)
        location_text = tr("at the 3D cursor") if stroke is None else tr("at stroke '{name}'").format(name=stroke.name)
        self.report({"INFO"}, f"{speaker.name}: {location_text}")
        return {"FINISHED"}


def read_hnf_signal(path: Path) -> "Signal | None":
    """Return the signal of a WAV of this project; None for other sounds. Raises FileError if there is no file."""
    from hnf_core.export.wav import UNITS, read_wav

    if not path.is_file():
        raise FileError("there is no such file.", where=str(path), remedy="Check the file's path.")
    try:
        signal = read_wav(path)
    except FileError:  # Blender may still read it, e.g. stereo or compressed.
        return None
    return signal if signal.provenance.get("units", UNITS) == UNITS else None


def _load_sound(path: Path) -> Any:
    try:
        return bpy.data.sounds.load(str(path), check_existing=True)
    except RuntimeError as error:
        raise FileError("Blender cannot read this sound.", where=str(path), remedy="Give a .wav file.") from error


def _find_signal_stroke(signal: "Signal | None", context: Any) -> Any:
    """Return the scene's stroke that a signal was synthesized from, else the active stroke, else None."""
    name = "" if signal is None else signal.provenance.get("stroke", "")
    matches = [stroke for stroke in list_strokes(context.scene) if stroke.name == name]
    return matches[0] if matches else get_active_stroke(context)


def _describe_assignment(definition: "MaterialFile", obj: Any, material: Any) -> str:
    if obj is None:
        return tr("'{name}' is a new material; no object was under the mouse or active").format(name=material.name)
    return tr("{object}: material '{material}' now feels like {name}").format(
        object=obj.name, material=material.name, name=definition.name
    )


class HNF_FH_material(bpy.types.FileHandler):  # type: ignore[misc]
    bl_idname = "HNF_FH_material"
    bl_label = "Touch Material"
    bl_import_operator = "hnf.import_material"
    bl_file_extensions = ".hnf"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return _is_over_3d_view(context)


class HNF_FH_sound(bpy.types.FileHandler):  # type: ignore[misc]
    bl_idname = "HNF_FH_sound"
    bl_label = "Sound as Speaker"
    bl_import_operator = "hnf.import_sound"
    bl_file_extensions = ".wav"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return _is_over_3d_view(context)


def _is_over_3d_view(context: Any) -> bool:
    return context.area is not None and context.area.type == "VIEW_3D"


TICK_S = 0.1
"""Interval of the timer [s]."""


class SplatReader:
    """Thread that reads a Gaussian-splat file, opened in Blender's main one, and reconstructs its surface."""

    def __init__(self, path: Path, cache: Path) -> None:
        self.share = 0.0
        self.result: Reconstruction | None = None
        self.error: HnfError | None = None
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        try:
            source = open_splats(path)
        except HnfError as error:
            self.error = error
            return
        self._thread = threading.Thread(target=self._run, args=(path, cache, source), daemon=True)
        self._thread.start()

    @property
    def is_done(self) -> bool:
        return self._thread is None or not self._thread.is_alive()

    def stop(self) -> None:
        """Stop after the current stage and discard the result."""
        self._stopped.set()

    def _run(self, path: Path, cache: Path, source: "SplatSource") -> None:
        with WORK_LOCK:
            self._read(path, cache, source)

    def _read(self, path: Path, cache: Path, source: "SplatSource") -> None:
        from ..bridge.splat_reconstruction import read_reconstruction

        try:
            self.result = read_reconstruction(path, cache, progress=self._on_progress, source=source)
        except HnfError as error:
            self.error = error
        except Cancelled:
            pass
        except Exception as error:  # A thread would not report an unexpected error.
            self.error = SceneError(f"internal error ({error!r}). Please report it.", where=str(path))

    def _on_progress(self, progress: Progress) -> None:
        if self._stopped.is_set():
            raise Cancelled
        self.share = progress.fraction
        WORK_LOCK.give_way()


def open_splats(path: Path) -> "SplatSource":
    """Open a splat file, in Blender's main thread.

    Raises HnfError for a file that cannot be read, and for a mesh, with the name of the importer that takes it.
    """
    from hnf_core.scene.file_kind import identify, read_head
    from hnf_core.scene.gltf_document import is_splat_document, read_gltf_document
    from hnf_core.scene.ply import read_ply_header

    from ..bridge import splat_reconstruction

    kind = identify(read_head(path))
    suffix = kind.suffix if kind is not None else path.suffix.lower()
    is_mesh = suffix == ".ply" and not read_ply_header(path).is_splat
    if is_mesh or (suffix in {".glb", ".gltf"} and not is_splat_document(read_gltf_document(path))):
        importer = "Stanford PLY (.ply)" if is_mesh else "glTF 2.0 (.glb/.gltf)"
        raise SceneError(
            "is a mesh or a point cloud, not splats.",
            where=str(path),
            remedy=f"Import it with File > Import > {importer}.",
        )
    return splat_reconstruction.open_splats(path)


class _ImportState:
    """State of an import while its surface is reconstructed.

    `_browser_opened` is set if Blender's file browser was opened, which then calls execute().
    """

    _reader: SplatReader | None = None
    _timer: Any = None
    _browser_opened: bool = False


class HNF_OT_import_splats(_ImportState, bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
    bl_idname = "hnf.import_splats"
    bl_label = "Gaussian Splats"
    bl_description = (
        "Add a 3D Gaussian splat reconstruction: its splats, and a surface made of them that can be touched"
    )
    bl_options = UNDOABLE

    filepath: bpy.props.StringProperty(
        name="File",
        description="The file: .ply, .spz, .sog (or its meta.json), .splat, .ksplat, or glTF with splats",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"} | beside_the_file(),
    )
    filter_glob: bpy.props.StringProperty(
        default="*.ply;*.spz;*.sog;*.splat;*.ksplat;*.glb;*.gltf;meta.json", options={"HIDDEN"}
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if context.mode != "OBJECT":
            return fail_poll(cls, "Leave Edit Mode first: splats are added in Object Mode")
        return True

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if not self.filepath:
            self._browser_opened = True
            context.window_manager.fileselect_add(self)
            return {"RUNNING_MODAL"}
        return self._start(context)

    def execute(self, context: Any) -> set[str]:
        if self._browser_opened and not bpy.app.background:
            return self._start(context)
        try:
            from ..bridge.splat_reconstruction import read_reconstruction

            reconstruction = read_reconstruction(self._path, get_cache_folder(), source=open_splats(self._path))
        except HnfError as error:
            return self._report_error(error)
        return self._add_to_scene(context, reconstruction)

    def modal(self, context: Any, event: Any) -> set[str]:
        from ..bridge.viewport_pick import find_view_under_mouse

        reader = self._reader
        if reader is None:
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS" and find_view_under_mouse(context, event) is not None:
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if not reader.is_done:
            template = tr("Reconstructing {file}: {percent} %.  Esc over the 3D view: cancel")
            text = template.format(file=self._path.name, percent=f"{100 * reader.share:.0f}")
            context.workspace.status_text_set(text)
            return {"PASS_THROUGH"}
        self._clean_up(context)
        if reader.error is not None:
            return self._report_error(reader.error)
        if reader.result is None or context.mode != "OBJECT":
            self.report({"ERROR"}, tr("Leave Edit Mode first: splats are added in Object Mode"))
            return {"CANCELLED"}
        return self._add_to_scene(context, reader.result)

    def cancel(self, context: Any) -> None:
        """Stop the import; also called by Blender if the window is closed or another file is opened."""
        if self._reader is not None:
            self._reader.stop()
        self._clean_up(context)

    @property
    def _path(self) -> Path:
        return Path(bpy.path.abspath(self.filepath))

    def _start(self, context: Any) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        self._reader = SplatReader(self._path, get_cache_folder())
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _add_to_scene(self, context: Any, made: "Reconstruction") -> set[str]:
        from ..bridge.splat_reconstruction import add_reconstruction, describe_shown_splats

        surface = add_reconstruction(context.scene, made)
        make_active(context, surface)
        template = tr("{name}: {splats} splats, a surface of {faces} faces; Material Preview shows their colors")
        count = len(made.surface.triangles)
        self.report({"INFO"}, template.format(name=surface.name, splats=len(made.splats), faces=count))
        for note in (*made.surface.warnings, describe_shown_splats(made)):
            if note:
                self.report({"WARNING"}, note[:1].upper() + note[1:])
        return {"FINISHED"}

    def _report_error(self, error: HnfError) -> set[str]:
        self.report({"ERROR"}, format_error(error))
        return {"CANCELLED"}

    def _clean_up(self, context: Any) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)


class HNF_FH_splats(bpy.types.FileHandler):  # type: ignore[misc]
    """Drop handler of splat files.

    Blender's own handler takes .ply too: a drop then asks which of the two it shall be. A .glb is left to Blender.
    """

    bl_idname = "HNF_FH_splats"
    bl_label = "Gaussian Splats"
    bl_import_operator = "hnf.import_splats"
    bl_file_extensions = ".ply;.spz;.sog;.splat;.ksplat"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return _is_over_3d_view(context)


CLASSES = (
    HNF_OT_import_material,
    HNF_OT_import_sound,
    HNF_FH_material,
    HNF_FH_sound,
    HNF_OT_import_splats,
    HNF_FH_splats,
)
