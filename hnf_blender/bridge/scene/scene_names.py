"""Unique names of a scene's objects; a linked object may have the same name as a local one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cached_property
from typing import Any


def get_scene_name(scene: Any, obj: Any) -> str:
    """Return an object's name in a scene.

    A linked object that shares its name with another in the scene gets its full name, which includes the file ("Plate
    [set.blend]").
    """
    if obj.library is None:
        return str(obj.name)
    others = [candidate for candidate in _find_by_name(obj.name) if candidate != obj]
    return str(obj.name_full if others and _filter_members(others, scene.objects[:]) else obj.name)


def find_object(scene: Any, name: str, scene_objects: list[Any] | None = None) -> Any:
    """Return the object with a name given by `get_scene_name`, or None.

    `scene_objects` is scene.objects[:], passed by callers that look up several names.
    """
    candidates = [*_find_by_name(name), *_find_by_full_name(name)]
    if not candidates:
        return None
    candidates = _filter_members(candidates, scene.objects[:] if scene_objects is None else scene_objects)
    same_name = [obj for obj in candidates if obj.name == name]
    exact = [obj for obj in same_name if obj.library is None] or (same_name if len(same_name) == 1 else [])
    return exact[0] if exact else next((obj for obj in candidates if get_scene_name(scene, obj) == name), None)


def get_named_objects(scene: Any) -> dict[str, Any]:
    """Return all objects of a scene by the names that `get_scene_name` gives them, in the scene's order."""
    objects = list(scene.objects)
    count = Counter(obj.name for obj in objects)
    return {obj.name if obj.library is None or count[obj.name] == 1 else obj.name_full: obj for obj in objects}


class SceneNames:
    """Cached lookup of names and objects in a scene that does not change meanwhile.

    The scene's objects are read once, and only if needed.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene

    def get_name(self, obj: Any) -> str:
        """Return an object's name; see `get_scene_name`."""
        if obj.library is None or obj.session_uid not in self._names_by_uid:
            return get_scene_name(self._scene, obj)
        return self._names_by_uid[obj.session_uid]

    def get_object(self, name: str) -> Any:
        """Return the object with a name, or None; see `find_object`."""
        return self._objects_by_name.get(name)

    @cached_property
    def _objects_by_name(self) -> dict[str, Any]:
        return get_named_objects(self._scene)

    @cached_property
    def _names_by_uid(self) -> dict[int, str]:
        return {obj.session_uid: name for name, obj in self._objects_by_name.items() if obj.library is not None}


def _find_by_name(name: str) -> list[Any]:
    """Return all objects of the .blend with a name, local and linked.

    Blender finds an object by name and library at once, whereas a scene's objects would have to be searched.
    """
    import bpy

    files = (None, *dict.fromkeys(library.filepath for library in bpy.data.libraries))
    return _drop_missing(bpy.data.objects.get((name, file)) for file in files)


def _find_by_full_name(name: str) -> list[Any]:
    """Return the .blend's linked objects with a full name, which includes their file."""
    import bpy

    ends = ((f" [{library.name}]", library.filepath) for library in bpy.data.libraries)
    return _drop_missing(
        bpy.data.objects.get((name.removesuffix(end), file)) for end, file in ends if name.endswith(end)
    )


def _drop_missing(found: Iterable[Any]) -> list[Any]:
    return [obj for obj in found if obj is not None]


def _filter_members(found: list[Any], members: list[Any]) -> list[Any]:
    return [obj for obj in found if obj in members]
