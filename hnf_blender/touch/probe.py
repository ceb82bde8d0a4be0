"""Static touch queries: what is felt at one place of a surface, without a stroke."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.places import SurfacePoint, find_point_at_uv, find_point_near, select_slot
from hnf_core.cli.probe import TouchQuery
from hnf_core.field.likeness import token_distances
from hnf_core.material.estimate import PropertyEstimate, estimate_property, get_probabilities
from hnf_core.material.fuse import FusedToken, fuse
from hnf_core.material.library import load_library
from hnf_core.material.material import LibraryMaterial
from hnf_core.material.prior import Suggestion
from hnf_core.material.token import TOKEN_DIM, band_slice
from hnf_core.simulation.classes import DEFAULT_SCATTER
from hnf_core.tactile.tactile_map import Route, TactileMap

from ..bridge.scene_names import find_object, get_scene_name
from .bake import TouchedObject, bake_patches, compute_patch_key, get_map_source, get_token, get_widest_map
from .choose import MaterialRequest, SlotMaterial, decide_material, find_chosen_material, rank_materials
from .jobs import Session
from .report import Counts
from .seeing import explain_skipped
from .store import PatchRecord, load_patch
from .targets import resolve_target

NEAREST_COUNT = 5


@dataclass(frozen=True)
class SimilarMaterial:
    """A library material as it stands to what was found. distance: of its token over the bands that are not prior
    (field.likeness), None where every band is."""

    suggestion: Suggestion
    category: str
    distance: float | None


@dataclass(frozen=True)
class QueryResult:
    """What is felt at a place. ranked: the whole library, the most apt first; material: what is taken to be there, by
    the artist's word or the ranking. tactile: the map, the widest where several were predicted; None where nothing
    shows a relief. friction, stiffness: estimates from the materials, not seen. nearest: the closest by token, or where
    every band is prior the most apt."""

    name: str
    touched: TouchedObject
    point: SurfacePoint
    record: PatchRecord
    fused: FusedToken
    material: SlotMaterial
    tactile: TactileMap | None
    friction: PropertyEstimate
    stiffness: PropertyEstimate
    nearest: tuple[SimilarMaterial, ...]
    ranked: tuple[Suggestion, ...]
    notes: tuple[str, ...]

    @property
    def band_rms_m(self) -> np.ndarray[Any, Any]:
        """(7,) RMS height of each band, longest first, whatever its route."""
        levels = [float(self.fused.values[band_slice(band).start]) for band in range(len(self.fused.routes))]
        return np.asarray(10.0 ** np.array(levels))

    @property
    def observed_rms_m(self) -> float | None:
        """RMS height of the bands that were measured or predicted, together; None where all are prior."""
        told = np.array([route is not Route.PRIOR for route in self.fused.routes])
        return float(np.sqrt(np.sum(self.band_rms_m[told] ** 2))) if told.any() else None


def locate_query(session: Session, query: TouchQuery) -> tuple[TouchedObject, SurfacePoint]:
    """The place that was asked for, within one material slot where one is named ("Cup:Glaze:0.5,0.5").

    Raises SceneError: no such object, no surface, no such UV, or not on it.
    """
    target = resolve_target(session.scene, query.target)
    obj = find_object(session.scene, target.object_name)
    touched = session.get_touched_object(obj)
    where = f"object '{obj.name}'"
    mesh = touched.surface.mesh if target.slot is None else select_slot(touched.surface.mesh, target.slot)
    if len(query.at) == 2:
        return touched, find_point_at_uv(mesh, (query.at[0], query.at[1]), where=where)
    return touched, find_point_near(mesh, touched.surface.stretch @ np.asarray(query.at), where=where)


def query_steps(
    session: Session, query: TouchQuery, cache: Path, counts: Counts
) -> Generator[float, None, QueryResult]:
    """Look at one place: one patch, through the same store as strokes. Yields the share done. Raises HnfError."""
    touched, place = locate_query(session, query)
    slot = place.patch.slot
    words = MaterialRequest(session.get_choices(get_scene_name(session.scene, touched.obj)))
    chosen = find_chosen_material(touched, slot, words)
    picked = () if chosen is None else (slot,)
    (record,) = yield from bake_patches(touched, [place.patch], cache, counts, session.predictor, picked)
    material = decide_material(touched, slot, words, [record])
    fused = fuse(get_token(record), material.library.token, material.confidence, record.route)
    ranked = rank_materials(touched, slot, [record])
    library = _include_material(material.library)
    weights = get_probabilities(library, ranked) if chosen is None else {chosen.name: 1.0}
    return QueryResult(
        name=query.name,
        touched=touched,
        point=place,
        record=record,
        fused=fused,
        material=material,
        tactile=get_widest_map(record),
        friction=estimate_property(library, weights, "friction", DEFAULT_SCATTER.friction),
        stiffness=estimate_property(library, weights, "stiffness_n_m", DEFAULT_SCATTER.stiffness),
        nearest=find_nearest_materials(fused, ranked),
        ranked=ranked,
        notes=_collect_notes(
            touched, place, record, format_skipped_note(session, material, record, chosen is not None)
        ),
    )


def is_baked(session: Session, touched: TouchedObject, point: SurfacePoint, cache: Path) -> bool:
    """Is the patch of the place stored already, so that nothing need be rendered?"""
    return (
        load_patch(cache, compute_patch_key(touched, point.patch, session.predictor.measured_encoder.content_id))
        is not None
    )


def find_nearest_materials(fused: FusedToken, ranked: Sequence[Suggestion]) -> tuple[SimilarMaterial, ...]:
    """The NEAREST library materials to the bands that were seen; with none, the most apt, without a distance."""
    library = load_library()
    category = {material.name: material.category for material in library}
    known = np.zeros(TOKEN_DIM, dtype=bool)
    for band, route in enumerate(fused.routes):
        known[band_slice(band)] = route is not Route.PRIOR
    if not known.any():
        return tuple(SimilarMaterial(each, category[each.name], None) for each in ranked[:NEAREST_COUNT])
    distances = token_distances(fused.values, known, np.stack([material.token for material in library]))
    told = {each.name: each for each in ranked}
    order = np.argsort(distances, kind="stable")[:NEAREST_COUNT]
    return tuple(SimilarMaterial(told[library[i].name], library[i].category, float(distances[i])) for i in order)


def _include_material(material: LibraryMaterial) -> tuple[LibraryMaterial, ...]:
    """The library, and an artist's own definition where that is what was chosen."""
    library = load_library()
    return library if any(each.name == material.name for each in library) else (*library, material)


def format_skipped_note(session: Session, material: SlotMaterial, record: PatchRecord, chosen: bool) -> str:
    """Why a picture that could tell of a relief was not read; "" where it was, or need not be."""
    if chosen or record.unlit is None or record.predicted is not None:
        return ""
    return f"material '{material.shader}': {session.predictor.missing_reason or explain_skipped(record.unlit)}."


def _collect_notes(
    touched: TouchedObject, point: SurfacePoint, record: PatchRecord, skipped_note: str
) -> tuple[str, ...]:
    notes = [*touched.surface.notes, *point.notes, *record.notes, *([skipped_note] if skipped_note else [])]
    if not point.tangent_known:
        notes.append(
            f"object '{touched.surface.object_name}' has no usable UVs there: directions are counted from the object's "
            "own axes."
        )
    return tuple(dict.fromkeys(notes))


def describe_map_source(result: QueryResult) -> str:
    """Where the tactile map comes from, or why there is none, in words."""
    if result.tactile is not None:
        return get_map_source(result.record)
    if result.record.unlit is not None:
        return "there is a picture, and no relief was estimated from it: all bands are the library material's"
    return "the shader has no relief there and no picture that tells of one: all bands are the library material's"
