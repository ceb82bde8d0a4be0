"""Static touch queries: what is felt at one place of a surface, without a stroke.

What a probe found, as files and as an entry of report.json.

The probes of a run of `hnf touch`: planned, looked at one after the other, told.
"""

from __future__ import annotations

import io
import math
import traceback
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.surface_point import SurfacePoint, find_point_at_uv, find_point_near, select_slot
from hnf_core.errors import HnfError
from hnf_core.export.plots.tactile_map_figure import write_tactile_map_figure
from hnf_core.field.features import token_distances
from hnf_core.files import write_bytes
from hnf_core.material.fuse import FusedToken, fuse, routes_by_band
from hnf_core.material.library import LibraryMaterial, load_library
from hnf_core.material.ranking import PropertyEstimate, Suggestion, estimate_property, get_probabilities
from hnf_core.material.token import TOKEN_DIM, band_slice
from hnf_core.progress import Progress
from hnf_core.simulation.material_classes import DEFAULT_SCATTER
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.text import pluralize
from hnf_core.touch_request import TouchQuery
from hnf_core.units import m_to_mm

from ..bridge.scene.scene_names import find_object, get_scene_name
from ..bridge.stroke.read_stroke import list_strokes
from .bake_patches import (
    TouchedObject,
    bake_patches,
    compute_patch_key,
    explain_skipped,
    get_map_source,
    get_resolved_wavelength,
    get_token,
    get_widest_map,
)
from .bake_plan import Plan, PlannedQuery, plan_object_slots, read_previous_run
from .material_choice import (
    MaterialRequest,
    SlotMaterial,
    decide_material,
    find_chosen_material,
    get_shader_name,
    rank_materials,
)
from .output_files import make_file_stem
from .patch_cache import PatchRecord, load_patch
from .report import Counts, Failed, Report, Skipped
from .session import GatheredJobs, Session, resolve_target
from .synthesise import CACHE_FOLDER_NAME, map_steps, record_time

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


ESTIMATE_BASIS = "estimated from the likely materials, not seen"


def write_query(folder: Path, result: QueryResult) -> dict[str, Any]:
    """The tactile map as PNG and as numbers (.npz), each atomically; returns the probe's entry for the report, as
    docs/probe.md says it. A picture of the same numbers and words is left as it is."""
    tactile = result.tactile
    files: dict[str, Any] | None = None
    if tactile is not None:
        stem, said = make_file_stem(f"probe {result.name}"), (f"Probe {result.name}", *_make_captions(result, tactile))
        picture, numbers = folder / f"{stem}.png", folder / f"{stem}.npz"
        data = pack_map(tactile, said)
        if not (picture.is_file() and numbers.is_file() and numbers.read_bytes() == data):
            write_tactile_map_figure(picture, tactile, said[0], said[1:])
            write_bytes(numbers, data)
        files = {"picture": f"{stem}.png", "numbers": f"{stem}.npz"}
    return make_query_entry(result, files)


def make_query_entry(result: QueryResult, files: dict[str, Any] | None) -> dict[str, Any]:
    """The probe as a JSON object. files: names of picture and numbers, None where there is no map."""
    routes = routes_by_band(result.fused.routes)
    rms = result.band_rms_m
    return {
        "name": result.name,
        "object": result.touched.surface.object_name,
        "material": result.material.shader,
        "library_material": result.material.library.name,
        "confidence": round(result.fused.confidence, 4),
        "material_confidence": round(result.material.confidence, 4),
        "reason": result.material.reason,
        "place": _describe_place(result),
        "routes": routes,
        "roughness": {
            "bands_rms_m": {band: float(value) for band, value in zip(routes, rms, strict=True)},
            "seen_rms_m": result.observed_rms_m,
            "total_rms_m": float(np.sqrt(np.sum(rms**2))),
        },
        "friction": {"kinetic_mu": result.friction.value, **_describe_spread(result.friction)},
        "stiffness": {"n_per_m": result.stiffness.value, **_describe_spread(result.stiffness)},
        "nearest": [_describe_similar(each) for each in result.nearest],
        "tactile_map": None
        if files is None or result.tactile is None
        else {**files, **_describe_map(result, result.tactile)},
        "source": describe_map_source(result),
        "notes": list(result.notes),
    }


def pack_map(tactile: TactileMap, captions: Sequence[str]) -> bytes:
    """numpy's .npz: image (H, W, 3) linear, height (H, W) metres where it is known, mask, metres_per_pixel, and said:
    title and facts of the picture."""
    arrays = {
        "image": tactile.image,
        "mask": tactile.mask,
        "metres_per_pixel": np.array(tactile.metres_per_pixel),
        "said": np.array(captions),
    }
    if tactile.height is not None:
        arrays["height_m"] = tactile.height
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    return packed.getvalue()


def format_query_line(entry: dict[str, Any]) -> str:
    """One line for a person."""
    roughness = entry["roughness"]["total_rms_m"] * 1e6
    like = entry["nearest"][0]["name"] if entry["nearest"] else ""
    return (
        f"{entry['name']}: {entry['library_material']} ({entry['material_confidence']:.0%}), roughness {roughness:.3g} "
        f"µm RMS, friction about {entry['friction']['kinetic_mu']:.2f} (×÷{entry['friction']['spread_factor']:.2f}), "
        f"nearest {like}"
    )


def _describe_place(result: QueryResult) -> dict[str, Any]:
    place, surface = result.point, result.touched.surface
    own_face = place.face if surface.source_face is None else int(surface.source_face[place.face])
    metres = result.touched.metres_per_unit
    world_m = surface.rigid[:3, :3] @ place.point + surface.rigid[:3, 3]
    return {
        "local": _round_values(np.linalg.pinv(surface.stretch) @ place.point),
        "uv": None if place.uv is None else _round_values(place.uv),
        "world": _round_values(world_m / metres),
        "world_normal": _round_values(surface.rigid[:3, :3] @ place.normal),
        "surface_m": _round_values(place.point),
        "surface_normal": _round_values(place.normal),
        "surface_x_axis": _round_values(place.patch.x_axis),
        "face": own_face if own_face >= 0 else None,
        "slot": place.patch.slot,
        "directions": "UV" if place.tangent_known else "object axes",
    }


def _describe_map(result: QueryResult, tactile: TactileMap) -> dict[str, Any]:
    resolved = get_resolved_wavelength(result.record)
    return {
        "sensor": tactile.sensor,
        "route": tactile.route.value,
        "metres_per_pixel": tactile.metres_per_pixel,
        "resolved_wavelength_m": resolved if math.isfinite(resolved) else None,
        "height_peak_to_peak_m": result.record.height_peak_to_peak_m if tactile.height is not None else None,
    }


def _make_captions(result: QueryResult, tactile: TactileMap) -> tuple[str, ...]:
    """What the picture says below the map."""
    span = result.record.height_peak_to_peak_m if tactile.height is not None else None
    tall = "" if span is None else f"; {m_to_mm(span):.3g} mm from top to bottom"
    roughness = float(np.sqrt(np.sum(result.band_rms_m**2))) * 1e6
    return (
        f"Relief from: {describe_map_source(result)}{tall}.",
        f"{result.material.shader or 'No material'} → {result.material.library.name}, "
        f"{result.material.confidence:.0%}; roughness {roughness:.3g} µm RMS.",
    )


def _describe_similar(similar: SimilarMaterial) -> dict[str, Any]:
    return {
        "name": similar.suggestion.name,
        "category": similar.category,
        "distance": similar.distance,
        "confidence": round(similar.suggestion.confidence, 4),
        "reason": similar.suggestion.reason,
    }


def _describe_spread(value: PropertyEstimate) -> dict[str, Any]:
    return {"spread_factor": value.factor, "basis": ESTIMATE_BASIS}


def _round_values(values: Any) -> list[float]:
    return [round(float(value), 9) + 0.0 for value in values]


def skip_strokes(session: Session) -> GatheredJobs:
    """Nothing but probes is asked for: what the scene holds of strokes is left alone, and said."""
    count = len(list_strokes(session.scene))
    found = GatheredJobs()
    if count:
        found.skipped.append(Skipped(f"{pluralize(count, 'stroke')} of the scene", "only probes are asked for"))
    return found


def carry_over_strokes(report: Report, folder: Path, baked_name: str) -> None:
    """The report goes on listing what an earlier run of this scene left in folder: a later run knows by it what is
    fresh."""
    earlier = read_previous_run(folder)
    if earlier.scene != report.scene:
        return
    report.strokes = [replace(each, fresh=True) for each in earlier.strokes if (folder / Path(each.wav).name).is_file()]
    report.baked_blend = baked_name if report.strokes and (folder / baked_name).is_file() else ""
    report.source, report.left_over = earlier.source, list(earlier.orphaned_files)


def add_queries(session: Session, plan: Plan) -> Plan:
    """The plan, and what each probe will cost or why it cannot be done; nothing is rendered."""
    planned, failed = [], list(plan.failed)
    out = session.request.out
    for place in session.request.queries:
        try:
            touched, found = locate_query(session, place)
            is_there = out is not None and is_baked(session, touched, found, out / CACHE_FOLDER_NAME)
        except HnfError as error:
            failed.append(Failed(place.name, str(error)))
            continue
        slot, plans = found.patch.slot, plan_object_slots(session, touched.obj)
        route = plans[slot] if slot < len(plans) else None
        close_ups = 0 if is_there else 1
        planned.append(
            PlannedQuery(place.name, touched.surface.object_name, get_shader_name(touched, slot), close_ups, route)
        )
    return replace(plan, probes=tuple(planned), failed=tuple(failed))


def run_queries(session: Session, report: Report) -> Generator[Progress, None, None]:
    """Look at every place that was asked for, write its files and its entry in the report. One that cannot be done is
    named there and does not cost the others."""
    asked = session.request.queries
    for done, place in enumerate(asked):
        yield Progress(f"probe {place.name}", done, len(asked))
        try:
            with record_time(report, "probe_s"):
                probed = yield from _query_progress(session, place, report, done)
                report.probes.append(write_query(session.request.folder, probed))
            for note in probed.notes:
                report.add_warning(f"probe '{place.name}': {note}")
        except HnfError as error:
            report.failed.append(Failed(place.name, str(error)))
        except KeyboardInterrupt:
            report.failed += [Failed(left.name, "stopped before it was finished.") for left in asked[done:]]
            raise
        except Exception as error:  # a fault of ours: the other places are still looked at
            traceback.print_exc()
            report.failed.append(Failed(place.name, f"{place.name}: internal error ({error!r}). Please report it."))


def _query_progress(
    session: Session, query: TouchQuery, report: Report, done: int
) -> Generator[Progress, None, QueryResult]:
    """Shares of one probe → Progress of them all."""
    steps = query_steps(session, query, session.request.folder / CACHE_FOLDER_NAME, report.counts)
    total = len(session.request.queries)
    return (yield from map_steps(steps, lambda share: Progress(f"probe {query.name}", done, total, share)))
