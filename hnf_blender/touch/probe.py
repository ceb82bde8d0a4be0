"""Static touch queries: what is felt at one place of a surface, without a stroke."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.places import Place, of_slot, place_at_uv, place_near
from hnf_core.cli.probe import ProbePlace
from hnf_core.field.likeness import token_distances
from hnf_core.material.estimate import Estimate, estimate, weights_of
from hnf_core.material.fuse import FusedToken, fuse
from hnf_core.material.library import load_library
from hnf_core.material.material import LibraryMaterial
from hnf_core.material.prior import Suggestion
from hnf_core.material.token import TOKEN_DIM, band_slice
from hnf_core.simulation.classes import SCATTER
from hnf_core.tactile.tactile_map import Route, TactileMap

from ..bridge.scene_names import name_in, object_in
from .bake import TouchedObject, bake_patches, patch_key, source_of, token_of, widest_map
from .choose import Asked, SlotMaterial, chosen_material, decide_material, ranked_materials
from .jobs import Session
from .report import Counts
from .seeing import why_unread
from .store import PatchRecord, load_patch
from .targets import resolve_target

NEAREST = 5


@dataclass(frozen=True)
class Near:
    """A library material as it stands to what was found. distance: of its token over the bands that are not prior
    (field.likeness), None where every band is."""

    suggestion: Suggestion
    category: str
    distance: float | None


@dataclass(frozen=True)
class Probed:
    """What is felt at a place. ranked: the whole library, the most apt first; material: what is taken to be there, by
    the artist's word or the ranking. tactile: the map, the widest where several were predicted; None where nothing
    shows a relief. friction, stiffness: estimates from the materials, not seen. nearest: the closest by token, or where
    every band is prior the most apt."""

    name: str
    touched: TouchedObject
    place: Place
    record: PatchRecord
    fused: FusedToken
    material: SlotMaterial
    tactile: TactileMap | None
    friction: Estimate
    stiffness: Estimate
    nearest: tuple[Near, ...]
    ranked: tuple[Suggestion, ...]
    notes: tuple[str, ...]

    @property
    def band_rms_m(self) -> np.ndarray[Any, Any]:
        """(7,) RMS height of each band, longest first, whatever its route."""
        levels = [float(self.fused.values[band_slice(band).start]) for band in range(len(self.fused.routes))]
        return np.asarray(10.0 ** np.array(levels))

    @property
    def told_rms_m(self) -> float | None:
        """RMS height of the bands that were measured or predicted, together; None where all are prior."""
        told = np.array([route is not Route.PRIOR for route in self.fused.routes])
        return float(np.sqrt(np.sum(self.band_rms_m[told] ** 2))) if told.any() else None


def locate(session: Session, asked: ProbePlace) -> tuple[TouchedObject, Place]:
    """The place that was asked for, within one material slot where one is named ("Cup:Glaze:0.5,0.5").

    Raises SceneError: no such object, no surface, no such UV, or not on it.
    """
    target = resolve_target(session.scene, asked.target)
    obj = object_in(session.scene, target.object_name)
    touched = session.touched(obj)
    where = f"object '{obj.name}'"
    mesh = touched.surface.mesh if target.slot is None else of_slot(touched.surface.mesh, target.slot)
    if len(asked.at) == 2:
        return touched, place_at_uv(mesh, (asked.at[0], asked.at[1]), where=where)
    return touched, place_near(mesh, touched.surface.stretch @ np.asarray(asked.at), where=where)


def probe_steps(session: Session, asked: ProbePlace, cache: Path, counts: Counts) -> Generator[float, None, Probed]:
    """Look at one place: one patch, through the same store as strokes. Yields the share done. Raises HnfError."""
    touched, place = locate(session, asked)
    slot = place.patch.slot
    words = Asked(session.choices(name_in(session.scene, touched.obj)))
    chosen = chosen_material(touched, slot, words)
    picked = () if chosen is None else (slot,)
    (record,) = yield from bake_patches(touched, [place.patch], cache, counts, session.seeing, picked)
    material = decide_material(touched, slot, words, [record])
    fused = fuse(token_of(record), material.library.token, material.confidence, record.route)
    ranked = ranked_materials(touched, slot, [record])
    library = _with(material.library)
    weights = weights_of(library, ranked) if chosen is None else {chosen.name: 1.0}
    return Probed(
        name=asked.name,
        touched=touched,
        place=place,
        record=record,
        fused=fused,
        material=material,
        tactile=widest_map(record),
        friction=estimate(library, weights, "friction", SCATTER.friction),
        stiffness=estimate(library, weights, "stiffness_n_m", SCATTER.stiffness),
        nearest=nearest_materials(fused, ranked),
        ranked=ranked,
        notes=_notes(touched, place, record, unread_note(session, material, record, chosen is not None)),
    )


def is_baked(session: Session, touched: TouchedObject, place: Place, cache: Path) -> bool:
    """Is the patch of the place stored already, so that nothing need be rendered?"""
    return load_patch(cache, patch_key(touched, place.patch, session.seeing.measured.content_id)) is not None


def nearest_materials(fused: FusedToken, ranked: Sequence[Suggestion]) -> tuple[Near, ...]:
    """The NEAREST library materials to the bands that were seen; with none, the most apt, without a distance."""
    library = load_library()
    category = {material.name: material.category for material in library}
    known = np.zeros(TOKEN_DIM, dtype=bool)
    for band, route in enumerate(fused.routes):
        known[band_slice(band)] = route is not Route.PRIOR
    if not known.any():
        return tuple(Near(each, category[each.name], None) for each in ranked[:NEAREST])
    distances = token_distances(fused.values, known, np.stack([material.token for material in library]))
    told = {each.name: each for each in ranked}
    order = np.argsort(distances, kind="stable")[:NEAREST]
    return tuple(Near(told[library[i].name], library[i].category, float(distances[i])) for i in order)


def _with(material: LibraryMaterial) -> tuple[LibraryMaterial, ...]:
    """The library, and an artist's own definition where that is what was chosen."""
    library = load_library()
    return library if any(each.name == material.name for each in library) else (*library, material)


def unread_note(session: Session, material: SlotMaterial, record: PatchRecord, chosen: bool) -> str:
    """Why a picture that could tell of a relief was not read; "" where it was, or need not be."""
    if chosen or record.look is None or record.predicted is not None:
        return ""
    return f"material '{material.shader}': {session.seeing.missing or why_unread(record.look)}."


def _notes(touched: TouchedObject, place: Place, record: PatchRecord, unread: str) -> tuple[str, ...]:
    notes = [*touched.surface.notes, *place.notes, *record.notes, *([unread] if unread else [])]
    if not place.tangent_known:
        notes.append(
            f"object '{touched.surface.object_name}' has no usable UVs there: directions are counted from the object's "
            "own axes."
        )
    return tuple(dict.fromkeys(notes))


def map_source(probed: Probed) -> str:
    """Where the tactile map comes from, or why there is none, in words."""
    if probed.tactile is not None:
        return source_of(probed.record)
    if probed.record.look is not None:
        return "there is a picture, and no relief was estimated from it: all bands are the library material's"
    return "the shader has no relief there and no picture that tells of one: all bands are the library material's"
