"""Touch queries: what would be felt at one place of a surface, without a stroke (`hnf touch --at`).

A query renders one patch (a square of surface), combines the measured, predicted and prior bands of its token, and
estimates material, friction and stiffness. The result is written as a tactile map (PNG and .npz) and as an entry of
report.json, see docs/probe.md.
"""

from __future__ import annotations

import io
import math
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.surface_point import SurfacePoint, find_point_at_uv, find_point_near, select_slot
from hnf_core.errors import HnfError, pluralize
from hnf_core.export.figure import write_tactile_map_figure
from hnf_core.field.features import token_distances
from hnf_core.files import write_bytes
from hnf_core.material.fuse import FusedToken, routes_by_band
from hnf_core.material.library import LibraryMaterial, load_library
from hnf_core.material.ranking import PropertyEstimate, Suggestion, estimate_property, get_probabilities
from hnf_core.material.token import TOKEN_DIM, band_slice
from hnf_core.progress import Cancelled, Progress, ProgressCallback, ignore_progress, nest_progress
from hnf_core.simulation.material_classes import DEFAULT_SCATTER
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.touch_request import TouchQuery
from hnf_core.units import m_to_mm

from ..bridge.scene.scene_names import find_object, get_scene_name
from ..bridge.stroke.read_stroke import list_strokes
from .bake_patches import (
    CACHE_FOLDER_NAME,
    CLOSEUP_STAGE,
    TouchedObject,
    bake_patches,
    compute_patch_key,
    explain_skipped,
    get_map_source,
    get_resolved_wavelength,
    get_widest_map,
)
from .bake_plan import Plan, PlannedQuery, add_mesh_relief, find_mesh_waves, plan_object_slots, read_previous_run
from .material_choice import (
    MaterialRequest,
    SlotMaterial,
    find_chosen_material,
    format_certainty,
    format_doubt_note,
    fuse_record,
    get_shader_name,
    rank_materials,
    round_likely,
    settle_slot,
)
from .output_files import make_file_stem
from .patch_cache import PatchRecord, load_patch
from .report import Counts, Failed, Report, Skipped
from .session import GatheredJobs, Session, resolve_target
from .synthesise import record_time

NEAREST_COUNT = 5
"""Number of similar materials in a result."""


@dataclass(frozen=True)
class SimilarMaterial:
    """A library material compared with the result of a query.

    `distance` is the distance of its token from that of the query (`token_distances`) over the wavelength bands that
    are measured or predicted, None if all bands are prior.
    """

    suggestion: Suggestion
    category: str
    distance: float | None


@dataclass(frozen=True)
class QueryResult:
    """Result of a touch query: what is felt at one place of a surface.

    Attributes
    ----------
    name : str
    touched : TouchedObject
    point : SurfacePoint
        Place on the surface.
    record : PatchRecord
    fused : FusedToken
    material : SlotMaterial
        Material of the place, by choice or ranking.
    tactile : TactileMap or None
        Tactile map, the widest if several were predicted; None without a relief.
    friction, stiffness : PropertyEstimate
        Estimates from the probable materials, not observed.
    nearest : tuple of SimilarMaterial
        Materials with the nearest tokens or, if all bands are prior, the most probable.
    ranked : tuple of Suggestion
        All library materials, the most probable first.
    notes : tuple of str
        Remarks for the user.
    """

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
        """RMS height of each wavelength band of the token (7,) [m], the longest wavelengths first, of any route."""
        levels = [float(self.fused.values[band_slice(band).start]) for band in range(len(self.fused.routes))]
        return np.asarray(10.0 ** np.array(levels))

    @property
    def observed_rms_m(self) -> float | None:
        """RMS height of all measured and predicted bands together [m]; None if all bands are prior."""
        observed = np.array([route is not Route.PRIOR for route in self.fused.routes])
        return float(np.sqrt(np.sum(self.band_rms_m[observed] ** 2))) if observed.any() else None


def locate_query(session: Session, query: TouchQuery) -> tuple[TouchedObject, SurfacePoint]:
    """Find the place of a query, within one material slot if one is named ("Cup:Glaze:0.5,0.5").

    Raises SceneError if there is no such object, surface or UV, or if the point is not on it.
    """
    target = resolve_target(session.scene, query.target)
    obj = find_object(session.scene, target.object_name)
    touched = session.get_touched_object(obj)
    where = f"object '{obj.name}'"
    mesh = touched.surface.mesh if target.slot is None else select_slot(touched.surface.mesh, target.slot)
    if len(query.at) == 2:
        return touched, find_point_at_uv(mesh, (query.at[0], query.at[1]), where=where)
    return touched, find_point_near(mesh, touched.surface.stretch @ np.asarray(query.at), where=where)


def query_surface(
    session: Session,
    query: TouchQuery,
    cache: Path,
    counts: Counts,
    progress: ProgressCallback = ignore_progress,
) -> QueryResult:
    """Evaluate one touch query: render the patch at its place and estimate what is felt there.

    Parameters
    ----------
    session : Session
        Session of the scene.
    query : TouchQuery
        Object and place.
    cache : Path
        Folder of cached patches, shared with strokes.
    counts : Counts
        Counters, which are incremented.
    progress : ProgressCallback, optional
        Called after the close-up and at the end.

    Returns
    -------
    QueryResult

    Raises
    ------
    HnfError
        If the place cannot be found or rendered.
    """
    touched, point = locate_query(session, query)
    slot = point.patch.slot
    request = MaterialRequest(session.get_choices(get_scene_name(session.scene, touched.obj)))
    chosen = find_chosen_material(touched, slot, request)
    chosen_slots = () if chosen is None else (slot,)
    (record,) = bake_patches(touched, [point.patch], cache, counts, session.predictor, chosen_slots, progress)
    authored_m = record.height_peak_to_peak_m
    material, (settled,) = settle_slot(touched, slot, request, [record], session.predictor.measured_encoder)
    fused = fuse_record(settled, material)
    ranked = rank_materials(
        touched, slot, [replace(record, height=None, token=None, known=None) if material.doubt else record]
    )
    record = settled
    doubt_note = format_doubt_note(material, touched.surface.object_name, authored_m, record.height_peak_to_peak_m)
    library = _include_material(material.library)
    weights = get_probabilities(library, ranked) if chosen is None else {chosen.name: 1.0}
    skipped_note = format_skipped_note(session, material, record, chosen is not None)
    return QueryResult(
        name=query.name,
        touched=touched,
        point=point,
        record=record,
        fused=fused,
        material=material,
        tactile=get_widest_map(record),
        friction=estimate_property(library, weights, "friction", DEFAULT_SCATTER.friction),
        stiffness=estimate_property(library, weights, "stiffness_n_m", DEFAULT_SCATTER.stiffness),
        nearest=find_nearest_materials(fused, ranked),
        ranked=ranked,
        notes=_collect_notes(touched, point, record, doubt_note, skipped_note),
    )


def is_baked(session: Session, touched: TouchedObject, point: SurfacePoint, cache: Path) -> bool:
    """Return True if the patch at a place is in the cache, so that nothing has to be rendered."""
    return load_patch(cache, compute_patch_key(touched, point.patch, session.predictor)) is not None


def find_nearest_materials(fused: FusedToken, ranked: Sequence[Suggestion]) -> tuple[SimilarMaterial, ...]:
    """Return the library materials whose tokens are nearest over the measured or predicted bands.

    If all bands are prior, the most probable materials are returned instead.
    """
    library = load_library()
    category = {material.name: material.category for material in library}
    observed = np.zeros(TOKEN_DIM, dtype=bool)
    for band, route in enumerate(fused.routes):
        observed[band_slice(band)] = route is not Route.PRIOR
    if not observed.any():
        return tuple(
            SimilarMaterial(suggestion, category[suggestion.name], None) for suggestion in ranked[:NEAREST_COUNT]
        )
    distances = token_distances(fused.values, observed, np.stack([material.token for material in library]))
    suggestions = {suggestion.name: suggestion for suggestion in ranked}
    order = np.argsort(distances, kind="stable")[:NEAREST_COUNT]
    return tuple(SimilarMaterial(suggestions[library[i].name], library[i].category, float(distances[i])) for i in order)


def _include_material(material: LibraryMaterial) -> tuple[LibraryMaterial, ...]:
    """Return the library, extended by `material` if that is a definition of the user's own."""
    library = load_library()
    return library if any(known.name == material.name for known in library) else (*library, material)


def format_skipped_note(session: Session, material: SlotMaterial, record: PatchRecord, chosen: bool) -> str:
    """Explain why no relief was predicted from an unlit image; "" if it was, or need not be."""
    if chosen or record.unlit is None or record.predicted is not None:
        return ""
    return f"material '{material.shader}': {session.predictor.missing_reason or explain_skipped(record.unlit)}."


def _collect_notes(touched: TouchedObject, point: SurfacePoint, record: PatchRecord, *more: str) -> tuple[str, ...]:
    """Collect the remarks of surface, place and patch for the user, with `more` of them, "" for none."""
    notes = [*touched.surface.notes, *point.notes, *record.notes, *(note for note in more if note)]
    if not point.tangent_known:
        notes.append(
            f"object '{touched.surface.object_name}' has no usable UVs there: directions are counted from the object's "
            "own axes."
        )
    return tuple(dict.fromkeys(notes))


def describe_map_source(result: QueryResult) -> str:
    """Describe what the tactile map was made from, or why there is none."""
    if result.tactile is not None:
        return get_map_source(result.record)
    if result.record.unlit is not None:
        return "there is a picture, and no relief was estimated from it: all bands are the library material's"
    return "the shader has no relief there and no picture that tells of one: all bands are the library material's"


ESTIMATE_BASIS = "estimated from the likely materials, not seen"
"""Text in the report on what friction and stiffness are based on."""


def write_query(folder: Path, result: QueryResult) -> dict[str, Any]:
    """Write the tactile map as PNG and .npz, each atomically; return the query's entry for the report.

    Files with the same content are left as they are.
    """
    tactile = result.tactile
    files: dict[str, Any] | None = None
    if tactile is not None:
        stem = make_file_stem(f"probe {result.name}")
        captions = (f"Probe {result.name}", *_make_captions(result, tactile))
        picture, numbers = folder / f"{stem}.png", folder / f"{stem}.npz"
        data = pack_map(tactile, captions)
        if not (picture.is_file() and numbers.is_file() and numbers.read_bytes() == data):
            write_tactile_map_figure(picture, tactile, captions[0], captions[1:])
            write_bytes(numbers, data)
        files = {"picture": f"{stem}.png", "numbers": f"{stem}.npz"}
    return make_query_entry(result, files)


def make_query_entry(result: QueryResult, files: dict[str, Any] | None) -> dict[str, Any]:
    """Return the result of a query as a JSON object for the report.

    `files` are the names of its image and .npz files, None without a tactile map.
    """
    routes = routes_by_band(result.fused.routes, result.record.mesh_bands)
    rms = result.band_rms_m
    return {
        "name": result.name,
        "object": result.touched.surface.object_name,
        "material": result.material.shader,
        "library_material": result.material.library.name,
        "confidence": round(result.fused.confidence, 4),
        "material_confidence": round(result.material.confidence, 4),
        "reason": result.material.reason,
        "likely": round_likely(result.material),
        "place": _describe_place(result),
        "routes": routes,
        "roughness": {
            "bands_rms_m": {band: float(value) for band, value in zip(routes, rms, strict=True)},
            "seen_rms_m": result.observed_rms_m,
            "total_rms_m": float(np.sqrt(np.sum(rms**2))),
        },
        "friction": {"kinetic_mu": result.friction.value, **_describe_spread(result.friction)},
        "stiffness": {"n_per_m": result.stiffness.value, **_describe_spread(result.stiffness)},
        "nearest": [_describe_similar(similar) for similar in result.nearest],
        "tactile_map": None
        if files is None or result.tactile is None
        else {**files, **_describe_map(result, result.tactile)},
        "source": describe_map_source(result),
        "notes": list(result.notes),
    }


def pack_map(tactile: TactileMap, captions: Sequence[str]) -> bytes:
    """Pack a tactile map as .npz.

    Its arrays are image (H, W, 3) linear, height_m (H, W) if known [m], mask (H, W), metres_per_pixel, and `said`:
    title and captions.
    """
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
    """Format the report entry of a query as one line of text."""
    roughness = entry["roughness"]["total_rms_m"] * 1e6
    like = entry["nearest"][0]["name"] if entry["nearest"] else ""
    return (
        f"{entry['name']}: {entry['library_material']} ({entry['material_confidence']:.0%}), roughness {roughness:.3g} "
        f"µm RMS, friction about {entry['friction']['kinetic_mu']:.2f} (×÷{entry['friction']['spread_factor']:.2f}), "
        f"nearest {like}"
    )


def _describe_place(result: QueryResult) -> dict[str, Any]:
    """Return the coordinates of the place as JSON."""
    point, surface = result.point, result.touched.surface
    face = point.face if surface.source_face is None else int(surface.source_face[point.face])
    metres = result.touched.metres_per_unit
    world_m = surface.rigid[:3, :3] @ point.point + surface.rigid[:3, 3]
    return {
        "local": _round_values(np.linalg.pinv(surface.stretch) @ point.point),
        "uv": None if point.uv is None else _round_values(point.uv),
        "world": _round_values(world_m / metres),
        "world_normal": _round_values(surface.rigid[:3, :3] @ point.normal),
        "surface_m": _round_values(point.point),
        "surface_normal": _round_values(point.normal),
        "surface_x_axis": _round_values(point.patch.x_axis),
        "face": face if face >= 0 else None,
        "slot": point.patch.slot,
        "directions": "UV" if point.tangent_known else "object axes",
    }


def _describe_map(result: QueryResult, tactile: TactileMap) -> dict[str, Any]:
    """Return the properties of the tactile map as JSON."""
    resolved = get_resolved_wavelength(result.record)
    return {
        "sensor": tactile.sensor,
        "route": tactile.route.value,
        "metres_per_pixel": tactile.metres_per_pixel,
        "resolved_wavelength_m": resolved if math.isfinite(resolved) else None,
        "height_peak_to_peak_m": result.record.height_peak_to_peak_m if tactile.height is not None else None,
    }


def _make_captions(result: QueryResult, tactile: TactileMap) -> tuple[str, ...]:
    """Return the lines below the tactile map."""
    span = m_to_mm(result.record.height_peak_to_peak_m)
    height = "" if tactile.height is None else f"; {span:.3g} mm from top to bottom"
    roughness = float(np.sqrt(np.sum(result.band_rms_m**2))) * 1e6
    return (
        f"Relief from: {describe_map_source(result)}{height}.",
        f"{result.material.shader or 'No material'} → {result.material.library.name}, "
        f"{format_certainty(result.material)}; roughness {roughness:.3g} µm RMS.",
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
    """Return no jobs and a note that the scene's strokes are skipped, as only queries are requested."""
    count = len(list_strokes(session.scene))
    skipped = [Skipped(f"{pluralize(count, 'stroke')} of the scene", "only probes are asked for")] if count else []
    return GatheredJobs(skipped=skipped)


def carry_over_strokes(report: Report, folder: Path, baked_name: str) -> None:
    """Keep the strokes of an earlier run in the report, so that a later run finds them still valid."""
    earlier = read_previous_run(folder)
    if earlier.scene != report.scene:
        return
    report.strokes = [
        replace(stroke, fresh=True) for stroke in earlier.strokes if (folder / Path(stroke.wav).name).is_file()
    ]
    report.baked_blend = baked_name if report.strokes and (folder / baked_name).is_file() else ""
    report.source, report.left_over = earlier.source, list(earlier.orphaned_files)


def add_queries(session: Session, plan: Plan) -> Plan:
    """Add the cost of each query to a plan, or why it cannot be done; nothing is rendered."""
    planned, failed = [], list(plan.failed)
    out = session.request.out
    for query in session.request.queries:
        try:
            touched, point = locate_query(session, query)
            is_cached = out is not None and is_baked(session, touched, point, out / CACHE_FOLDER_NAME)
        except HnfError as error:
            failed.append(Failed(query.name, str(error)))
            continue
        slot, plans = point.patch.slot, plan_object_slots(session, touched.obj)
        route = plans[slot] if slot < len(plans) else None
        if route is not None:
            (route,) = add_mesh_relief([route], find_mesh_waves(session, touched.obj, [point.patch]))
        close_ups = 0 if is_cached else 1
        planned.append(
            PlannedQuery(query.name, touched.surface.object_name, get_shader_name(touched, slot), close_ups, route)
        )
    return replace(plan, probes=tuple(planned), failed=tuple(failed))


def run_queries(session: Session, report: Report, progress: ProgressCallback = ignore_progress) -> None:
    """Run all queries of a request, and write their files and entries.

    A query that fails is listed in the report; the others are still run.
    """
    queries, folder = session.request.queries, session.request.folder
    for done, query in enumerate(queries):
        query_progress = nest_progress(progress, f"probe {query.name}", done, len(queries))
        query_progress(Progress(CLOSEUP_STAGE, 0, 1))
        try:
            with record_time(report, "probe_s"):
                result = query_surface(session, query, folder / CACHE_FOLDER_NAME, report.counts, query_progress)
                report.probes.append(write_query(folder, result))
            for note in result.notes:
                report.add_warning(f"probe '{query.name}': {note}")
        except HnfError as error:
            report.failed.append(Failed(query.name, str(error)))
        except (KeyboardInterrupt, Cancelled):
            report.failed += [Failed(left.name, "stopped before it was finished.") for left in queries[done:]]
            raise
        except Exception as error:  # a programming error: the other queries are still run
            traceback.print_exc()
            report.failed.append(Failed(query.name, f"{query.name}: internal error ({error!r}). Please report it."))
