"""Whether what a mesh keeps of a bake is still true of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..translations import tr
from .guard import suppress_change_tracking
from .session import STATE

if TYPE_CHECKING:
    from ..touch.jobs import Session


class TokenValidity:
    """Looked at once a surface, as that takes as long as hashing it does, and anew after people changed anything; not
    while the timeline plays, which changes something with every frame.
    outdated: why what is kept is not felt, by the object's name."""

    def __init__(self) -> None:
        self.outdated: dict[str, str] = {}
        self._session: Session | None = None
        self._results: dict[str, bool] = {}
        self._changes = -1

    def is_valid(self, obj: Any, scene: Any, view_layer: Any) -> bool:
        """False also where it cannot be told: in Edit Mode, of what is hidden."""
        import bpy

        from hnf_core.errors import HnfError

        plays = any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows)
        if self._changes != STATE.changes and not (plays and self._results):
            self._session, self._changes = None, STATE.changes
            self._results.clear()
            self.outdated.clear()
        name = str(obj.name)
        if name not in self._results:
            try:
                self._results[name] = self._check(obj, scene, view_layer)
                why = "" if self._results[name] else tr("'{name}' changed since it was baked").format(name=name)
            except HnfError as error:
                self._results[name], why = False, str(error)
            if why:
                self.outdated[name] = why
        return self._results[name]

    def _check(self, obj: Any, scene: Any, view_layer: Any) -> bool:
        from hnf_core.errors import SceneError

        from ..touch.jobs import make_scene_session
        from ..touch.stored import has_tokens

        if obj.mode == "EDIT":
            raise SceneError("it is in Edit Mode.", where=f"object '{obj.name}'", remedy="Leave Edit Mode.")
        with suppress_change_tracking(view_layer):
            if self._session is None:
                self._session = make_scene_session(scene, view_layer, Path())
            return has_tokens(self._session, obj)
