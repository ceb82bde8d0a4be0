"""A scene of our own to work in, of which nothing is left: not after success, an error, or Ctrl-C.

Looking at other frames without leaving a trace: Blender writes animated values back to the objects themselves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import tempfile

    from numpy.typing import ArrayLike

TEMP_SCENE_NAME = "hnf temporary"
TEMP_LAYER_NAME = "hnf"  # no dot: EXR channels are "<layer>.<pass>.<component>"


class TemporaryScene:
    """Holds one temporary scene; on leaving, every datablock made since entering is removed.

    The user's scenes, settings and selection are never touched. Use as a context manager. like: a scene to start
    from (its objects, world and lights, shared), None = an empty one. lasting: other work goes on in the file before it
    is left: what is made outside of making() is not removed.
    """

    scene: Any

    def __init__(self, template: Any = None, *, long_lived: bool = False) -> None:
        self._template, self._long_lived = template, long_lived

    def __enter__(self) -> TemporaryScene:
        import bpy

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
        """What is made in this block is removed with the rest, however long that is off."""
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
        """A folder that lasts as long as this context."""
        if self._folder is None:
            import tempfile  # what only asks for SCENE_NAME needs no folders

            self._folder = tempfile.TemporaryDirectory(prefix="hnf-")
        return Path(self._folder.name)

    @property
    def view_layer(self) -> Any:
        return self.scene.view_layers[0]

    def link(self, obj: Any) -> Any:
        """Put obj into the temporary scene and return it."""
        if self.scene not in obj.users_scene:
            self.scene.collection.objects.link(obj)
        return obj

    def copy_object(self, obj: Any, *, with_data: bool = False) -> Any:
        """A visible copy of obj in the temporary scene; it shares obj's data unless with_data."""
        copy = obj.copy()
        if with_data:
            copy.data = obj.data.copy()
        for name, value in VISIBLE_SETTINGS.items():
            setattr(copy, name, value)
        return self.link(copy)

    def new_object(self, name: str, data: Any) -> Any:
        import bpy

        return self.link(bpy.data.objects.new(name, data))

    def set_world_matrix(self, obj: Any, matrix: ArrayLike) -> None:
        """Give a new object an exact world matrix, shear included, which location, rotation and scale cannot hold."""
        import bpy
        from mathutils import Matrix

        anchor = bpy.data.objects.new("hnf anchor", None)
        obj.parent = self.link(anchor)
        obj.matrix_parent_inverse = Matrix(np.asarray(matrix, dtype=np.float64).tolist())

    def evaluate(self, frame: float | None = None) -> Any:
        """The temporary scene's depsgraph at a (fractional) frame, None = its current one. No object of the file is
        evaluated but those linked here and what they depend on."""
        if frame is None:
            frame = self.scene.frame_current_final
        whole = math.floor(frame)
        self.scene.frame_set(whole, subframe=frame - whole)
        self.view_layer.update()
        return self.view_layer.depsgraph

    def _remove_created(self) -> None:
        import bpy

        if self.scene is not None:
            self.scene.render.use_persistent_data = False
        made = [block for uid, block in _list_datablocks().items() if self._is_created_here(uid)]
        bpy.data.batch_remove(made)
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
"""Kinds that the work here never makes and that Blender may make by itself at any time."""


TRANSFORM_CHANNELS = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
STROKE_CHANNELS = ("force", "progress")


@contextmanager
def preserve_animated_values(scene: Any, *objects: Any) -> Iterator[None]:
    """Afterwards the objects and their parents hold the values they had before, unkeyed changes included, and
    whatever else was animated stands at scene's current frame again. scene must not be the temporary one."""
    chain = {member.name_full: member for obj in objects for member in get_parent_chain(obj)}
    before = {name: _read_values(member) for name, member in chain.items()}
    try:
        yield
    finally:
        with TemporaryScene() as temporary:  # its frame 1 would stay in dependencies that are animated
            for obj in objects:
                temporary.link(obj)
            temporary.evaluate(scene.frame_current_final)
        for name, member in chain.items():
            _restore_values(member, before[name])


def get_parent_chain(obj: Any) -> list[Any]:
    """The object and its parents."""
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
        now = getattr(owner, name)
        if (now if name in STROKE_CHANNELS else tuple(now)) != value:
            setattr(owner, name, value)
