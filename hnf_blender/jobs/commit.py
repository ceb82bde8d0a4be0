"""The results of a job → the scene, where what they were made from is still so."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError

from ..bridge.scene.mesh_attributes import FaceTokens, write_tokens
from ..bridge.scene.scene_names import get_named_objects, get_scene_name
from ..bridge.splats.splat_cloud import get_cloud, require_writable, write_point_tokens
from ..state.session_state import STATE, suppress_change_tracking
from ..touch.bake_storage import make_status, save_bake
from ..touch.freshness import Freshness
from ..touch.session import InputHashes, Session, make_scene_session
from ..touch.stroke_bake import StrokeBake
from .request import BakedFile, JobResult, Rejection, TokenFile, unpack_tokens

MAX_ROUNDS = 3
"""How often what changes while it is looked at is looked at again, bit by bit, before it is done in one go."""
REBAKE_HINT = "It keeps what it had; bake it again."


@dataclass(frozen=True)
class CommitTarget:
    """Where the results belong: what was renamed meanwhile is found, and what took its name is not taken for it.

    scene, view_layer: names when the job began. scene_uid: session_uid. layer_index: of the view layer, which has no
    such number. uids: name (name_in) → session_uid of the scene's objects."""

    scene: str
    scene_uid: int
    view_layer: str
    layer_index: int
    uids: Mapping[str, int]


@dataclass
class CommitResult:
    """strokes, meshes: names of what was written. refused: what was not, and why."""

    strokes: list[str] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)
    refused: list[Rejection] = field(default_factory=list)


@dataclass
class _Verified:
    """What may be written, by session_uid: a reference would not live until then. names: of these strokes when the
    job began; rechosen: of those for which another material was chosen meanwhile."""

    strokes: list[tuple[int, StrokeBake, InputHashes]] = field(default_factory=list)
    meshes: list[tuple[int, FaceTokens]] = field(default_factory=list)
    refused: list[Rejection] = field(default_factory=list)
    stroke_names: set[str] = field(default_factory=set)
    rechosen_strokes: set[str] = field(default_factory=set)


def make_commit_target(scene: Any, view_layer: Any) -> CommitTarget:
    """As the scene is now."""
    uids = {name: obj.session_uid for name, obj in get_named_objects(scene).items()}
    return CommitTarget(scene.name, scene.session_uid, view_layer.name, scene.view_layers.find(view_layer.name), uids)


def find_target_scene(target: CommitTarget) -> Any:
    """Its scene, whatever that is called now; None where it is gone."""
    import bpy

    return next((scene for scene in bpy.data.scenes if scene.session_uid == target.scene_uid), None)


def commit_steps(result: JobResult, folder: Path, target: CommitTarget) -> Generator[None, None, CommitResult]:
    """Compare, stroke by stroke and mesh by mesh; then write all that is still true, at once.

    Yields between comparisons: a window goes on meanwhile, and what changes there is compared anew. Whatever can fail
    fails before the first write. The caller makes the undo step. Raises HnfError where the folder is damaged or the
    scene is gone.
    """
    for attempt in range(MAX_ROUNDS + 1):
        patient = attempt < MAX_ROUNDS
        ready, seen = _Verified(), _count_changes(target)
        session = make_scene_session(*_require_target_scene(target), folder)
        for compare in _list_comparisons(result, folder, target, session, ready):
            session.scene, session.view_layer = _require_target_scene(
                target
            )  # an undo since the last step replaced them
            with suppress_change_tracking(session.view_layer):
                compare()
            if patient:
                yield
                if _count_changes(target) != seen:
                    break
        if not patient or _count_changes(target) == seen:
            break
    scene, view_layer = _require_target_scene(target)
    with suppress_change_tracking(view_layer):
        return _write(ready, scene)


def _count_changes(target: CommitTarget) -> int:
    """STATE.changes, what Blender has not told yet included."""
    _require_target_scene(target)[1].update()
    return STATE.changes


def _require_target_scene(target: CommitTarget) -> tuple[Any, Any]:
    scene = find_target_scene(target)
    if scene is None:
        raise HnfError(
            "the scene that was baked is gone.", where=f"scene '{target.scene}'", remedy="Undo that, and bake again."
        )
    layers = scene.view_layers
    found = layers.get(target.view_layer)
    return scene, layers[min(target.layer_index, len(layers) - 1)] if found is None else found


def _list_comparisons(
    result: JobResult, folder: Path, target: CommitTarget, session: Session, verified: _Verified
) -> Iterator[Callable[[], None]]:
    """One stroke or mesh each; strokes first, since a mesh goes by what became of them."""

    for baked in result.strokes:
        yield partial(_compare_stroke, baked, folder, target, session, verified)
    for tokens in result.meshes:
        yield partial(_compare_mesh, tokens, folder, target, session, verified)


def _compare_stroke(
    baked: BakedFile, folder: Path, target: CommitTarget, session: Session, verified: _Verified
) -> None:
    problem = _check_stroke(baked, folder, target, session, verified)
    if problem:
        verified.refused.append(Rejection(baked.stroke, problem))


def _compare_mesh(tokens: TokenFile, folder: Path, target: CommitTarget, session: Session, verified: _Verified) -> None:
    problem = _check_mesh(tokens, folder, target, session, verified)
    if problem:
        verified.refused.append(Rejection(tokens.object_name, problem))


def _check_stroke(baked: BakedFile, folder: Path, target: CommitTarget, session: Session, verified: _Verified) -> str:
    """Why it cannot be kept; "" where it is ready."""
    where = f"stroke '{baked.stroke}'"
    obj = _find_object(session.scene, target, baked.stroke)
    if obj is None or not obj.hnf_stroke.is_stroke:
        return f"{where}: it was deleted while it was baked; its bake is dropped."
    if obj.library is not None:
        return (
            f"{where}: it is linked from {obj.library.filepath} and cannot be written. Make it local to keep its bake."
        )
    try:
        job = session.make_curve_job(obj)
    except HnfError as error:
        return f"{where}: it changed while it was baked, and now: {error}"
    changed = job.inputs.describe_changes(baked.inputs)
    if job.inputs.choices != baked.inputs.choices:
        verified.rechosen_strokes.add(baked.stroke)
    if changed:
        return f"{where}: {' and '.join(changed)} changed while it was baked. {REBAKE_HINT}"
    bake = StrokeBake.from_bytes((folder / baked.file).read_bytes(), where=where)
    verified.strokes.append((obj.session_uid, bake, baked.inputs))
    verified.stroke_names.add(baked.stroke)
    return ""


def _check_mesh(tokens: TokenFile, folder: Path, target: CommitTarget, session: Session, verified: _Verified) -> str:
    where = f"object '{tokens.object_name}'"
    obj = _find_object(session.scene, target, tokens.object_name)
    if obj is None or obj.type != "MESH":
        return f"{where}: it was deleted while it was baked; its tokens are dropped."
    if obj.data.library is not None:
        return (
            f"{where}: its mesh is linked from {obj.data.library.filepath} and keeps no tokens; its strokes are heard "
            "all the same. Make it local to keep them."
        )
    if obj.data.is_editmode:
        return f"{where}: its mesh is in Edit Mode and got no tokens. Leave Edit Mode and bake again."
    if not any(name in verified.stroke_names for name in tokens.strokes):
        return f"{where}: no stroke on it could keep its bake, so it got no tokens."
    if verified.rechosen_strokes & set(tokens.strokes):
        return f"{where}: a material choice changed while it was baked. {REBAKE_HINT}"
    try:
        same = session.compute_surface_key(obj) == tokens.surface_key
        if (cloud := get_cloud(obj)) is not None:
            require_writable(cloud)
    except HnfError as error:
        return f"{where}: it changed while it was baked, and now: {error}"
    if not same:
        return f"{where}: its shape or its materials changed while it was baked. {REBAKE_HINT}"
    made = unpack_tokens((folder / tokens.file).read_bytes())
    if len(made.index) != len(obj.data.polygons):
        return f"{where}: its faces changed while it was baked. {REBAKE_HINT}"
    verified.meshes.append((obj.session_uid, made))
    return ""


def _find_object(scene: Any, target: CommitTarget, name: str) -> Any:
    """The object that had this name when the job began, or None."""
    return _index_by_uid(scene).get(target.uids.get(name, -1))


def _index_by_uid(scene: Any) -> dict[int, Any]:
    return {obj.session_uid: obj for obj in scene.objects}


def _write(verified: _Verified, scene: Any) -> CommitResult:
    STATE.plan = None  # it spoke of before
    objects = _index_by_uid(scene)
    done = CommitResult(refused=verified.refused)
    for uid, bake, inputs in verified.strokes:
        obj = objects[uid]
        save_bake(obj, bake, inputs)
        STATE.get_statuses(scene)[get_scene_name(scene, obj)] = make_status(bake, Freshness.FRESH)
        if len(STATE.statuses) > 1:
            STATE.dirty_names.add(obj.name)  # where it stands in another scene too, it may be stale there
        done.strokes.append(obj.name)
    for uid, tokens in verified.meshes:
        write_tokens(objects[uid].data, tokens)
        if tokens.points is not None:
            write_point_tokens(get_cloud(objects[uid]), tokens.points)
        done.meshes.append(objects[uid].data.name)
    return done
