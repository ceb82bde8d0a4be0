"""Store bakes in the scene: tokens on meshes and splats, and each stroke's bake on its curve object.

A token describes a material's micro-geometry. The hashes of a bake's inputs are stored with it, so that the reason can
be named if it is no longer valid (`check_validity`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import FileError, HnfError, SceneError, StrokeError
from hnf_core.files import content_hash
from hnf_core.material.palette import Palette, build_palette
from hnf_core.material.token import ENCODER_ID, LEVELS, split_encoders
from hnf_core.scene.camera import CAMERA_DISTANCE_M
from hnf_core.scene.mesh import crop_mesh

from ..bridge.scene import stored_data
from ..bridge.scene.object_size import is_visible
from ..bridge.scene.scene_names import find_object, get_scene_name
from ..bridge.scene.stored_data import SOURCE_PROPERTY, UNBAKED, FaceTokens, PointTokens, read_tokens, write_tokens
from ..bridge.splat_cloud import compute_cloud_frame, get_cloud, read_cloud, write_point_tokens
from ..bridge.stroke.read_stroke import hash_touch, trace_path
from ..props.scene_settings import find_index
from ..translations import tr
from .bake_patches import TouchedObject, get_encoder_name
from .bake_status import Freshness, StrokeStatus
from .baked_stroke import BakedStroke
from .session import InputHashes, Session, StrokeJob, SurfaceFacts
from .stroke_bake import BAKE_PROPERTY, StrokeBake, load_bake, remove_bake, store_bake


def group_by_mesh(strokes: Sequence[BakedStroke]) -> list[list[BakedStroke]]:
    """Group strokes by the mesh that they touch; of a stroke across several objects, each its own part."""
    groups: dict[str, list[BakedStroke]] = {}
    for part in (part for stroke in strokes for part in stroke.split_by_object()):
        groups.setdefault(part.touched.obj.data.name_full, []).append(part)
    return list(groups.values())


def store_tokens(strokes: Sequence[BakedStroke]) -> tuple[str, ...]:
    """Write the tokens of every touched mesh; return a warning for each that cannot be written."""
    warnings = []
    for group in group_by_mesh(strokes):
        obj = group[0].touched.obj
        if obj.type != "MESH":
            warnings.append(f"object '{obj.name}' has no mesh of its own: its tokens are not stored in the .blend.")
            continue
        try:
            tokens = make_face_tokens(obj.data, group)
            write_tokens(obj.data, tokens)
            if tokens.points is not None:
                write_point_tokens(get_cloud(obj), tokens.points)
        except SceneError as error:
            warnings.append(str(error))
    return tuple(warnings)


def make_face_tokens(mesh: Any, strokes: Sequence[BakedStroke], sources: Set[str] = frozenset()) -> FaceTokens:
    """Make the tokens per face of a mesh from the strokes that touch it.

    Faces under a patch get its token; of overlapping patches the last counts. Other faces keep the tokens of an earlier
    bake while mesh and shaders are unchanged.

    Parameters
    ----------
    mesh : bpy.types.Mesh
        Touched mesh.
    strokes : sequence of BakedStroke
        Strokes that touch it.
    sources : set of str, optional
        Hashes of other surfaces with this mesh (`find_shared_sources`), whose tokens are kept too.

    Returns
    -------
    FaceTokens
    """
    source = hash_surface_source(strokes[0].touched)
    earlier = _read_valid_tokens(mesh, {source, *sources})
    count = len(mesh.polygons)
    index = np.full(count, UNBAKED, dtype=np.int32)
    confidence = np.zeros(count, dtype=np.float32)
    tokens, mechanics, names, encoder_names = [], [], [], {ENCODER_ID}
    if earlier is not None:
        index, confidence = earlier.index.copy(), earlier.confidence.copy()
        tokens, mechanics = list(earlier.palette.tokens), list(earlier.palette.mechanics)
        names = list(earlier.palette.names)
        encoder_names.update(split_encoders(earlier.palette.encoder_id))
    for stroke in strokes:
        for material, record, fused in zip(stroke.materials, stroke.records, stroke.fused, strict=True):
            index[record.faces] = len(tokens)
            confidence[record.faces] = fused.confidence
            tokens.append(fused.values)
            mechanics.append(material.library.mechanics)
            names.append(material.library.name)
            encoder_names.update({get_encoder_name(record)} - {""})
    used = sorted(set(index[index >= 0].tolist()))
    palette, merged = build_palette(
        [tokens[i] for i in used], [mechanics[i] for i in used], [names[i] for i in used], encoders=encoder_names
    )
    lookup = np.full(len(tokens) + 1, UNBAKED, dtype=np.int32)
    lookup[used] = merged
    index = lookup[index]  # UNBAKED is −1, the last entry
    points = make_point_tokens(strokes[0].touched, index, confidence)
    return FaceTokens(palette, index, _compute_roughness(palette, index), confidence, source, points)


def make_point_tokens(
    touched: TouchedObject, index: NDArray[np.int32], confidence: NDArray[np.float32]
) -> PointTokens | None:
    """Make the tokens of the splats of a reconstructed surface; None if there are no splats.

    Each splat gets the token of the nearest face within CAMERA_DISTANCE_M. `index` and `confidence` (F,) are those of
    the faces of the object's own mesh.
    """
    cloud = get_cloud(touched.obj)
    if cloud is None:
        return None
    from hnf_core.scene.splats.tsdf import find_nearest_triangles

    mesh, source_face = touched.surface.mesh, touched.surface.source_face
    splats = compute_cloud_frame(touched.obj, cloud, touched.surface.stretch).to_surface(read_cloud(cloud).means)
    face = mesh.face if source_face is None else source_face[mesh.face]
    tokens = PointTokens(np.full(len(splats), UNBAKED, dtype=np.int32), np.zeros(len(splats), dtype=np.float32))
    baked = mesh.vertices[mesh.triangles[(face >= 0) & (index[face] != UNBAKED)]].reshape(-1, 3)
    if len(baked) == 0:
        return tokens
    low, high = baked.min(axis=0) - CAMERA_DISTANCE_M, baked.max(axis=0) + CAMERA_DISTANCE_M
    selected = np.flatnonzero(((splats >= low) & (splats <= high)).all(axis=1))
    cropped = crop_mesh(mesh, [(low + high) / 2.0], float((high - low).max() / 2.0) + CAMERA_DISTANCE_M)
    closest = find_nearest_triangles(cropped.vertices, cropped.triangles, splats[selected], CAMERA_DISTANCE_M)
    selected, triangle = selected[closest.triangle >= 0], closest.triangle[closest.triangle >= 0]
    nearest = cropped.face[triangle] if source_face is None else source_face[cropped.face[triangle]]
    selected, nearest = selected[nearest >= 0], nearest[nearest >= 0]
    tokens.index[selected], tokens.confidence[selected] = index[nearest], confidence[nearest]
    return tokens


def _compute_roughness(palette: Palette, index: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the RMS height [m], over all wavelength bands, of the token of each face (F,).

    `index` (F,) is the palette index of each face; the height is 0 where nothing was touched.
    """
    power = np.sum(10.0 ** (2.0 * palette.tokens[:, LEVELS].astype(np.float64)), axis=1)
    return np.asarray(np.append(np.sqrt(power), 0.0)[index], dtype=np.float32)


def _read_valid_tokens(mesh: Any, sources: Set[str]) -> FaceTokens | None:
    """Return a mesh's tokens if the surface hash stored with them is one of `sources`, else None."""
    try:
        earlier = read_tokens(mesh)
    except FileError:  # damaged: this bake replaces it
        return None
    return earlier if earlier is not None and earlier.source in sources else None


def hash_surface_source(surface: TouchedObject | SurfaceFacts) -> str:
    """Hash what a surface's tokens are measured from: its shape, its shaders and what these read of the object."""
    return content_hash(surface.shape_hash, *surface.shader_hashes, surface.owner_hash)


def find_shared_sources(session: Session, obj: Any) -> set[str]:
    """Return `hash_surface_source` of the other touched objects with the same mesh.

    Linked duplicates (Alt D) may differ in scale and in the materials of their slots, while their mesh stores the
    tokens of only one source.
    """
    surfaces = (stroke.hnf_stroke.surface for stroke in session.scene.objects if stroke.hnf_stroke.is_stroke)
    touched = {*surfaces, *(find_object(session.scene, name) for name in session.known_names)} - {None, obj}
    sources = set()
    for other in touched:
        if other.data == obj.data and find_index(session.scene.objects, other) >= 0:
            with contextlib.suppress(HnfError):  # a hidden object has no source
                sources.add(hash_surface_source(session.get_facts(other)))
    return sources


INPUTS_PROPERTY = "hnf_inputs"
"""ID property next to the bake: hashes of its inputs, to explain why it is stale."""


def save_bake(obj: Any, bake: StrokeBake, inputs: InputHashes) -> None:
    """Store a bake and its inputs on a stroke. Raises SceneError for a linked object."""
    store_bake(obj, bake)
    stored_data.set_property(obj, INPUTS_PROPERTY, inputs.to_text())


def clear_bake(obj: Any) -> int:
    """Remove the bake and its inputs from a stroke; return the bytes freed."""
    freed = count_stored_bytes(obj)
    remove_bake(obj)
    stored_data.delete_property(obj, INPUTS_PROPERTY)
    return freed


def count_stored_bytes(obj: Any) -> int:
    """Return the size of the bake and its inputs stored on a stroke [bytes]."""
    data, text = stored_data.get_property(obj, BAKE_PROPERTY), stored_data.get_property(obj, INPUTS_PROPERTY)
    return (len(data) if isinstance(data, bytes) else 0) + (len(text) if isinstance(text, str) else 0)


def check_validity(obj: Any, job: StrokeJob) -> StrokeStatus:
    """Compare the bake stored on a stroke with the stroke as it is now.

    `job` has the hashes of its current inputs. A bake made with other names of the surface or its materials still
    holds, and says so; only a new bake guesses from the names.
    """
    try:
        bake = load_bake(obj)
    except FileError as error:
        return StrokeStatus(Freshness.UNBAKED, str(error), object_name=job.object_name)
    if bake is None:
        return StrokeStatus(Freshness.UNBAKED, tr("Not baked yet."), object_name=job.object_name)
    earlier = InputHashes.from_text(stored_data.get_property(obj, INPUTS_PROPERTY))
    inputs = job.inputs if earlier is None else ignore_rounding(job, earlier, bake)
    if bake.key == inputs.key:
        return make_status(bake, Freshness.FRESH, object_name=job.object_name)
    if bake.path_key != inputs.path_key:
        return make_status(bake, Freshness.STALE, _describe_changes(inputs, earlier, bake), job.object_name)
    if earlier is not None and earlier.touch == inputs.touch:
        why = tr("Names changed since the bake. It still plays; Bake guesses the material anew.")
        return make_status(bake, Freshness.FRESH, why, job.object_name)
    try:
        if job.stroke is not None:
            bake.with_force(_fit_force(job.stroke.samples.force, bake))
    except StrokeError as error:
        return make_status(bake, Freshness.STALE, str(error), job.object_name)
    why = tr("Only force, seed or probe changed: no bake needed, just play.")
    return make_status(bake, Freshness.FORCE, why, job.object_name)


def check_hidden(scene: Any, view_layer: Any, obj: Any) -> StrokeStatus | None:
    """Return the status of a stroke whose bake cannot be compared since its surface is hidden; None for any other.

    Hiding changes nothing that is felt, so the bake holds.
    """
    try:
        bake = load_bake(obj)
    except FileError:
        return None
    if bake is None:
        return None
    surface = obj.hnf_stroke.surface or find_object(scene, bake.facts.get("object", ""))
    if surface is None or find_index(scene.objects, surface) < 0 or is_visible(surface, view_layer):
        return None
    why = tr("'{name}' is hidden: this plays as it was baked.").format(name=surface.name)
    return make_status(bake, Freshness.FRESH, why, get_scene_name(scene, surface))


def ignore_rounding(job: StrokeJob, earlier: InputHashes, bake: StrokeBake) -> InputHashes:
    """Return the hashes of a job's inputs, with those of the bake where path and force differ by rounding only.

    `earlier` are the hashes that were stored with the bake. Turning an object changes the last bits of its strokes'
    points, and so the hash of the path.
    """
    if job.stroke is None or bake.path is None or job.inputs.path == earlier.path:
        return job.inputs
    if not bake.path.matches(trace_path(job.stroke)):
        return job.inputs
    samples = replace(job.stroke.samples, force=_fit_force(job.stroke.samples.force, bake))
    touch = hash_touch(replace(job.stroke, samples=samples), job.seed)
    return replace(job.inputs, path=earlier.path, touch=touch)


def _fit_force(force: NDArray[np.float64], bake: StrokeBake) -> NDArray[np.float64]:
    """Return a force (n,) with the number of samples of a bake, if rounding of the duration added or removed one."""
    count = len(bake.stroke.action.force)
    return np.append(force, force[-1:])[:count] if abs(len(force) - count) <= 1 else force


def make_status(bake: StrokeBake, freshness: Freshness, why: str = "", object_name: str = "") -> StrokeStatus:
    """Make the status that the panels show of a bake.

    `why` is the reason if it is not fresh, `object_name` the surface's name now, if that is not the one of the bake.
    """
    facts, notes = bake.facts, bake.notes
    doubted = facts.get("height_doubted", "").splitlines()
    if freshness is Freshness.FORCE and bake.alternative is not None:
        doubted += bake.alternative.facts.get("height_doubted", "").splitlines()
        notes = tuple(note for note in notes if note not in bake.doubts)  # the preview tells those of the new force
    return StrokeStatus(
        freshness,
        why,
        duration_s=bake.stroke.action.duration_s,
        object_name=object_name or facts.get("object", ""),
        library_material=facts.get("library_material", ""),
        routes=facts.get("routes", ""),
        confidence=bake.confidence,
        warnings=(*bake.warnings, *notes),
        shader=facts.get("material", ""),
        doubted_shaders=tuple(dict.fromkeys(doubted)),
        likely=facts.get("likely", ""),
    )


def has_tokens(session: Session, obj: Any) -> bool:
    """Return True if an object's mesh has the tokens of its current surface, or of another object with the same mesh.

    Also True if it cannot store any. Raises SceneError if the object is hidden or has no surface.
    """
    facts = session.get_facts(obj)
    if obj.type != "MESH" or obj.data.library is not None:
        return True
    source = obj.data.get(SOURCE_PROPERTY)
    return bool(source == hash_surface_source(facts)) or source in find_shared_sources(session, obj)


def _describe_changes(inputs: InputHashes, earlier: InputHashes | None, bake: StrokeBake) -> str:
    """Describe which inputs changed since the bake; `earlier` are those that were stored with it."""
    if earlier is None or earlier.path_key != bake.path_key:
        return tr("Changed since it was baked.")
    changes = inputs.describe_changes(earlier)
    message = tr("Changed since the bake: {what}. Bake again.")
    return message.format(what="; ".join(tr(change) for change in changes))
