"""What a material slot is taken to be: the artist's word, else the best-ranked library material."""

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
"""Below this nothing in the scene spoke for a material: a word in a name, or a look that fits one kind, gives more."""


@dataclass(frozen=True)
class MaterialRequest:
    """What the artist said beside the materials themselves. choices: slot (None = any) → library material named on the
    command line. own: that one stroke asks for, "" = nothing. where: what asks, for errors."""

    choices: Mapping[int | None, str] = field(default_factory=dict)
    stroke_material: str = ""
    where: str = ""


@dataclass(frozen=True)
class SlotMaterial:
    """What a material slot is taken to be. shader: the material's own name. reason: why, for the report. field: what
    the material brings of its own, None = nothing."""

    shader: str
    library: LibraryMaterial
    confidence: float
    reason: str
    field: Field | None = None


def format_certainty(material: SlotMaterial) -> str:
    """How sure it is that this is the material, and why; a choice is no matter of shares."""
    return (
        CHOSEN_BY_ARTIST
        if material.reason == CHOSEN_BY_ARTIST
        else f"{material.confidence:.0%} sure of it ({material.reason})"
    )


def format_guess_note(material: SlotMaterial, object_name: str) -> str:
    """What to say of a material that nothing much speaks for; "" of any other."""
    if material.reason == CHOSEN_BY_ARTIST or material.confidence >= GUESS_CONFIDENCE:
        return ""
    what = f"material '{material.shader}' on '{object_name}'" if material.shader else f"object '{object_name}'"
    return (
        f"{what}: {material.library.name} is a guess ({material.confidence:.0%} sure). Say what it is under Feels in "
        "the Touch tab."
    )


def find_chosen_material(touched: TouchedObject, slot: int, request: MaterialRequest) -> LibraryMaterial | None:
    """The artist's own choice, None where there is none: of the command line, then the stroke's, then the material's
    own, from the library or from the definition that it carries.

    Raises MaterialError that says where the unknown name was given, and what is close to it.
    """
    word, where = _find_choice(touched, slot, request)
    if isinstance(word, MaterialFile):
        return with_library_defaults(word)
    if not word:
        return None
    try:
        return get_material(word)
    except MaterialError as error:
        raise MaterialError(error.what, where=where, remedy=error.remedy) from None


def _find_choice(touched: TouchedObject, slot: int, request: MaterialRequest) -> tuple[str | MaterialFile, str]:
    """The word that counts, "" = none, and where it was given."""
    words: dict[str, str | MaterialFile] = {
        "--material": request.choices.get(slot) or request.choices.get(None) or "",
        request.where: request.stroke_material,
        f"material '{get_shader_name(touched, slot)}'": touched.artist_choices[slot]
        if slot < len(touched.artist_choices)
        else "",
    }
    return next(((word, where) for where, word in words.items() if word), ("", ""))


def decide_material(
    touched: TouchedObject, slot: int, request: MaterialRequest, records: Sequence[PatchRecord]
) -> SlotMaterial:
    """The artist's choice if there is one, else the best-ranked material. records: of patches in this slot."""
    shader = get_shader_name(touched, slot)
    chosen = find_chosen_material(touched, slot, request)
    if chosen is not None:
        word, _ = _find_choice(touched, slot, request)
        field = load_material_field(word) if isinstance(word, MaterialFile) else None
        return SlotMaterial(shader, chosen, 1.0, CHOSEN_BY_ARTIST, field)
    best = rank_materials(touched, slot, records)[0]
    return SlotMaterial(shader, get_material(best.name), best.confidence, best.reason)


def rank_materials(touched: TouchedObject, slot: int, records: Sequence[PatchRecord]) -> tuple[Suggestion, ...]:
    """The whole library for a slot, the most apt first, whatever the artist chose: by names,
    pictures' names among them, looks and relief."""
    names = [get_shader_name(touched, slot), touched.surface.object_name, touched.obj.data.name]
    token, route = merge_relief(records)
    pictures = touched.texture_names[slot] if slot < len(touched.texture_names) else ()
    return rank(load_library(), compute_mean_appearance(records), names, image_names=pictures, token=token, route=route)


def merge_relief(records: Sequence[PatchRecord]) -> tuple[Token | None, Route]:
    """What the patches show of a slot's relief together, by the area that each shows: of those by the surest route that
    any of them has."""
    for route in (Route.MEASURED, Route.PREDICTED):
        seen = [(token, each) for each in records if each.route is route and (token := get_token(each)) is not None]
        if seen:
            sizes = [max(np.count_nonzero(each.mask), 1) * each.metres_per_pixel**2 for _, each in seen]
            return merge_tokens([token for token, _ in seen], sizes), route
    return None, Route.PRIOR


def get_shader_name(touched: TouchedObject, slot: int) -> str:
    """The Blender material in a slot, "" where there is none."""
    materials = touched.surface.materials
    return materials[slot] if slot < len(materials) else ""
