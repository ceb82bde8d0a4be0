"""Decide which library material a material slot is: the user's choice if there is one, else the best-ranked one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hnf_core.errors import MaterialError
from hnf_core.field.field import Field
from hnf_core.field.weights import load_material_field
from hnf_core.material.fuse import merge_tokens
from hnf_core.material.hnf_file import MaterialFile, with_library_defaults
from hnf_core.material.library import LibraryMaterial, get_material, load_library
from hnf_core.material.ranking import Suggestion, rank
from hnf_core.material.token import Token
from hnf_core.tactile.tactile_map import Route

from .bake_patches import TouchedObject, compute_mean_appearance, get_token
from .patch_cache import PatchRecord

CHOSEN_BY_ARTIST = "chosen by the artist"
GUESS_CONFIDENCE = 0.3
"""Confidence below which nothing in the scene supports a material; a name or a distinct appearance gives more."""


@dataclass(frozen=True)
class MaterialRequest:
    """Library materials requested by the user on the command line or on a stroke.

    Those set on Blender materials are not included.

    Attributes
    ----------
    choices : Mapping[int or None, str]
        Slot (None for any) → library material, from the command line.
    stroke_material : str
        Library material set on the stroke, "" for none.
    where : str
        Stroke named in errors.
    """

    choices: Mapping[int | None, str] = field(default_factory=dict)
    stroke_material: str = ""
    where: str = ""


@dataclass(frozen=True)
class SlotMaterial:
    """Library material of a material slot, with its probability.

    Attributes
    ----------
    shader : str
        Name of the Blender material.
    library : LibraryMaterial
    confidence : float
        Probability of this material, 0 to 1.
    reason : str
        Reason, for the report.
    field : Field or None
        Field that comes with the material, if it was learned.
    """

    shader: str
    library: LibraryMaterial
    confidence: float
    reason: str
    field: Field | None = None


def format_certainty(material: SlotMaterial) -> str:
    """Describe how certain a slot's material is, and why."""
    return (
        CHOSEN_BY_ARTIST
        if material.reason == CHOSEN_BY_ARTIST
        else f"{material.confidence:.0%} sure of it ({material.reason})"
    )


def format_guess_note(material: SlotMaterial, object_name: str) -> str:
    """Return a note for a material that is a mere guess; "" for any other."""
    if material.reason == CHOSEN_BY_ARTIST or material.confidence >= GUESS_CONFIDENCE:
        return ""
    label = f"material '{material.shader}' on '{object_name}'" if material.shader else f"object '{object_name}'"
    return (
        f"{label}: {material.library.name} is a guess ({material.confidence:.0%} sure). Say what it is under Feels in "
        "the Touch tab."
    )


def find_chosen_material(touched: TouchedObject, slot: int, request: MaterialRequest) -> LibraryMaterial | None:
    """Return the user's choice for a slot, None if there is none.

    The command line counts first, then the stroke, then the Blender material (library choice or definition). Raises
    MaterialError that names where an unknown material was given, and similar names.
    """
    choice, where = _find_choice(touched, slot, request)
    if isinstance(choice, MaterialFile):
        return with_library_defaults(choice)
    if not choice:
        return None
    try:
        return get_material(choice)
    except MaterialError as error:
        raise MaterialError(error.what, where=where, remedy=error.remedy) from None


def _find_choice(touched: TouchedObject, slot: int, request: MaterialRequest) -> tuple[str | MaterialFile, str]:
    """Return the choice that takes precedence for a slot, "" for none, and where it was given."""
    choices: dict[str, str | MaterialFile] = {
        "--material": request.choices.get(slot) or request.choices.get(None) or "",
        request.where: request.stroke_material,
        f"material '{get_shader_name(touched, slot)}'": touched.artist_choices[slot]
        if slot < len(touched.artist_choices)
        else "",
    }
    return next(((choice, where) for where, choice in choices.items() if choice), ("", ""))


def decide_material(
    touched: TouchedObject, slot: int, request: MaterialRequest, records: Sequence[PatchRecord]
) -> SlotMaterial:
    """Return the library material of a slot: the user's choice, else the best-ranked.

    `records` are the results of the slot's patches, whose appearance and relief count in the ranking.
    """
    shader = get_shader_name(touched, slot)
    chosen = find_chosen_material(touched, slot, request)
    if chosen is not None:
        choice, _ = _find_choice(touched, slot, request)
        field = load_material_field(choice) if isinstance(choice, MaterialFile) else None
        return SlotMaterial(shader, chosen, 1.0, CHOSEN_BY_ARTIST, field)
    best = rank_materials(touched, slot, records)[0]
    return SlotMaterial(shader, get_material(best.name), best.confidence, best.reason)


def rank_materials(touched: TouchedObject, slot: int, records: Sequence[PatchRecord]) -> tuple[Suggestion, ...]:
    """Rank all library materials for a slot, the most probable first, whatever the user chose.

    Names (of material, object and textures), appearance and relief count. `records` are the results of the slot's
    patches.
    """
    names = [get_shader_name(touched, slot), touched.surface.object_name, touched.obj.data.name]
    token, route = merge_relief(records)
    texture_names = touched.texture_names[slot] if slot < len(touched.texture_names) else ()
    return rank(
        load_library(), compute_mean_appearance(records), names, image_names=texture_names, token=token, route=route
    )


def merge_relief(records: Sequence[PatchRecord]) -> tuple[Token | None, Route]:
    """Return the merged token of a slot's patches, weighted by area, and its route (measured, predicted or prior).

    Only patches of the best route that any of them has are used; None and Route.PRIOR if none shows a relief.
    """
    for route in (Route.MEASURED, Route.PREDICTED):
        described = [
            (token, record) for record in records if record.route is route and (token := get_token(record)) is not None
        ]
        if described:
            sizes = [max(np.count_nonzero(record.mask), 1) * record.metres_per_pixel**2 for _, record in described]
            return merge_tokens([token for token, _ in described], sizes), route
    return None, Route.PRIOR


def get_shader_name(touched: TouchedObject, slot: int) -> str:
    """Return the name of the Blender material in a slot, "" if there is none."""
    materials = touched.surface.materials
    return materials[slot] if slot < len(materials) else ""
