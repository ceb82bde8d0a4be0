"""Caches of scene queries, valid until something changes.

Panels query the strokes of a scene dozens of times per redraw and a timer 25 times per second, while a scene may have
ten thousand objects.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from typing import Any

from hnf_core.progress import add_work

CACHE_LIFETIME_S = 1.0
"""Longest lifetime of a cached result [s], since Blender does not report every change.

For example, a script can turn a curve into a stroke by its custom properties.
"""
REDRAW_LIFETIME_S = 0.05
"""Time within which all queries of one redraw are made [s]."""
FEW_OBJECTS = 4
"""Number of objects up to which they are fetched by index, for which Blender counts up to each of them."""


class ChangeCounter:
    """Counter of changes to Blender's data.

    Attributes
    ----------
    is_notified : bool
        Whether handlers report changes by `mark_changed`; if not, nothing is cached.
    changes : int
        Number of changes.
    """

    def __init__(self) -> None:
        self.is_notified = False
        self.changes = 0

    def mark_changed(self) -> None:
        """Count a change."""
        self.changes += 1


CHANGES = ChangeCounter()


class CachedFilter:
    """Cached list of a scene's objects that satisfy a predicate, such as being a stroke.

    Indices are cached, never references, and the predicate is checked again for each of them.
    """

    def __init__(self, predicate: Callable[[Any], bool]) -> None:
        self._predicate = predicate
        self._indices: dict[str, tuple[int, float, tuple[int, ...]]] = {}

    def list_indexed(self, scene: Any, lifetime_s: float | None = None) -> list[tuple[int, Any]]:
        """Return (index, object) pairs in the order of the scene's objects.

        `lifetime_s` limits the age of the cached result; None means CACHE_LIFETIME_S.
        """
        lifetime_s = CACHE_LIFETIME_S if lifetime_s is None else lifetime_s
        changes, cached_at, indices = self._indices.get(scene.name_full, (-1, float("-inf"), ()))
        if CHANGES.is_notified and changes == CHANGES.changes and time.monotonic() - cached_at < lifetime_s:
            fetched = _fetch_objects(scene.objects, indices)
            add_work("objects", len(fetched), scene.name_full)
            matches = [(index, obj) for index, obj in fetched if self._predicate(obj)]
            if len(matches) == len(indices):
                return matches
        objects = scene.objects[:]
        add_work("objects", len(objects), scene.name_full)
        matches = [(index, obj) for index, obj in enumerate(objects) if self._predicate(obj)]
        if CHANGES.is_notified:
            self._indices[scene.name_full] = CHANGES.changes, time.monotonic(), tuple(index for index, _ in matches)
        return matches

    def list_objects(self, scene: Any) -> list[Any]:
        """Return the scene's objects that the filter's predicate selects, in the scene's order."""
        return [obj for _, obj in self.list_indexed(scene)]


class ChangeCache:
    """Cache of values computed from all of a scene's objects: numbers and names, no references.

    Values are valid until something changes, CACHE_LIFETIME_S at most.
    """

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
    """Return the object at an index, or None; avoids `len`, for which Blender counts all objects."""
    try:
        return objects[index]
    except IndexError:
        return None


def _fetch_objects(objects: Any, indices: tuple[int, ...]) -> list[tuple[int, Any]]:
    """Return (index, object) pairs of the indices that exist."""
    sequence = objects[:] if len(indices) > FEW_OBJECTS else objects
    fetched = ((index, get_object_at(sequence, index)) for index in indices)
    return [(index, obj) for index, obj in fetched if obj is not None]


STROKES = CachedFilter(lambda obj: bool(obj.hnf_stroke.is_stroke))
