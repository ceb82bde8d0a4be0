"""Which objects of a scene are strokes, remembered while nobody changes anything: panels ask dozens of times a redraw
and a timer 25 times a second, and a scene may have ten thousand objects."""

from __future__ import annotations

import time
from typing import Any

HOLDS_S = 1.0
"""A list is made anew then at the latest: Blender does not tell of everything, such as a script that makes a curve of
the scene a stroke."""


class Listed:
    """is_told: handlers tell of changes, by forget(); without them nothing is remembered. What is remembered are
    places in the scene's objects, never references, and each is looked at before it is believed."""

    def __init__(self) -> None:
        self.is_told = False
        self._places: dict[str, tuple[float, tuple[int, ...]]] = {}

    def forget(self) -> None:
        """Something changed."""
        self._places.clear()

    def strokes(self, scene: Any) -> list[Any]:
        """The scene's stroke objects, in the order of its objects."""
        since, places = self._places.get(scene.name_full, (float("-inf"), ()))
        if self.is_told and time.monotonic() - since < HOLDS_S:
            objects = scene.objects[:] if places else ()
            found = [objects[at] for at in places if at < len(objects) and objects[at].hnf_stroke.is_stroke]
            if len(found) == len(places):
                return found
        numbered = [(at, obj) for at, obj in enumerate(scene.objects) if obj.hnf_stroke.is_stroke]
        if self.is_told:
            self._places[scene.name_full] = time.monotonic(), tuple(at for at, _ in numbered)
        return [obj for _, obj in numbered]


LISTED = Listed()
