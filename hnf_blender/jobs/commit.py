"""Commit of a job: results whose inputs have not changed since are written to the scene, the others are rejected."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError

from ..bridge.scene.scene_names import get_named_objects, get_scene_name
from ..bridge.scene.stored_data import FaceTokens, write_tokens
from ..bridge.splat_cloud import get_cloud, require_writable, write_point_tokens
from ..state.session_state import STATE, suppress_change_tracking
from ..touch.bake_status import Freshness
from ..touch.bake_storage import ignore_rounding, make_status, save_bake
from ..touch.session import InputHashes, Session, make_scene_session
from ..touch.stroke_bake import StrokeBake
from .request import BakedFile, JobResult, Rejection, TokenFile, unpack_tokens

MAX_ROUNDS = 3
"""Number of attempts to compare while the scene may change, before it is done without yielding."""
REBAKE_HINT = "It keeps what it had; bake it again."
"""Remedy appended to rejections."""


@dataclass(frozen=True)
class CommitTarget:
    """Scene to which a job's results are written, identified even if it or its objects are renamed meanwhile.

    New data of the same name is not mistaken for it.

    Attributes
    ----------
    scene, view_layer : str
        Names when the job began.
    scene_uid : int
        session_uid of the scene.
    layer_index : int
        Index of the view layer, which has no session_uid.
    uids : mapping
        session_uid of the scene's objects by name.
    """

    scene: str
    scene_uid: int
    view_layer: str
    layer_index: int
    uids: Mapping[str, int]


@dataclass
class CommitResult:
    """Names of strokes and meshes that were written, and rejections with their reasons."""

    strokes: list[str] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)
    refused: list[Rejection] = field(default_factory=list)


@dataclass
class _Verified:
    """Results that may be written, by session_uid, since Python references to objects may become invalid until then.

    `stroke_names` are names when the job began; `rechosen_strokes` are strokes for which another material was chosen
    since.
    """

    strokes: list[tuple[int, StrokeBake, InputHashes]] = field(default_factory=list)
    meshes: list[tuple[int, FaceTokens]] = field(default_factory=list)
    refused: list[Rejection] = field(default_factory=list)
    stroke_names: set[str] = field(default_factory=set)
    rechosen_strokes: set[str] = field(default_factory=set)


def make_commit_target(scene: Any, view_layer: Any) -> CommitTarget:
    """Identify the scene and its objects as they are now, for the time when the job has ended."""
    uids = {name: obj.session_uid for name, obj in get_named_objects(scene).items()}
    return CommitTarget(scene.name, scene.session_uid, view_layer.name, scene.view_layers.find(view_layer.name), uids)


def find_target_scene(target: CommitTarget) -> Any:
    """Return the scene of a job under its current name, or None if it was deleted."""
    import bpy

    return next((scene for scene in bpy.data.scenes if scene.session_uid == target.scene_uid), None)


def commit_steps(result: JobResult, folder: Path, target: CommitTarget) -> Generator[None, None, CommitResult]:
    """Compare the inputs of all strokes and meshes with the scene, then write all valid results at once.

    Yields between comparisons, so that the window stays responsive; what changes meanwhile is compared again. Anything
    that can fail does so before the first write. The caller pushes the undo step.

    Parameters
    ----------
    result : JobResult
        Results of the job.
    folder : Path
        Folder of the job.
    target : CommitTarget
        Scene when the job began.

    Returns
    -------
    CommitResult
        What was written and what was rejected.

    Raises
    ------
    HnfError
        If the folder is damaged or the scene was deleted.
    """
    for attempt in range(MAX_ROUNDS + 1):
        may_yield = attempt < MAX_ROUNDS
        verified, change_count = _Verified(), _count_changes(target)
        session = make_scene_session(*_require_target_scene(target), folder)
        for compare in _list_comparisons(result, folder, target, session, verified):
            # An undo since the last step may have replaced the scene's data.
            session.scene, session.view_layer = _require_target_scene(target)
            with suppress_change_tracking(session.view_layer):
                compare()
            if may_yield:
                yield
                if _count_changes(target) != change_count:
                    break
        if not may_yield or _count_changes(target) == change_count:
            break
    scene, view_layer = _require_target_scene(target)
    with suppress_change_tracking(view_layer):
        return _write(verified, scene)


def _count_changes(target: CommitTarget) -> int:
    """Return the counter of scene changes (STATE.changes) after Blender has processed pending ones."""
    _require_target_scene(target)[1].update()
    return STATE.changes


def _require_target_scene(target: CommitTarget) -> tuple[Any, Any]:
    scene = find_target_scene(target)
    if scene is None:
        raise HnfError(
            "the scene that was baked is gone.", where=f"scene '{target.scene}'", remedy="Undo that, and bake again."
        )
    layers = scene.view_layers
    layer = layers.get(target.view_layer)
    return scene, layers[min(target.layer_index, len(layers) - 1)] if layer is None else layer


def _list_comparisons(
    result: JobResult, folder: Path, target: CommitTarget, session: Session, verified: _Verified
) -> Iterator[Callable[[], None]]:
    """Yield a function per stroke, then one per mesh, that checks if its result may be written.

    Meshes follow because they depend on the outcome of their strokes.
    """
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
    """Return why a stroke's bake is rejected, or "" after adding it to `verified`."""
    label = f"stroke '{baked.stroke}'"
    obj = _find_object(session.scene, target, baked.stroke)
    if obj is None or not obj.hnf_stroke.is_stroke:
        return f"{label}: it was deleted while it was baked; its bake is dropped."
    if obj.library is not None:
        return (
            f"{label}: it is linked from {obj.library.filepath} and cannot be written. Make it local to keep its bake."
        )
    try:
        job = session.make_curve_job(obj)
    except HnfError as error:
        return f"{label}: it changed while it was baked, and now: {error}"
    bake = StrokeBake.from_bytes((folder / baked.file).read_bytes(), where=label)
    changes = ignore_rounding(job, baked.inputs, bake).describe_changes(baked.inputs)
    if job.inputs.choices != baked.inputs.choices:
        verified.rechosen_strokes.add(baked.stroke)
    if changes:
        return f"{label}: {' and '.join(changes)} changed while it was baked. {REBAKE_HINT}"
    verified.strokes.append((obj.session_uid, bake, baked.inputs))
    verified.stroke_names.add(baked.stroke)
    return ""


def _check_mesh(tokens: TokenFile, folder: Path, target: CommitTarget, session: Session, verified: _Verified) -> str:
    """Return why a mesh's tokens are rejected, or "" after adding them to `verified`."""
    label = f"object '{tokens.object_name}'"
    obj = _find_object(session.scene, target, tokens.object_name)
    if obj is None or obj.type != "MESH":
        return f"{label}: it was deleted while it was baked; its tokens are dropped."
    if obj.data.library is not None:
        return (
            f"{label}: its mesh is linked from {obj.data.library.filepath} and keeps no tokens; its strokes are heard "
            "all the same. Make it local to keep them."
        )
    if obj.data.is_editmode:
        return f"{label}: its mesh is in Edit Mode and got no tokens. Leave Edit Mode and bake again."
    if not any(name in verified.stroke_names for name in tokens.strokes):
        return f"{label}: no stroke on it could keep its bake, so it got no tokens."
    if verified.rechosen_strokes & set(tokens.strokes):
        return f"{label}: a material choice changed while it was baked. {REBAKE_HINT}"
    try:
        is_unchanged = session.compute_surface_key(obj) == tokens.surface_key
        if (cloud := get_cloud(obj)) is not None:
            require_writable(cloud)
    except HnfError as error:
        return f"{label}: it changed while it was baked, and now: {error}"
    if not is_unchanged:
        return f"{label}: its shape or its materials changed while it was baked. {REBAKE_HINT}"
    face_tokens = unpack_tokens((folder / tokens.file).read_bytes())
    if len(face_tokens.index) != len(obj.data.polygons):
        return f"{label}: its faces changed while it was baked. {REBAKE_HINT}"
    verified.meshes.append((obj.session_uid, face_tokens))
    return ""


def _find_object(scene: Any, target: CommitTarget, name: str) -> Any:
    """Return the object that had the name `name` when the job began, or None."""
    return _index_by_uid(scene).get(target.uids.get(name, -1))


def _index_by_uid(scene: Any) -> dict[int, Any]:
    return {obj.session_uid: obj for obj in scene.objects}


def _write(verified: _Verified, scene: Any) -> CommitResult:
    STATE.plan = None  # The plan is outdated.
    objects = _index_by_uid(scene)
    result = CommitResult(refused=verified.refused)
    for uid, bake, inputs in verified.strokes:
        obj = objects[uid]
        save_bake(obj, bake, inputs)
        STATE.get_statuses(scene)[get_scene_name(scene, obj)] = make_status(bake, Freshness.FRESH)
        if len(STATE.statuses) > 1:
            # The stroke may be stale in another scene.
            STATE.dirty_names.add(obj.name)
        result.strokes.append(obj.name)
    for uid, tokens in verified.meshes:
        write_tokens(objects[uid].data, tokens)
        if tokens.points is not None:
            write_point_tokens(get_cloud(objects[uid]), tokens.points)
        result.meshes.append(objects[uid].data.name)
    return result
