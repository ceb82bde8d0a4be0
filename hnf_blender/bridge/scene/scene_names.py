"""What a scene calls its objects, one name each: one linked from another file may be called as one of this file is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cached_property
from typing import Any


def get_scene_name(scene: Any, obj: Any) -> str:
    """Its own name; of a linked object that shares its name with another of the scene the full one, which says the
    file too ("Plate [set.blend]")."""
    if obj.library is None:
        return str(obj.name)
    others = [each for each in _find_by_name(obj.name) if each != obj]
    return str(obj.name_full if others and _filter_members(others, scene.objects[:]) else obj.name)


def find_object(scene: Any, name: str, scene_objects: list[Any] | None = None) -> Any:
    """The object that name_in calls so, or None. members: scene.objects[:], from whoever asks for several."""
    found = [*_find_by_name(name), *_find_by_full_name(name)]
    if not found:
        return None
    found = _filter_members(found, scene.objects[:] if scene_objects is None else scene_objects)
    own = [obj for obj in found if obj.name == name]
    exact = [obj for obj in own if obj.library is None] or (own if len(own) == 1 else [])
    return exact[0] if exact else next((obj for obj in found if get_scene_name(scene, obj) == name), None)


def get_named_objects(scene: Any) -> dict[str, Any]:
    """All of them by these names, in the order of the scene's objects."""
    objects = list(scene.objects)
    count = Counter(obj.name for obj in objects)
    return {obj.name if obj.library is None or count[obj.name] == 1 else obj.name_full: obj for obj in objects}


class SceneNames:
    """The same for many objects, within one call that changes nothing: all of the scene is gone through once, and not
    before it must be."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene

    def get_name(self, obj: Any) -> str:
        """See name_in."""
        if obj.library is None or obj.session_uid not in self._names_by_uid:
            return get_scene_name(self._scene, obj)
        return self._names_by_uid[obj.session_uid]

    def get_object(self, name: str) -> Any:
        """See object_in."""
        return self._objects_by_name.get(name)

    @cached_property
    def _objects_by_name(self) -> dict[str, Any]:
        return get_named_objects(self._scene)

    @cached_property
    def _names_by_uid(self) -> dict[int, str]:
        return {obj.session_uid: name for name, obj in self._objects_by_name.items() if obj.library is not None}


def _find_by_name(name: str) -> list[Any]:
    """The file's objects of this name, its own and each library's. Blender finds one by name and library at once, while
    a scene's own objects are gone through one by one."""
    import bpy

    files = (None, *dict.fromkeys(library.filepath for library in bpy.data.libraries))
    return _drop_missing(bpy.data.objects.get((name, file)) for file in files)


def _find_by_full_name(name: str) -> list[Any]:
    """The file's linked objects of this full name."""
    import bpy

    ends = ((f" [{library.name}]", library.filepath) for library in bpy.data.libraries)
    return _drop_missing(
        bpy.data.objects.get((name.removesuffix(end), file)) for end, file in ends if name.endswith(end)
    )


def _drop_missing(found: Iterable[Any]) -> list[Any]:
    return [obj for obj in found if obj is not None]


def _filter_members(found: list[Any], members: list[Any]) -> list[Any]:
    return [obj for obj in found if obj in members]
