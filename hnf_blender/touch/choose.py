"""What a material slot is taken to be: the artist's word, else the best-ranked library material."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hnf_core.errors import MaterialError
from hnf_core.field.field import Field
from hnf_core.field.learned import field_of
from hnf_core.material.hnf_file import MaterialFile, completed
from hnf_core.material.library import find, load_library
from hnf_core.material.material import LibraryMaterial
from hnf_core.material.merge import merge
from hnf_core.material.prior import Suggestion, rank
from hnf_core.material.token import Token
from hnf_core.tactile.tactile_map import Route

from .bake import TouchedObject, mean_appearance, token_of
from .store import PatchRecord

CHOSEN = "chosen by the artist"
GUESS = 0.3
"""Below this nothing in the scene spoke for a material: a word in a name, or a look that fits one kind, gives more."""


@dataclass(frozen=True)
class Asked:
    """What the artist said beside the materials themselves. choices: slot (None = any) → library material named on the
    command line. own: that one stroke asks for, "" = nothing. where: what asks, for errors."""

    choices: Mapping[int | None, str] = field(default_factory=dict)
    own: str = ""
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


def certainty_in_words(material: SlotMaterial) -> str:
    """How sure it is that this is the material, and why; a choice is no matter of shares."""
    return CHOSEN if material.reason == CHOSEN else f"{material.confidence:.0%} sure of it ({material.reason})"


def guess_note(material: SlotMaterial, object_name: str) -> str:
    """What to say of a material that nothing much speaks for; "" of any other."""
    if material.reason == CHOSEN or material.confidence >= GUESS:
        return ""
    what = f"material '{material.shader}' on '{object_name}'" if material.shader else f"object '{object_name}'"
    return (
        f"{what}: {material.library.name} is a guess ({material.confidence:.0%} sure). Say what it is under Feels in "
        "the Touch tab."
    )


def chosen_material(touched: TouchedObject, slot: int, asked: Asked) -> LibraryMaterial | None:
    """The artist's own choice, None where there is none: of the command line, then the stroke's, then the material's
    own, from the library or from the definition that it carries.

    Raises MaterialError that says where the unknown name was given, and what is close to it.
    """
    word, where = _said(touched, slot, asked)
    if isinstance(word, MaterialFile):
        return completed(word)
    if not word:
        return None
    try:
        return find(word)
    except MaterialError as error:
        raise MaterialError(error.what, where=where, remedy=error.remedy) from None


def _said(touched: TouchedObject, slot: int, asked: Asked) -> tuple[str | MaterialFile, str]:
    """The word that counts, "" = none, and where it was given."""
    words: dict[str, str | MaterialFile] = {
        "--material": asked.choices.get(slot) or asked.choices.get(None) or "",
        asked.where: asked.own,
        f"material '{shader_name(touched, slot)}'": touched.chosen[slot] if slot < len(touched.chosen) else "",
    }
    return next(((word, where) for where, word in words.items() if word), ("", ""))


def decide_material(touched: TouchedObject, slot: int, asked: Asked, records: Sequence[PatchRecord]) -> SlotMaterial:
    """The artist's choice if there is one, else the best-ranked material. records: of patches in this slot."""
    shader = shader_name(touched, slot)
    chosen = chosen_material(touched, slot, asked)
    if chosen is not None:
        word, _ = _said(touched, slot, asked)
        field = field_of(word) if isinstance(word, MaterialFile) else None
        return SlotMaterial(shader, chosen, 1.0, CHOSEN, field)
    best = ranked_materials(touched, slot, records)[0]
    return SlotMaterial(shader, find(best.name), best.confidence, best.reason)


def ranked_materials(touched: TouchedObject, slot: int, records: Sequence[PatchRecord]) -> tuple[Suggestion, ...]:
    """The whole library for a slot, the most apt first, whatever the artist chose: by names,
    pictures' names among them, looks and relief."""
    names = [shader_name(touched, slot), touched.surface.object_name, touched.obj.data.name]
    token, route = relief_of(records)
    pictures = touched.pictures[slot] if slot < len(touched.pictures) else ()
    return rank(load_library(), mean_appearance(records), names, pictures=pictures, token=token, route=route)


def relief_of(records: Sequence[PatchRecord]) -> tuple[Token | None, Route]:
    """What the patches show of a slot's relief together, by the area that each shows: of those by the surest route that
    any of them has."""
    for route in (Route.MEASURED, Route.PREDICTED):
        seen = [(token, each) for each in records if each.route is route and (token := token_of(each)) is not None]
        if seen:
            sizes = [max(np.count_nonzero(each.mask), 1) * each.metres_per_pixel**2 for _, each in seen]
            return merge([token for token, _ in seen], sizes), route
    return None, Route.PRIOR


def shader_name(touched: TouchedObject, slot: int) -> str:
    """The Blender material in a slot, "" where there is none."""
    materials = touched.surface.materials
    return materials[slot] if slot < len(materials) else ""
