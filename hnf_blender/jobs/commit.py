"""The results of a job → the scene, where what they were made from is still so."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError

from ..bridge.scene_names import name_in, named_objects
from ..bridge.splat_cloud import cloud_of, require_writable, write_point_tokens
from ..bridge.storage import FaceTokens, write_tokens
from ..state.guard import own_changes
from ..state.session import STATE
from ..touch.inputs import Inputs
from ..touch.jobs import Session, scene_session
from ..touch.status import Freshness
from ..touch.stored import keep, status_of
from ..touch.stroke_bake import StrokeBake
from .order import BakedFile, Refusal, Result, TokenFile, unpack_tokens

ROUNDS = 3
"""How often what changes while it is looked at is looked at again, bit by bit, before it is done in one go."""
AGAIN = "It keeps what it had; bake it again."


@dataclass(frozen=True)
class Place:
    """Where the results belong: what was renamed meanwhile is found, and what took its name is not taken for it.

    scene, view_layer: names when the job began. scene_uid: session_uid. layer_index: of the view layer, which has no
    such number. uids: name (name_in) → session_uid of the scene's objects."""

    scene: str
    scene_uid: int
    view_layer: str
    layer_index: int
    uids: Mapping[str, int]


@dataclass
class Committed:
    """strokes, meshes: names of what was written. refused: what was not, and why."""

    strokes: list[str] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)
    refused: list[Refusal] = field(default_factory=list)


@dataclass
class _Ready:
    """What may be written, by session_uid: a reference would not live until then. names: of these strokes when the
    job began; rechosen: of those for which another material was chosen meanwhile."""

    strokes: list[tuple[int, StrokeBake, Inputs]] = field(default_factory=list)
    meshes: list[tuple[int, FaceTokens]] = field(default_factory=list)
    refused: list[Refusal] = field(default_factory=list)
    names: set[str] = field(default_factory=set)
    rechosen: set[str] = field(default_factory=set)


def place_of(scene: Any, view_layer: Any) -> Place:
    """As the scene is now."""
    uids = {name: obj.session_uid for name, obj in named_objects(scene).items()}
    return Place(scene.name, scene.session_uid, view_layer.name, scene.view_layers.find(view_layer.name), uids)


def scene_of(place: Place) -> Any:
    """Its scene, whatever that is called now; None where it is gone."""
    import bpy

    return next((scene for scene in bpy.data.scenes if scene.session_uid == place.scene_uid), None)


def commit_steps(result: Result, folder: Path, place: Place) -> Generator[None, None, Committed]:
    """Compare, stroke by stroke and mesh by mesh; then write all that is still true, at once.

    Yields between comparisons: a window goes on meanwhile, and what changes there is compared anew. Whatever can fail
    fails before the first write. The caller makes the undo step. Raises HnfError where the folder is damaged or the
    scene is gone.
    """
    for attempt in range(ROUNDS + 1):
        patient = attempt < ROUNDS
        ready, seen = _Ready(), _changes(place)
        session = scene_session(*_scene(place), folder)
        for compare in _comparisons(result, folder, place, session, ready):
            session.scene, session.view_layer = _scene(place)  # an undo since the last step replaced them
            with own_changes(session.view_layer):
                compare()
            if patient:
                yield
                if _changes(place) != seen:
                    break
        if not patient or _changes(place) == seen:
            break
    scene, view_layer = _scene(place)
    with own_changes(view_layer):
        return _write(ready, scene)


def _changes(place: Place) -> int:
    """STATE.changes, what Blender has not told yet included."""
    _scene(place)[1].update()
    return STATE.changes


def _scene(place: Place) -> tuple[Any, Any]:
    scene = scene_of(place)
    if scene is None:
        raise HnfError(
            "the scene that was baked is gone.", where=f"scene '{place.scene}'", remedy="Undo that, and bake again."
        )
    layers = scene.view_layers
    found = layers.get(place.view_layer)
    return scene, layers[min(place.layer_index, len(layers) - 1)] if found is None else found


def _comparisons(
    result: Result, folder: Path, place: Place, session: Session, ready: _Ready
) -> Iterator[Callable[[], None]]:
    """One stroke or mesh each; strokes first, since a mesh goes by what became of them."""

    for baked in result.strokes:
        yield partial(_compare_stroke, baked, folder, place, session, ready)
    for tokens in result.meshes:
        yield partial(_compare_mesh, tokens, folder, place, session, ready)


def _compare_stroke(baked: BakedFile, folder: Path, place: Place, session: Session, ready: _Ready) -> None:
    problem = _problem_of_stroke(baked, folder, place, session, ready)
    if problem:
        ready.refused.append(Refusal(baked.stroke, problem))


def _compare_mesh(tokens: TokenFile, folder: Path, place: Place, session: Session, ready: _Ready) -> None:
    problem = _problem_of_mesh(tokens, folder, place, session, ready)
    if problem:
        ready.refused.append(Refusal(tokens.object_name, problem))


def _problem_of_stroke(baked: BakedFile, folder: Path, place: Place, session: Session, ready: _Ready) -> str:
    """Why it cannot be kept; "" where it is ready."""
    where = f"stroke '{baked.stroke}'"
    obj = _find(session.scene, place, baked.stroke)
    if obj is None or not obj.hnf_stroke.is_stroke:
        return f"{where}: it was deleted while it was baked; its bake is dropped."
    if obj.library is not None:
        return (
            f"{where}: it is linked from {obj.library.filepath} and cannot be written. Make it local to keep its bake."
        )
    try:
        job = session.job_of_curve(obj)
    except HnfError as error:
        return f"{where}: it changed while it was baked, and now: {error}"
    changed = job.inputs.changes(baked.inputs)
    if job.inputs.choices != baked.inputs.choices:
        ready.rechosen.add(baked.stroke)
    if changed:
        return f"{where}: {' and '.join(changed)} changed while it was baked. {AGAIN}"
    bake = StrokeBake.from_bytes((folder / baked.file).read_bytes(), where=where)
    ready.strokes.append((obj.session_uid, bake, baked.inputs))
    ready.names.add(baked.stroke)
    return ""


def _problem_of_mesh(tokens: TokenFile, folder: Path, place: Place, session: Session, ready: _Ready) -> str:
    where = f"object '{tokens.object_name}'"
    obj = _find(session.scene, place, tokens.object_name)
    if obj is None or obj.type != "MESH":
        return f"{where}: it was deleted while it was baked; its tokens are dropped."
    if obj.data.library is not None:
        return (
            f"{where}: its mesh is linked from {obj.data.library.filepath} and keeps no tokens; its strokes are heard "
            "all the same. Make it local to keep them."
        )
    if obj.data.is_editmode:
        return f"{where}: its mesh is in Edit Mode and got no tokens. Leave Edit Mode and bake again."
    if not any(name in ready.names for name in tokens.strokes):
        return f"{where}: no stroke on it could keep its bake, so it got no tokens."
    if ready.rechosen & set(tokens.strokes):
        return f"{where}: a material choice changed while it was baked. {AGAIN}"
    try:
        same = session.surface_key(obj) == tokens.surface_key
        if (cloud := cloud_of(obj)) is not None:
            require_writable(cloud)
    except HnfError as error:
        return f"{where}: it changed while it was baked, and now: {error}"
    if not same:
        return f"{where}: its shape or its materials changed while it was baked. {AGAIN}"
    made = unpack_tokens((folder / tokens.file).read_bytes())
    if len(made.index) != len(obj.data.polygons):
        return f"{where}: its faces changed while it was baked. {AGAIN}"
    ready.meshes.append((obj.session_uid, made))
    return ""


def _find(scene: Any, place: Place, name: str) -> Any:
    """The object that had this name when the job began, or None."""
    return _by_uid(scene).get(place.uids.get(name, -1))


def _by_uid(scene: Any) -> dict[int, Any]:
    return {obj.session_uid: obj for obj in scene.objects}


def _write(ready: _Ready, scene: Any) -> Committed:
    STATE.plan = None  # it spoke of before
    objects = _by_uid(scene)
    done = Committed(refused=ready.refused)
    for uid, bake, inputs in ready.strokes:
        obj = objects[uid]
        keep(obj, bake, inputs)
        STATE.strokes_in(scene)[name_in(scene, obj)] = status_of(bake, Freshness.FRESH)
        if len(STATE.statuses) > 1:
            STATE.dirty.add(obj.name)  # where it stands in another scene too, it may be stale there
        done.strokes.append(obj.name)
    for uid, tokens in ready.meshes:
        write_tokens(objects[uid].data, tokens)
        if tokens.points is not None:
            write_point_tokens(cloud_of(objects[uid]), tokens.points)
        done.meshes.append(objects[uid].data.name)
    return done
