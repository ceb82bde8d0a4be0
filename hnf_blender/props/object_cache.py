"""Which objects of a scene are strokes (or whatever else is asked for), remembered while nobody changes anything:
panels ask dozens of times a redraw and a timer 25 times a second, and a scene may have ten thousand objects."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from typing import Any

CACHE_LIFETIME_S = 1.0
"""A list is made anew then at the latest: Blender does not tell of everything, such as a curve of which a script makes
a stroke by its custom properties."""
REDRAW_LIFETIME_S = 0.05
"""All of one redraw is asked within it."""
FEW_OBJECTS = 4
"""Objects that are fetched by their places one by one: Blender counts up to each. More: all of the scene's at once."""


class ChangeCounter:
    """is_told: handlers tell of changes, by forget(); without them nothing is remembered."""

    def __init__(self) -> None:
        self.is_notified = False
        self.changes = 0

    def mark_changed(self) -> None:
        """Something changed."""
        self.changes += 1


CHANGES = ChangeCounter()


class CachedFilter:
    """The objects of a scene of which is_one(object) holds. What is remembered are places among the scene's objects,
    never references, and each is looked at before it is believed."""

    def __init__(self, predicate: Callable[[Any], bool]) -> None:
        self._predicate = predicate
        self._indices: dict[str, tuple[int, float, tuple[int, ...]]] = {}

    def list_indexed(self, scene: Any, lifetime_s: float | None = None) -> list[tuple[int, Any]]:
        """(place, object), in the order of the scene's objects. holds_s: of what is remembered; None = HOLDS_S."""
        lifetime_s = CACHE_LIFETIME_S if lifetime_s is None else lifetime_s
        changes, since, places = self._indices.get(scene.name_full, (-1, float("-inf"), ()))
        if CHANGES.is_notified and changes == CHANGES.changes and time.monotonic() - since < lifetime_s:
            found = [(at, obj) for at, obj in _fetch_objects(scene.objects, places) if self._predicate(obj)]
            if len(found) == len(places):
                return found
        found = [(at, obj) for at, obj in enumerate(scene.objects) if self._predicate(obj)]
        if CHANGES.is_notified:
            self._indices[scene.name_full] = CHANGES.changes, time.monotonic(), tuple(at for at, _ in found)
        return found

    def list_objects(self, scene: Any) -> list[Any]:
        """In the order of the scene's objects."""
        return [obj for _, obj in self.list_indexed(scene)]


class ChangeCache:
    """Answers that cost a look through all of a scene's objects, by what was asked: numbers and names, no references.
    Remembered while nobody changes anything, HOLDS_S at most."""

    def __init__(self) -> None:
        self._values: dict[Hashable, Any] = {}
        self._changes, self._since = -1, float("-inf")

    def get(self, key: Hashable, compute: Callable[[], Any]) -> Any:
        if not CHANGES.is_notified:
            return compute()
        if self._changes != CHANGES.changes or time.monotonic() - self._since >= CACHE_LIFETIME_S:
            self._values.clear()
            self._changes, self._since = CHANGES.changes, time.monotonic()
        if key not in self._values:
            self._values[key] = compute()
        return self._values[key]


def get_object_at(objects: Any, index: int) -> Any:
    """objects[place], or None. Blender counts a scene's objects anew for each len()."""
    try:
        return objects[index]
    except IndexError:
        return None


def _fetch_objects(objects: Any, indices: tuple[int, ...]) -> list[tuple[int, Any]]:
    """Those of the places that still are."""
    held = objects[:] if len(indices) > FEW_OBJECTS else objects
    fetched = ((at, get_object_at(held, at)) for at in indices)
    return [(at, obj) for at, obj in fetched if obj is not None]


STROKES = CachedFilter(lambda obj: bool(obj.hnf_stroke.is_stroke))
