"""Whether what a mesh keeps of a bake is still true of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from .guard import own_changes
from .session import STATE

if TYPE_CHECKING:
    from ..touch.jobs import Session


class StillTrue:
    """Looked at once a surface, as that takes as long as hashing it does, and anew after people changed anything.
    outdated: names of the objects whose tokens were found to be of another state of theirs."""

    def __init__(self) -> None:
        self.outdated: set[str] = set()
        self._session: Session | None = None
        self._found: dict[str, bool] = {}
        self._changes = -1

    def of(self, obj: Any, scene: Any, view_layer: Any) -> bool:
        """False also where it cannot be told: in Edit Mode, of what is hidden."""
        from hnf_core.errors import HnfError

        if self._changes != STATE.changes:
            self._session, self._changes = None, STATE.changes
            self._found.clear()
            self.outdated.clear()
        name = str(obj.name)
        if name not in self._found:
            try:
                self._found[name] = self._look(obj, scene, view_layer)
            except HnfError:
                self._found[name] = False
            if not self._found[name]:
                self.outdated.add(name)
        return self._found[name]

    def _look(self, obj: Any, scene: Any, view_layer: Any) -> bool:
        from ..jobs.work import scene_session
        from ..touch.stored import tokens_are_there

        if obj.mode == "EDIT":
            return False
        with own_changes(view_layer):
            if self._session is None:
                self._session = scene_session(scene, view_layer, Path())
            return tokens_are_there(obj, self._session.facts(obj))
