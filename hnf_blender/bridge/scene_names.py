"""What a scene calls its objects, one name each: one linked from another file may be called as one of this file is."""

from __future__ import annotations

from collections import Counter
from typing import Any


def name_in(scene: Any, obj: Any) -> str:
    """Its own name; of a linked object that shares its name with another of the scene the full one, which says the
    file too ("Plate [set.blend]")."""
    if obj.library is None or sum(each.name == obj.name for each in scene.objects) <= 1:
        return str(obj.name)
    return str(obj.name_full)


def object_in(scene: Any, name: str) -> Any:
    """The object that name_in calls so, or None."""
    found = scene.objects.get(name)
    if found is not None and found.library is None:
        return found
    return named_objects(scene).get(name)


def named_objects(scene: Any) -> dict[str, Any]:
    """All of them by these names, in the order of the scene's objects."""
    objects = list(scene.objects)
    count = Counter(obj.name for obj in objects)
    return {obj.name if obj.library is None or count[obj.name] == 1 else obj.name_full: obj for obj in objects}
