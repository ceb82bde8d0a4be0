"""Temporary scenes to work in, removed without a trace after success, an error, or Ctrl-C.

`preserve_animated_values` restores objects after other frames were evaluated, since Blender writes animated values back
to the objects themselves.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from hnf_core.progress import add_work

if TYPE_CHECKING:
    import tempfile

    from numpy.typing import ArrayLike

TEMP_SCENE_NAME = "hnf temporary"
TEMP_LAYER_NAME = "hnf"  # no dot: EXR channels are "<layer>.<pass>.<component>"


class TemporaryScene:
    """Context manager with a temporary scene; every datablock created inside is removed on exit.

    The user's scenes, settings and selection are not touched.

    Parameters
    ----------
    template : bpy.types.Scene, optional
        Scene to copy; it shares the objects, world and lights. None starts with an empty scene.
    long_lived : bool, default False
        Set if other work continues in the file meanwhile: only datablocks created inside `track_new_data` are removed.
    """

    scene: Any

    def __init__(self, template: Any = None, *, long_lived: bool = False) -> None:
        self._template, self._long_lived = template, long_lived

    def __enter__(self) -> TemporaryScene:
        import bpy

        add_work("scenes")
        self._before = set(_list_datablocks())
        self._made: set[int] = set()
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.scene = None
        try:
            self.scene = bpy.data.scenes.new(TEMP_SCENE_NAME) if self._template is None else self._template.copy()
            for layer in list(self.scene.view_layers)[1:]:
                self.scene.view_layers.remove(layer)
            self.view_layer.name, self.view_layer.use = TEMP_LAYER_NAME, True
        except BaseException:
            self._made = set(_list_datablocks()) - self._before
            self._remove_created()
            raise
        self._made = set(_list_datablocks()) - self._before
        return self

    @contextmanager
    def track_new_data(self) -> Iterator[None]:
        """Register datablocks created in the with block for removal when the temporary scene is removed."""
        before = set(_list_datablocks())
        try:
            yield
        finally:
            self._made |= set(_list_datablocks()) - before

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._remove_created()

    @property
    def folder(self) -> Path:
        """Temporary folder that exists as long as this context manager is active."""
        if self._folder is None:
            from hnf_core.files import make_run_folder  # imported late: users of TEMP_SCENE_NAME need no folders

            self._folder = make_run_folder("scene")
        return Path(self._folder.name)

    @property
    def view_layer(self) -> Any:
        """Only view layer of the temporary scene."""
        return self.scene.view_layers[0]

    def link(self, obj: Any) -> Any:
        """Link an object to the temporary scene and return it."""
        if self.scene not in obj.users_scene:
            self.scene.collection.objects.link(obj)
        return obj

    def copy_object(self, obj: Any, *, with_data: bool = False) -> Any:
        """Add a visible copy of an object to the temporary scene; `with_data` copies its data too."""
        copy = obj.copy()
        if with_data:
            copy.data = obj.data.copy()
        for name, value in VISIBLE_SETTINGS.items():
            setattr(copy, name, value)
        return self.link(copy)

    def new_object(self, name: str, data: Any) -> Any:
        """Create an object in the temporary scene."""
        import bpy

        return self.link(bpy.data.objects.new(name, data))

    def set_world_matrix(self, obj: Any, matrix: ArrayLike) -> None:
        """Give a new object an exact world matrix (4, 4), shear included.

        Location, rotation and scale cannot represent shear, so the matrix is set as that of a parent.
        """
        import bpy
        from mathutils import Matrix

        anchor = bpy.data.objects.new("hnf anchor", None)
        obj.parent = self.link(anchor)
        obj.matrix_parent_inverse = Matrix(np.asarray(matrix, dtype=np.float64).tolist())

    def evaluate(self, frame: float | None = None) -> Any:
        """Return the temporary scene's depsgraph at a (fractional) frame; None is its current frame.

        Only objects linked here, and those they depend on, are evaluated.
        """
        if frame is None:
            frame = self.scene.frame_current_final
        integer_frame = math.floor(frame)
        self.scene.frame_set(integer_frame, subframe=frame - integer_frame)
        self.view_layer.update()
        return self.view_layer.depsgraph

    def _remove_created(self) -> None:
        import bpy

        if self.scene is not None:
            self.scene.render.use_persistent_data = False
        created = [block for uid, block in _list_datablocks().items() if self._is_created_here(uid)]
        bpy.data.batch_remove(created)
        if self._folder is not None:
            self._folder.cleanup()

    def _is_created_here(self, uid: int) -> bool:
        return uid in self._made if self._long_lived else uid not in self._before


VISIBLE_SETTINGS = {
    "hide_viewport": False,
    "hide_render": False,
    "visible_camera": True,
    "is_holdout": False,
    "is_shadow_catcher": False,
    "instance_type": "NONE",
}


def _list_datablocks() -> dict[int, Any]:
    return {block.session_uid: block for block in _iter_datablocks()}


def _iter_datablocks() -> Iterator[Any]:
    import bpy

    for prop in bpy.data.bl_rna.properties:
        if prop.type == "COLLECTION" and prop.identifier not in IGNORED_COLLECTIONS:
            yield from getattr(bpy.data, prop.identifier)


IGNORED_COLLECTIONS = {"libraries", "screens", "window_managers", "workspaces", "brushes"}
"""Collections of bpy.data that are not changed here, but that Blender may change at any time."""


TRANSFORM_CHANNELS = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
STROKE_CHANNELS = ("force", "progress")


@contextmanager
def preserve_animated_values(scene: Any, *objects: Any) -> Iterator[None]:
    """Restore the animated values of objects and their parents at the end of the with block.

    Evaluating other frames overwrites them. Values that the user changed without keying them are restored too, and
    everything else that is animated is set to the scene's current frame again. `scene` must not be the temporary one.
    """
    chain = {member.name_full: member for obj in objects for member in get_parent_chain(obj)}
    before = {name: _read_values(member) for name, member in chain.items()}
    try:
        yield
    finally:
        with TemporaryScene() as temporary:  # animated dependencies would stay at its frame 1
            for obj in objects:
                temporary.link(obj)
            temporary.evaluate(scene.frame_current_final)
        for name, member in chain.items():
            _restore_values(member, before[name])


def get_parent_chain(obj: Any) -> list[Any]:
    """Return the object and its parents, the object first."""
    chain = []
    while obj is not None:
        chain.append(obj)
        obj = obj.parent
    return chain


def _read_values(obj: Any) -> dict[str, Any]:
    values = {name: tuple(getattr(obj, name)) for name in TRANSFORM_CHANNELS}
    values.update({name: getattr(obj.hnf_stroke, name) for name in STROKE_CHANNELS})
    return values


def _restore_values(obj: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        owner = obj.hnf_stroke if name in STROKE_CHANNELS else obj
        current = getattr(owner, name)
        if (current if name in STROKE_CHANNELS else tuple(current)) != value:
            setattr(owner, name, value)


@contextmanager
def suppress_output() -> Iterator[None]:
    """Discard everything that C or Python code prints in the with block.

    Does nothing if the process has no standard streams (a windowed Windows program). Output of other threads is
    discarded too.
    """
    sink = _open_null()
    try:
        saved = [os.dup(1), os.dup(2)]
    except OSError:
        yield
        return
    _flush_streams()
    try:
        os.dup2(sink.fileno(), 1)
        os.dup2(sink.fileno(), 2)
        with redirect_stdout(sink), redirect_stderr(sink):
            yield
    finally:
        _flush_streams()
        for descriptor, stream in zip(saved, (1, 2), strict=True):
            os.dup2(descriptor, stream)
            os.close(descriptor)


@cache
def _open_null() -> TextIO:
    """Open the null device once and keep it open, as the glTF importer's log handlers keep the stream they found."""
    return open(os.devnull, "w", encoding="utf-8")


def _flush_streams() -> None:
    """Flush Python's and C's buffers of standard output and error."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            with suppress(OSError, ValueError):
                stream.flush()
    # Text in the buffers of C's printf would otherwise appear after the block.
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)
