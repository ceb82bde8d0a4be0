"""Gaussian splats into the open scene, from a drop or from File > Import; a window does not wait for their surface."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import HnfError, SceneError

from ..compat import beside_the_file
from ..state.folders import get_cache_folder
from ..translations import tr
from .active import format_error, make_active
from .greyed import fail_poll
from .strokes import UNDOABLE

if TYPE_CHECKING:  # what reads files is loaded with the first drop, not when the add-on is switched on
    from ..bridge.splat_reconstruction import Reconstruction

TICK_S = 0.1


class _StoppedError(Exception):
    pass


class SplatReader:
    """A file being read and its surface being made in a thread, which knows nothing of Blender."""

    def __init__(self, path: Path, cache: Path) -> None:
        self.stage, self.share = "", 0.0
        self.result: Reconstruction | None = None
        self.error: HnfError | None = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(path, cache), daemon=True)
        self._thread.start()

    @property
    def is_done(self) -> bool:
        return not self._thread.is_alive()

    def stop(self) -> None:
        """It ends with its present stage; nothing comes of it."""
        self._stopped.set()

    def _run(self, path: Path, cache: Path) -> None:
        try:
            self.result = read_splat_file(path, cache, self._on_progress)
        except HnfError as error:
            self.error = error
        except _StoppedError:
            pass
        except Exception as error:  # a fault of ours, which a thread would swallow
            self.error = SceneError(f"internal error ({error!r}). Please report it.", where=str(path))

    def _on_progress(self, stage: str, share: float) -> None:
        if self._stopped.is_set():
            raise _StoppedError
        self.stage, self.share = stage, share


def read_splat_file(path: Path, cache: Path, progress: Any = None) -> "Reconstruction":
    """Raises HnfError where the file holds no splats or cannot be read, or no surface can be made of it."""
    from hnf_core.scene.ply_header import read_ply_header

    from ..bridge.splat_reconstruction import read_reconstruction

    if path.is_file() and path.suffix.lower() == ".ply" and not read_ply_header(path).is_splat:
        raise SceneError(
            "is a mesh or a point cloud, not splats.",
            where=str(path),
            remedy="Import it with File > Import > Stanford PLY (.ply).",
        )
    return read_reconstruction(path, cache, progress=progress)


class _ImportState:
    """What an import holds while its surface is made. asked: Blender's file browser was opened for it, and calls
    execute()."""

    _reader: SplatReader | None = None
    _timer: Any = None
    _browser_opened: bool = False


class HNF_OT_import_splats(_ImportState, bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_idname = "hnf.import_splats"
    bl_label = "Gaussian Splats (.ply)"
    bl_description = (
        "Add a 3-D Gaussian splat reconstruction: its splats, and a surface made of them that can be touched"
    )
    bl_options = UNDOABLE

    filepath: bpy.props.StringProperty(
        name="File",
        description="The .ply file, in INRIA's or PlayCanvas's layout",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"} | beside_the_file(),
    )
    filter_glob: bpy.props.StringProperty(default="*.ply", options={"HIDDEN"})

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
            made = read_splat_file(self._path, get_cache_folder())
        except HnfError as error:
            return self._report_error(error)
        return self._add_to_scene(context, made)

    def modal(self, context: Any, event: Any) -> set[str]:
        from ..bridge.under_cursor import find_view_under_mouse

        reading = self._reader
        if reading is None:
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS" and find_view_under_mouse(context, event) is not None:
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if not reading.is_done:
            said = tr("Reconstructing {file}: {percent} %.  Esc over the 3-D view: cancel")
            text = said.format(file=self._path.name, percent=f"{100 * reading.share:.0f}")
            context.workspace.status_text_set(text)
            return {"PASS_THROUGH"}
        self._clean_up(context)
        if reading.error is not None:
            return self._report_error(reading.error)
        if reading.result is None or context.mode != "OBJECT":
            self.report({"ERROR"}, tr("Leave Edit Mode first: splats are added in Object Mode"))
            return {"CANCELLED"}
        return self._add_to_scene(context, reading.result)

    def cancel(self, context: Any) -> None:
        """Blender's own word too: the window closes, or another file is opened."""
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
        from ..bridge.splat_scene import add_reconstruction, describe_shown_splats

        surface = add_reconstruction(context.scene, made)
        make_active(context, surface)
        said = tr("{name}: {splats} splats, a surface of {faces} faces; Material Preview shows their colours")
        count = len(made.surface.triangles)
        self.report({"INFO"}, said.format(name=surface.name, splats=len(made.splats), faces=count))
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


class HNF_FH_splats(bpy.types.FileHandler):  # type: ignore[misc]  # noqa: N801
    """Blender's own handler takes .ply too: a drop then asks which of the two it shall be."""

    bl_idname = "HNF_FH_splats"
    bl_label = "Gaussian splats"
    bl_import_operator = "hnf.import_splats"
    bl_file_extensions = ".ply"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


SPLAT_CLASSES = (HNF_OT_import_splats, HNF_FH_splats)
