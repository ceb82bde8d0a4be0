"""Which objects of a scene are strokes (or whatever else is asked for), remembered while nobody changes anything:
panels ask dozens of times a redraw and a timer 25 times a second, and a scene may have ten thousand objects."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from typing import Any

HOLDS_S = 1.0
"""A list is made anew then at the latest: Blender does not tell of everything, such as a curve of which a script makes
a stroke by its custom properties."""
A_REDRAW_S = 0.05
"""All of one redraw is asked within it."""
FEW = 4
"""Objects that are fetched by their places one by one: Blender counts up to each. More: all of the scene's at once."""


class News:
    """is_told: handlers tell of changes, by forget(); without them nothing is remembered."""

    def __init__(self) -> None:
        self.is_told = False
        self.changes = 0

    def forget(self) -> None:
        """Something changed."""
        self.changes += 1


NEWS = News()


class Listed:
    """The objects of a scene of which is_one(object) holds. What is remembered are places among the scene's objects,
    never references, and each is looked at before it is believed."""

    def __init__(self, is_one: Callable[[Any], bool]) -> None:
        self._is_one = is_one
        self._places: dict[str, tuple[int, float, tuple[int, ...]]] = {}

    def numbered(self, scene: Any, holds_s: float | None = None) -> list[tuple[int, Any]]:
        """(place, object), in the order of the scene's objects. holds_s: of what is remembered; None = HOLDS_S."""
        holds_s = HOLDS_S if holds_s is None else holds_s
        changes, since, places = self._places.get(scene.name_full, (-1, float("-inf"), ()))
        if NEWS.is_told and changes == NEWS.changes and time.monotonic() - since < holds_s:
            found = [(at, obj) for at, obj in _fetched(scene.objects, places) if self._is_one(obj)]
            if len(found) == len(places):
                return found
        found = [(at, obj) for at, obj in enumerate(scene.objects) if self._is_one(obj)]
        if NEWS.is_told:
            self._places[scene.name_full] = NEWS.changes, time.monotonic(), tuple(at for at, _ in found)
        return found

    def of(self, scene: Any) -> list[Any]:
        """In the order of the scene's objects."""
        return [obj for _, obj in self.numbered(scene)]


class Remembered:
    """Answers that cost a look through all of a scene's objects, by what was asked: numbers and names, no references.
    Remembered while nobody changes anything, HOLDS_S at most."""

    def __init__(self) -> None:
        self._answers: dict[Hashable, Any] = {}
        self._changes, self._since = -1, float("-inf")

    def answer(self, asked: Hashable, find: Callable[[], Any]) -> Any:
        if not NEWS.is_told:
            return find()
        if self._changes != NEWS.changes or time.monotonic() - self._since >= HOLDS_S:
            self._answers.clear()
            self._changes, self._since = NEWS.changes, time.monotonic()
        if asked not in self._answers:
            self._answers[asked] = find()
        return self._answers[asked]


def object_at(objects: Any, place: int) -> Any:
    """objects[place], or None. Blender counts a scene's objects anew for each len()."""
    try:
        return objects[place]
    except IndexError:
        return None


def _fetched(objects: Any, places: tuple[int, ...]) -> list[tuple[int, Any]]:
    """Those of the places that still are."""
    held = objects[:] if len(places) > FEW else objects
    fetched = ((at, object_at(held, at)) for at in places)
    return [(at, obj) for at, obj in fetched if obj is not None]


STROKES = Listed(lambda obj: bool(obj.hnf_stroke.is_stroke))
