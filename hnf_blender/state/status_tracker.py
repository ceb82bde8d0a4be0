"""Statuses of strokes that follow the scene: reported changes → affected strokes → checks of their bakes.

A status says whether a stroke's bake is still valid. `StatusTracker` checks the strokes of one scene, a few per tick;
`TokenValidity` checks whether the tokens (material descriptions) baked on a mesh are still valid.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..bridge.scene.object_size import is_visible
from ..bridge.scene.scene_names import SceneNames, find_object
from ..props.scene_settings import list_cached_strokes
from ..touch.bake_status import Freshness, StrokeStatus
from ..translations import tr
from .session_state import STATE, suppress_change_tracking

if TYPE_CHECKING:
    from ..touch.session import Session

FEW_NAMES = 8
"""Number of names up to which they are looked up one by one; for each Blender searches all datablocks of the kind."""


def find_absent_names(names: Set[str], kind: Any) -> set[str]:
    """Return the names that no datablock of a kind (bpy.data.objects, …) has."""
    if len(names) > FEW_NAMES:
        return set(names).difference(kind.keys())
    return {name for name in names if name not in kind}


EVERYTHING = "*"
"""Entry of STATE.dirty_names after an undo, a redo or a new file: everything may have changed."""
STROKE_DATA_KINDS = frozenset({"Object", "Curve", "Action"})
"""Kinds of datablocks that a stroke consists of."""
STROKE_SETTINGS = (
    "start",
    "force",
    "progress",
    "law",
    "speed_mm_s",
    "duration_s",
    "seed",
    "probe",
    "rides",
    "material",
)
"""Settings of a stroke that scripts may change without a notification."""
SETTINGS_PER_CHECK = 8
"""Number of strokes whose settings are compared per check."""
TICK_BUDGET_S = 0.04
"""Time in a tick after which no new check begins [s]; one check of 100,000 faces may take as long again."""


def get_changed_names(depsgraph: Any) -> set[str]:
    """Return the names of changed datablocks that a stroke may consist of, in a depsgraph handler."""
    return {str(update.id.name) for update in depsgraph.updates if update.id.bl_rna.identifier in STROKE_DATA_KINDS}


def get_stroke_data_names(stroke: Any) -> set[str]:
    """Return the names of the datablocks that a stroke consists of: object, curve and action."""
    action = None if stroke.animation_data is None else stroke.animation_data.action
    return {stroke.name, stroke.data.name, *([] if action is None else [action.name])}


class StatusTracker:
    """Queue of a scene's strokes whose bakes are to be checked, with hashes of the surfaces they touch.

    It stores names and hashes, but no Blender data between two calls.
    """

    def __init__(self, scene: Any, view_layer: Any) -> None:
        self.scene, self.view_layer = scene.name, view_layer.name
        self._pending: dict[str, None] = {}
        self._session: Session | None = None
        self._stamp: object = None
        self._settings: dict[str, object] = {}
        self._choices: set[tuple[str, str, str, bool]] = set()
        self._visible: dict[str, tuple[tuple[str, bool], ...]] = {}
        self._baked_surfaces: dict[str, str] = {}
        self.mark_changed(EVERYTHING)

    @property
    def is_idle(self) -> bool:
        return not self._pending

    def mark_changed(self, *changed: str) -> None:
        """Queue the strokes that the changed datablocks may affect."""
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
        scene_names = SceneNames(scene)
        stroke_names = [scene_names.get_name(obj) for obj in strokes]
        statuses = STATE.get_statuses(scene)
        for name in statuses.keys() - set(stroke_names):
            del statuses[name]
        if EVERYTHING in names or stamp != self._stamp:
            self._session, self._stamp = None, stamp
            self._pending.update(dict.fromkeys(stroke_names))
            return
        touched = [
            _get_surface_name(scene_names, obj, statuses.get(name))
            for name, obj in zip(stroke_names, strokes, strict=True)
        ]
        surfaces = self._find_affected_surfaces(scene_names, touched, names)
        if self._session is not None:
            self._session.invalidate(surfaces)
        for name, obj, surface in zip(stroke_names, strokes, touched, strict=True):
            has_own_change = bool(get_stroke_data_names(obj) & names)
            if has_own_change or surface in surfaces or obj.hnf_stroke.surface is None:
                self._pending[name] = None

    def _find_affected_surfaces(self, calls: SceneNames, touched: Iterable[str], names: set[str]) -> set[str]:
        """Return the names of surfaces that the changed datablocks `names` may affect.

        `touched` are the surfaces that strokes touch.
        """
        known = set(touched)
        known |= set() if self._session is None else self._session.known_names
        if _has_unknown_names(names):
            return known
        objects = {name: calls.get_object(name) for name in known}
        return {name for name, obj in objects.items() if obj is None or _is_affected(obj, names)}

    def _find_silent_changes(self, scene: Any) -> set[str]:
        """Return the names of strokes and materials whose settings changed, and of surfaces that were hidden or shown.

        Blender reports neither what scripts set nor what is hidden. A few strokes are compared at a time, since looking
        them up by name is slow with many objects.
        """
        import bpy

        changed = set()
        members = scene.objects[:] if self._settings else []
        for name in list(self._settings)[:SETTINGS_PER_CHECK]:
            # Popping and adding moves the name to the end of the queue.
            previous = self._settings.pop(name)
            obj = find_object(scene, name, members)
            if obj is not None:
                self._settings[name] = _read_stroke_settings(obj)
            if obj is None or self._settings[name] != previous:
                changed.add(name if obj is None else obj.name)
            changed |= self._find_hidden_or_shown(scene, name, obj, members)
        choices = {
            (material.name, material.name_full, material.hnf_touch.library, material.hnf_touch.height_as_authored)
            for material in bpy.data.materials  # A linked one may have the name of another.
            if material.hnf_touch.library or material.hnf_touch.height_as_authored
        }
        changed |= {choice[0] for choice in choices ^ self._choices}
        self._choices = choices
        return changed

    def _find_hidden_or_shown(self, scene: Any, name: str, obj: Any, members: Any = None) -> set[str]:
        """Return the names of a stroke's surfaces if any of them was hidden or shown since the last call.

        They are the one that it touches and, where it names none, the one that it touched when it was baked.
        """
        surface = None if obj is None else obj.hnf_stroke.surface
        surfaces = [] if surface is None else [surface]
        if obj is not None and surface is None:
            status = STATE.get_statuses(scene).get(name)
            names = {"" if status is None else status.object_name, self._baked_surfaces.get(name, "")} - {""}
            surfaces = [found for each in sorted(names) if (found := find_object(scene, each, members)) is not None]
        if not surfaces:
            self._visible.pop(name, None)
            return set()
        layer = scene.view_layers.get(self.view_layer) or scene.view_layers[0]
        seen = tuple((each.name, is_visible(each, layer)) for each in surfaces)
        before, self._visible[name] = self._visible.get(name, seen), seen
        return {each.name for each in surfaces} if seen != before else set()

    def restrict(self, names: set[str]) -> None:
        """Drop queued strokes whose names are not in `names`."""
        self._pending = dict.fromkeys(name for name in self._pending if name in names)

    def check_next(self) -> bool:
        """Check one surface, or one stroke on a known surface; return True if a status changed."""
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
            if obj.hnf_stroke.surface is None:
                self._baked_surfaces[name] = _get_baked_surface(obj)
            session.invalidate(self._find_hidden_or_shown(scene, name, obj))
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
"""Trackers by scene name."""


def refresh_status(scene: Any, names: Iterable[str] | None = None, view_layer: Any = None) -> None:
    """Recompute the statuses of the named strokes, or of all; takes as long as hashing their surfaces.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene whose statuses in STATE are updated.
    names : iterable of str or None
        Names of strokes; None for all.
    view_layer : bpy.types.ViewLayer or None
        View layer to evaluate; None for the first.
    """
    layer = view_layer or scene.view_layers[0]
    tracker = StatusTracker(scene, layer)
    if names is not None:
        tracker.restrict(set(names))
    while not tracker.is_idle:
        tracker.check_next()


def process_changes(shown: Iterable[tuple[Any, Any]]) -> bool:
    """Check the strokes that STATE.dirty_names may affect, in the shown (scene, view layer) pairs.

    Returns True if a status changed. At least one check is made, and none begins after TICK_BUDGET_S.
    """
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
        while not _trackers[name].is_idle:
            changed = _trackers[name].check_next() or changed
            if time.monotonic() - started > TICK_BUDGET_S:
                break
    return changed


def has_pending_checks(scenes: Iterable[Any]) -> bool:
    """Return whether strokes wait for a check: no tick had time for it, or the scene was not shown before."""
    unknown = (scene for scene in scenes if scene.name not in _trackers)
    return any(not tracker.is_idle for tracker in _trackers.values()) or any(map(list_cached_strokes, unknown))


def _remove_deleted_scenes() -> None:
    """Delete the statuses of scenes that do not exist any more."""
    import bpy

    for number in STATE.statuses.keys() - {scene.session_uid for scene in bpy.data.scenes}:
        del STATE.statuses[number]


def clear_trackers() -> None:
    """Discard all trackers, since another file was opened."""
    _trackers.clear()
    STATE.dirty_names.clear()


def _compute_status(session: Session, obj: Any) -> StrokeStatus:
    from hnf_core.errors import HnfError

    from ..touch.bake_storage import check_hidden, check_validity
    from ..touch.material_choice import format_stated_note

    surface = obj.hnf_stroke.surface
    if surface is not None and surface.mode == "EDIT":
        reason = tr("'{name}' is in Edit Mode.").format(name=surface.name)
        return StrokeStatus(Freshness.UNKNOWN, reason, object_name=surface.name)
    hidden = check_hidden(session.scene, session.view_layer, obj)
    if hidden is not None:
        return hidden
    try:
        job = session.make_curve_job(obj)
        status = check_validity(obj, job)
        facts = session.get_facts(find_object(session.scene, job.object_name))
        stated = {name: height for name, height in zip(facts.materials, facts.stated_heights_m, strict=True) if height}
        doubted = tuple(dict.fromkeys((*status.doubted_shaders, *stated)))
        if status.freshness is not Freshness.UNBAKED:
            return status._replace(doubted_shaders=doubted)
        notes = (format_stated_note(name, height) for name, height in stated.items())
        return status._replace(doubted_shaders=doubted, warnings=(*status.warnings, *notes))
    except HnfError as error:
        reason = str(error)
    except Exception as error:  # An unexpected error must not end the timer.
        import traceback

        traceback.print_exc()
        reason = f"internal error ({error!r}). Please report it."
    return StrokeStatus(Freshness.BROKEN, reason, object_name="" if surface is None else surface.name)


def _get_surface_name(calls: SceneNames, obj: Any, known: StrokeStatus | None) -> str:
    """Return the name of the surface that a stroke touches, from its setting or its known status."""
    surface = obj.hnf_stroke.surface
    if surface is not None:
        return calls.get_name(surface)
    return "" if known is None else known.object_name


def _get_baked_surface(obj: Any) -> str:
    """Return the name of the surface that a stroke touched when it was baked; "" if it has no bake."""
    from hnf_core.errors import HnfError

    from ..touch.stroke_bake import load_bake

    try:
        bake = load_bake(obj)
    except HnfError:
        return ""
    return "" if bake is None else str(bake.facts.get("object", ""))


def _try_reading_surface(session: Session, surface: Any) -> None:
    try:
        session.get_facts(surface)
    except Exception:
        return  # The check of the stroke raises it again and reports it.


def _find_scene(name: str) -> Any:
    import bpy

    return bpy.data.scenes.get(name)


def _get_unit_scale(scene: Any) -> tuple[object, ...]:
    units = scene.unit_settings
    return units.system, units.scale_length, scene.hnf.metres_per_unit


def _is_affected(obj: Any, names: set[str]) -> bool:
    """Return whether the object's surface may depend on one of the named datablocks."""
    from ..bridge.splat_cloud import get_cloud

    cloud = get_cloud(obj)
    datablocks = (obj, obj.data, cloud, None if cloud is None else cloud.data)
    if any(datablock is not None and datablock.name in names for datablock in datablocks):
        return True
    return any(slot.material is not None and slot.material.name in names for slot in obj.material_slots)


def _clear_reliefs(names: set[str]) -> None:
    """Discard the results of touch queries on materials that changed."""
    for material in list(STATE.reliefs):
        if EVERYTHING in names or material in names:
            del STATE.reliefs[material]
    if STATE.query_view is not None and (EVERYTHING in names or STATE.query_view.material in names):
        STATE.query_view = None


def _read_stroke_settings(obj: Any) -> tuple[object, ...]:
    """Return the settings of a stroke, apart from its keyframes."""
    group, surface = obj.hnf_stroke, obj.hnf_stroke.surface
    return (*(getattr(group, name) for name in STROKE_SETTINGS), None if surface is None else surface.name)


def _has_unknown_names(names: set[str]) -> bool:
    """Return whether a name belongs to a kind that may affect anything (an image, a node group)."""
    import bpy

    remaining = names
    for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.curves, bpy.data.materials, bpy.data.actions):
        remaining = find_absent_names(remaining, kind)
    return bool(remaining)


class TokenValidity:
    """Validity of the tokens baked on meshes, checked once per surface until people change something.

    A check takes as long as hashing the surface. While the timeline plays, every frame changes something, so results
    are reused. `outdated` has the reason for each invalid object, by its name.
    """

    def __init__(self) -> None:
        self.outdated: dict[str, str] = {}
        self._session: Session | None = None
        self._results: dict[str, bool] = {}
        self._changes = -1

    def is_valid(self, obj: Any, scene: Any, view_layer: Any) -> bool:
        """Return whether an object's baked tokens are still valid; False if that is unknown, e.g. in Edit Mode."""
        import bpy

        from hnf_core.errors import HnfError

        is_animating = any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows)
        if self._changes != STATE.changes and not (is_animating and self._results):
            self._session, self._changes = None, STATE.changes
            self._results.clear()
            self.outdated.clear()
        name = str(obj.name)
        if name not in self._results:
            try:
                self._results[name] = self._check(obj, scene, view_layer)
                reason = "" if self._results[name] else tr("'{name}' changed since it was baked").format(name=name)
            except HnfError as error:
                self._results[name], reason = False, str(error)
            if reason:
                self.outdated[name] = reason
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
