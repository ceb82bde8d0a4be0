"""Which names Blender still knows: for each one alone it goes through all its datablocks.

Statuses that follow the scene: which strokes a change may concern, and a look at them, a bit at a time.

Whether what a mesh keeps of a bake is still true of it.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..bridge.scene.scene_names import SceneNames, find_object
from ..touch.freshness import Freshness, StrokeStatus
from ..translations import tr
from .session_state import STATE, suppress_change_tracking

if TYPE_CHECKING:
    from ..touch.session import Session

FEW_NAMES = 8
"""Names that are looked for one by one."""


def find_absent_names(names: Set[str], kind: Any) -> set[str]:
    """Those of the names that no datablock of a kind (bpy.data.objects, …) has."""
    if len(names) > FEW_NAMES:
        return set(names).difference(kind.keys())
    return {name for name in names if name not in kind}


EVERYTHING = "*"
"""In STATE.dirty: an undo, a redo or another file; nothing is known any more. No datablock is called so by Blender."""
STROKE_DATA_KINDS = frozenset({"Object", "Curve", "Action"})
"""Kinds of datablocks that a stroke consists of."""
STROKE_SETTINGS = ("start", "force", "progress", "law", "speed_mm_s", "duration_s", "seed", "probe", "material")
SETTINGS_PER_CHECK = 8
TICK_BUDGET_S = 0.04
"""No new look begins in a tick after this. One look, of the shape of 100,000 faces, may take as long again."""


def get_changed_names(depsgraph: Any) -> set[str]:
    """Of what a stroke may be part of, in a handler of changes."""
    return {str(each.id.name) for each in depsgraph.updates if each.id.bl_rna.identifier in STROKE_DATA_KINDS}


def get_stroke_data_names(stroke: Any) -> set[str]:
    """Names of the datablocks that a stroke consists of: object, curve, keys."""
    action = None if stroke.animation_data is None else stroke.animation_data.action
    return {stroke.name, stroke.data.name, *([] if action is None else [action.name])}


class StatusTracker:
    """The strokes of one scene that must be looked at, and what is known of the surfaces they touch.

    Holds names and hashes, no Blender data between two calls.
    """

    def __init__(self, scene: Any, view_layer: Any) -> None:
        self.scene, self.view_layer = scene.name, view_layer.name
        self._pending: dict[str, None] = {}
        self._session: Session | None = None
        self._stamp: object = None
        self._settings: dict[str, object] = {}
        self._choices: dict[str, str] = {}
        self.mark_changed(EVERYTHING)

    @property
    def is_idle(self) -> bool:
        return not self._pending

    def mark_changed(self, *changed: str) -> None:
        """Names of datablocks changed: strokes they may concern are looked at again."""
        scene = _find_scene(self.scene)
        if scene is None:
            self._pending.clear()
            return
        names = set(changed) | self._find_silent_changes(scene)
        _clear_reliefs(names)
        stamp = (scene.render.fps, scene.render.fps_base, *_get_unit_scale(scene))
        if not names and stamp == self._stamp:
            return
        strokes = [obj for obj in scene.objects if obj.hnf_stroke.is_stroke]
        calls = SceneNames(scene)
        named = [calls.get_name(obj) for obj in strokes]
        statuses = STATE.get_statuses(scene)
        for name in statuses.keys() - set(named):
            del statuses[name]
        if EVERYTHING in names or stamp != self._stamp:
            self._session, self._stamp = None, stamp
            self._pending.update(dict.fromkeys(named))
            return
        touched = [_get_surface_name(calls, obj, statuses.get(name)) for name, obj in zip(named, strokes, strict=True)]
        surfaces = self._find_affected_surfaces(calls, touched, names)
        if self._session is not None:
            self._session.invalidate(surfaces)
        for name, obj, surface in zip(named, strokes, touched, strict=True):
            own = bool(get_stroke_data_names(obj) & names)
            if own or surface in surfaces or obj.hnf_stroke.surface is None:
                self._pending[name] = None

    def _find_affected_surfaces(self, calls: SceneNames, touched: Iterable[str], names: set[str]) -> set[str]:
        """Names of surfaces that may look or feel different, where datablocks of these names changed. touched: names of
        those that strokes touch."""
        known = set(touched)
        known |= set() if self._session is None else self._session.known_names
        if _has_unknown_names(names):
            return known
        found = {name: calls.get_object(name) for name in known}
        return {name for name, obj in found.items() if obj is None or _is_affected(obj, names)}

    def _find_silent_changes(self, scene: Any) -> set[str]:
        """Names of strokes and materials whose own settings changed: scripts do that without telling Blender. A few
        strokes a time: finding them by name takes time where there are many objects."""
        import bpy

        changed = set()
        members = scene.objects[:] if self._settings else []
        for name in list(self._settings)[:SETTINGS_PER_CHECK]:
            before = self._settings.pop(name)  # and to the end of the queue
            obj = find_object(scene, name, members)
            if obj is not None:
                self._settings[name] = _read_stroke_settings(obj)
            if obj is None or self._settings[name] != before:
                changed.add(name if obj is None else obj.name)
        choices = {each.name: each.hnf_touch.library for each in bpy.data.materials if each.hnf_touch.library}
        changed |= {name for name, _ in choices.items() ^ self._choices.items()}
        self._choices = choices
        return changed

    def restrict(self, names: set[str]) -> None:
        """Leave out whatever else is pending."""
        self._pending = dict.fromkeys(name for name in self._pending if name in names)

    def check_next(self) -> bool:
        """One look: at a surface, or at a stroke on a surface that is known. True when a status changed."""
        scene = _find_scene(self.scene)
        if scene is None or not self._pending:
            self._pending.clear()
            return False
        view_layer = scene.view_layers.get(self.view_layer) or scene.view_layers[0]
        name = next(iter(self._pending))
        obj = find_object(scene, name)
        if obj is None or not obj.hnf_stroke.is_stroke:
            del self._pending[name]
            return STATE.get_statuses(scene).pop(name, None) is not None
        with suppress_change_tracking(view_layer):
            session = self._open_session(scene, view_layer)
            surface = obj.hnf_stroke.surface
            if surface is not None and surface.mode != "EDIT" and not session.has_facts(surface):
                _try_reading_surface(session, surface)
                if session.has_facts(surface):
                    return False
            status = _compute_status(session, obj)
            self._settings[name] = _read_stroke_settings(obj)
        del self._pending[name]
        changed = STATE.get_statuses(scene).get(name) != status
        STATE.get_statuses(scene)[name] = status
        return changed

    def _open_session(self, scene: Any, view_layer: Any) -> Session:
        from ..touch.session import make_scene_session

        if self._session is None:
            self._session = make_scene_session(scene, view_layer, Path())
        self._session.scene, self._session.view_layer = scene, view_layer
        return self._session


_trackers: dict[str, StatusTracker] = {}


def refresh_status(scene: Any, names: Iterable[str] | None = None, view_layer: Any = None) -> None:
    """Fill STATE.strokes_in(scene) from the stored bakes and the scene as it is: of the strokes named, or of all. Takes
    as long as hashing the surfaces takes."""
    layer = view_layer or scene.view_layers[0]
    watch = StatusTracker(scene, layer)
    if names is not None:
        watch.restrict(set(names))
    while not watch.is_idle:
        watch.check_next()


def process_changes(shown: Iterable[tuple[Any, Any]]) -> bool:
    """Look at what STATE.dirty concerns in the (scene, view layer) pairs shown, for BUDGET_S at most, one look at
    least. True when a status changed."""
    started, changed = time.monotonic(), False
    _remove_deleted_scenes()
    dirty = tuple(STATE.dirty_names)
    STATE.dirty_names.clear()
    pairs = {scene.name: (scene, layer) for scene, layer in shown}
    for name in _trackers.keys() - pairs.keys():
        del _trackers[name]
    for name, (scene, layer) in pairs.items():
        if name not in _trackers:
            _trackers[name] = StatusTracker(scene, layer)
        else:
            _trackers[name].view_layer = layer.name
            _trackers[name].mark_changed(*dirty)
        while not _trackers[name].is_idle and time.monotonic() - started < TICK_BUDGET_S:
            changed = _trackers[name].check_next() or changed
    return changed


def _remove_deleted_scenes() -> None:
    """Those that were removed: no material is felt in them, and no other scene need be told of what is baked."""
    import bpy

    for number in STATE.statuses.keys() - {scene.session_uid for scene in bpy.data.scenes}:
        del STATE.statuses[number]


def clear_trackers() -> None:
    """Another file: nothing is known."""
    _trackers.clear()
    STATE.dirty_names.clear()


def _compute_status(session: Session, obj: Any) -> StrokeStatus:
    from hnf_core.errors import HnfError

    from ..touch.bake_storage import check_validity

    surface = obj.hnf_stroke.surface
    if surface is not None and surface.mode == "EDIT":
        why = tr("'{name}' is in Edit Mode.").format(name=surface.name)
        return StrokeStatus(Freshness.UNKNOWN, why, object_name=surface.name)
    try:
        return check_validity(obj, session.make_curve_job(obj))
    except HnfError as error:
        why = str(error)
    except Exception as error:  # a fault of ours must not end the timer, and with it all statuses
        import traceback

        traceback.print_exc()
        why = f"internal error ({error!r}). Please report it."
    return StrokeStatus(Freshness.BROKEN, why, object_name="" if surface is None else surface.name)


def _get_surface_name(calls: SceneNames, obj: Any, known: StrokeStatus | None) -> str:
    """Name of the surface of stroke obj; known: its status."""
    chosen = obj.hnf_stroke.surface
    if chosen is not None:
        return calls.get_name(chosen)
    return "" if known is None else known.object_name


def _try_reading_surface(session: Session, surface: Any) -> None:
    try:
        session.get_facts(surface)
    except Exception:
        return  # the stroke's own look meets it again, and says it


def _find_scene(name: str) -> Any:
    import bpy

    return bpy.data.scenes.get(name)


def _get_unit_scale(scene: Any) -> tuple[object, ...]:
    units = scene.unit_settings
    return units.system, units.scale_length, scene.hnf.metres_per_unit


def _is_affected(obj: Any, names: set[str]) -> bool:
    """May the object's surface look or feel different where datablocks of these names changed?"""
    from ..bridge.splats.splat_cloud import get_cloud

    cloud = get_cloud(obj)
    parts = (obj, obj.data, cloud, None if cloud is None else cloud.data)
    if any(part is not None and part.name in names for part in parts):
        return True
    return any(slot.material is not None and slot.material.name in names for slot in obj.material_slots)


def _clear_reliefs(names: set[str]) -> None:
    """What was seen of a material where a place was examined holds until the material changes."""
    for material in list(STATE.reliefs):
        if EVERYTHING in names or material in names:
            del STATE.reliefs[material]
    if STATE.query_view is not None and (EVERYTHING in names or STATE.query_view.material in names):
        STATE.query_view = None


def _read_stroke_settings(obj: Any) -> tuple[object, ...]:
    """What a stroke is set to, apart from its keys."""
    group, surface = obj.hnf_stroke, obj.hnf_stroke.surface
    return (*(getattr(group, name) for name in STROKE_SETTINGS), None if surface is None else surface.name)


def _has_unknown_names(names: set[str]) -> bool:
    """Is a name among them that says nothing of whom it concerns (an image, a node group)?"""
    import bpy

    left = names
    for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.curves, bpy.data.materials, bpy.data.actions):
        left = find_absent_names(left, kind)
    return bool(left)


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

        from ..touch.bake_storage import has_tokens
        from ..touch.session import make_scene_session

        if obj.mode == "EDIT":
            raise SceneError("it is in Edit Mode.", where=f"object '{obj.name}'", remedy="Leave Edit Mode.")
        with suppress_change_tracking(view_layer):
            if self._session is None:
                self._session = make_scene_session(scene, view_layer, Path())
            return has_tokens(self._session, obj)
