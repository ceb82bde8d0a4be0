"""Decide which library material a material slot is: the user's choice, or what it could be, weighed.

Without a choice the best-ranked material gives the name; what is felt is the expectation over the ranking.
If the height of the slot's relief is not to be believed, its shape gets the height of that material.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import MaterialError
from hnf_core.field.field import Field
from hnf_core.field.weights import load_material_field
from hnf_core.material.band_descriptor import measure_octave_heights
from hnf_core.material.encoder_registry import Encoder
from hnf_core.material.fuse import HEIGHT_LIMITS_M, FusedToken, compute_height_gain, is_too_high, merge_tokens
from hnf_core.material.hnf_file import MaterialFile, with_library_defaults
from hnf_core.material.library import LibraryMaterial, get_material, load_library
from hnf_core.material.ranking import ENOUGH_PROBABILITY, PICTURE_ODDS, Suggestion, expect_material, mix_rankings, rank
from hnf_core.material.token import Token
from hnf_core.tactile.tactile_map import Route
from hnf_core.units import m_to_mm

from .bake_patches import TouchedObject, compute_mean_appearance, fuse_patch, get_shader_token, scale_height
from .patch_cache import PatchRecord

CHOSEN_BY_ARTIST = "chosen by the artist"
LIKELY_COUNT = 3
"""Number of materials named where it could be several."""
GUESS_CONFIDENCE = 0.3
"""Confidence below which nothing in the scene supports a material; a name or a distinct appearance gives more."""


PART_CELLS = 4
"""Squares along a side of a patch of a reconstruction, 5 mm each, whose mean colors are told apart."""
PART_COLOR_STEP = 1.0 / 16.0
"""Step of the square root of a linear color within which parts of a patch count as one color."""


@dataclass(frozen=True)
class MaterialRequest:
    """Library materials requested by the user on the command line or on a stroke.

    Those set on Blender materials are not included.

    Attributes
    ----------
    choices : Mapping[int or None, str or MaterialFile]
        Slot (None for any) → library material or content of a file, from the command line.
    stroke_material : str
        Library material set on the stroke, "" for none.
    where : str
        Stroke named in errors.
    """

    choices: Mapping[int | None, str | MaterialFile] = field(default_factory=dict)
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
        What is felt: the material, or of the likeliest one's name the expectation over all that it could be.
    confidence : float
        Confidence in the kind of material, 0 to 1.
    reason : str
        Reason, for the report.
    field : Field or None
        Field that comes with the material, if it was learned.
    doubt : str
        Reason why the shape of the shader's relief has this material's height; "" if its own is kept.
    likely : tuple of (str, float)
        The first three that it could be, with their probabilities; empty if one alone is felt.
    """

    shader: str
    library: LibraryMaterial
    confidence: float
    reason: str
    field: Field | None = None
    doubt: str = ""
    likely: tuple[tuple[str, float], ...] = ()


def format_certainty(material: SlotMaterial) -> str:
    """Describe how certain a slot's material is, and why."""
    if material.reason == CHOSEN_BY_ARTIST:
        return CHOSEN_BY_ARTIST
    what = f"{material.library.category}: {format_likely(material)}" if material.likely else "it"
    return f"{material.confidence:.0%} sure of {what} ({material.reason})"


def format_likely(material: SlotMaterial) -> str:
    """Format the first three that a slot's material could be; "" if one alone is felt."""
    return ", ".join(f"{name} {probability:.0%}" for name, probability in material.likely)


def round_likely(material: SlotMaterial) -> dict[str, float]:
    """Return the first three that a slot's material could be with rounded probabilities, for the report."""
    return {name: round(probability, 4) for name, probability in material.likely}


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
    """Return the library material of a slot: the user's choice, else the expectation over the ranking.

    `records` are the results of the slot's patches, whose appearance and relief count in the ranking; of a
    reconstruction, that of one patch.
    """
    shader = get_shader_name(touched, slot)
    chosen = find_chosen_material(touched, slot, request)
    if chosen is not None:
        choice, _ = _find_choice(touched, slot, request)
        field = load_material_field(choice) if isinstance(choice, MaterialFile) else None
        return SlotMaterial(shader, chosen, 1.0, CHOSEN_BY_ARTIST, field)
    ranked = rank_materials(touched, slot, records)
    best, by_probability = ranked[0], sorted(ranked, key=lambda suggestion: -suggestion.probability)
    is_one = best.probability >= ENOUGH_PROBABILITY
    likely = () if is_one else tuple((each.name, each.probability) for each in by_probability[:LIKELY_COUNT])
    return SlotMaterial(shader, expect_material(load_library(), ranked), best.confidence, best.reason, likely=likely)


def rank_materials(touched: TouchedObject, slot: int, records: Sequence[PatchRecord]) -> tuple[Suggestion, ...]:
    """Rank all library materials for a slot, the most probable first, whatever the user chose.

    Names (of material, object and textures), appearance and relief count. `records` are the results of the slot's
    patches; of a reconstruction, in whose one slot several materials may lie, the result of one patch, whose parts of
    different colors are ranked one by one.
    """
    names = [get_shader_name(touched, slot), touched.surface.object_name, touched.obj.data.name]
    token, route = merge_relief(records)
    texture_names = touched.texture_names[slot] if slot < len(touched.texture_names) else ()
    look = PICTURE_ODDS if any(record.unlit is not None for record in records) else {}
    mean = compute_mean_appearance(records)
    parts = split_colors(records[0]) if touched.uses_splats(slot) and len(records) == 1 else ()
    looks = [(replace(mean, base_color=color), size) for color, size in parts] or [(mean, 1.0)]
    rankings = [
        rank(load_library(), appearance, names, image_names=texture_names, token=token, route=route, look=look)
        for appearance, _ in looks
    ]
    return mix_rankings(load_library(), rankings, [size for _, size in looks])


def split_colors(record: PatchRecord) -> tuple[tuple[tuple[float, float, float], float], ...]:
    """Split a patch's picture into parts of different color: their mean linear colors and numbers of pixels.

    Squares of `PART_CELLS` a side count as a whole, so that a pattern finer than those is one part. Empty if the patch
    has no picture: it is of one color.
    """
    if record.unlit is None:
        return ()
    linear = record.unlit.linear.astype(np.float64)
    height, width = record.mask.shape
    cell = (np.arange(height) * PART_CELLS // height)[:, None] * PART_CELLS + np.arange(width) * PART_CELLS // width
    weights = np.bincount(cell[record.mask], minlength=PART_CELLS**2).astype(np.float64)
    sums = [np.bincount(cell[record.mask], linear[record.mask][:, k], PART_CELLS**2) for k in range(3)]
    seen = weights > 0.0
    weights, colors = weights[seen], np.stack(sums, axis=1)[seen] / weights[seen, None]
    _, part = np.unique(np.floor(np.sqrt(colors) / PART_COLOR_STEP), axis=0, return_inverse=True)
    sizes = np.bincount(part.ravel(), weights)
    means = np.stack([np.bincount(part.ravel(), weights * colors[:, k]) for k in range(3)], axis=1) / sizes[:, None]
    return tuple(
        ((red, green, blue), size) for (red, green, blue), size in zip(means.tolist(), sizes.tolist(), strict=True)
    )


def merge_relief(records: Sequence[PatchRecord]) -> tuple[Token | None, Route]:
    """Return the merged token of a slot's patches, weighted by area, and its route (measured, predicted or prior).

    Only patches of the best route that any of them has are used; None and Route.PRIOR if none shows a relief. Relief of
    the mesh does not count: ridges are modelled in any material.
    """
    for route in (Route.MEASURED, Route.PREDICTED):
        described = [
            (token, record)
            for record in records
            if record.route is route and (token := get_shader_token(record)) is not None
        ]
        if described:
            sizes = [max(np.count_nonzero(record.mask), 1) * record.metres_per_pixel**2 for _, record in described]
            return merge_tokens([token for token, _ in described], sizes), route
    return None, Route.PRIOR


def get_shader_name(touched: TouchedObject, slot: int) -> str:
    """Return the name of the Blender material in a slot, "" if there is none."""
    materials = touched.surface.materials
    return materials[slot] if slot < len(materials) else ""


TOO_LOUD_DOUBT = "so much that no pen stays on it at this speed"
"""Reason to doubt a height that would shake the pen more than `LOUDEST_M_S2`."""


def settle_slot(
    touched: TouchedObject,
    slot: int,
    request: MaterialRequest,
    records: Sequence[PatchRecord],
    encoder: Encoder,
    doubt: str = "",
) -> tuple[SlotMaterial, tuple[PatchRecord, ...]]:
    """Decide the material of a slot and the height of its relief.

    Parameters
    ----------
    touched : TouchedObject
        Touched object.
    slot : int
        Material slot.
    request : MaterialRequest
        The user's choices.
    records : sequence of PatchRecord
        Results of the slot's patches.
    encoder : Encoder
        Encoder of measured maps, which describes a relief whose height was changed.
    doubt : str, optional
        Reason to doubt the relief's height; "" for none but the height itself.

    Returns
    -------
    material : SlotMaterial
        The material, with the reason if the relief has its height.
    records : tuple of PatchRecord
        The results; with the material's height if that of the relief is not to be believed.
    """
    if slot < len(touched.heights_as_authored) and touched.heights_as_authored[slot]:
        return decide_material(touched, slot, request, records), tuple(records)
    heights = [_measure_if_high(record) for record in records]
    if not any(record.height is not None for record in records):
        doubt = ""
    if not doubt and not any(each is not None and is_too_high(each) for each in heights):
        return decide_material(touched, slot, request, records), tuple(records)
    doubt = doubt or "more than any surface is known to have"
    # Metres that are not believed must not tell which material it is.
    shapeless = [replace(record, height=None, token=None, known=None) for record in records]
    material = replace(decide_material(touched, slot, request, shapeless), doubt=doubt)
    return material, _take_library_height(records, material, encoder)


def _measure_if_high(record: PatchRecord) -> NDArray[np.float64] | None:
    """Return the RMS heights of a record's octaves [m]; None without a relief or for one that is certainly low."""
    if record.height is None or record.height_peak_to_peak_m < 2.0 * HEIGHT_LIMITS_M.min():
        return None
    return measure_octave_heights(record.height, record.mask, record.metres_per_pixel)


def _take_library_height(
    records: Sequence[PatchRecord], material: SlotMaterial, encoder: Encoder
) -> tuple[PatchRecord, ...]:
    """Return the records with one factor on all heights, so that their mean power is that of the library material."""
    measured = [record for record in records if record.height is not None]
    if not measured:
        return tuple(records)
    octaves = np.sqrt(np.mean([np.square(_measure_octaves(record)) for record in measured], axis=0))
    resolved = max(record.resolved_wavelength_m for record in measured)
    gain = compute_height_gain(octaves, resolved, material.library.token)
    return tuple(
        scale_height(record, gain, f"shape of {record.height_source}, height of {material.library.name}", encoder)
        for record in records
    )


def _measure_octaves(record: PatchRecord) -> NDArray[np.float64]:
    assert record.height is not None
    return measure_octave_heights(record.height, record.mask, record.metres_per_pixel)


def fuse_record(record: PatchRecord, material: SlotMaterial) -> FusedToken:
    """Complete the token of a patch with its slot's material.

    A height that was taken from the material is as certain as the material.
    """
    fused = fuse_patch(record, material.library.token, material.confidence)
    return replace(fused, confidence=min(fused.confidence, material.confidence)) if material.doubt else fused


def format_doubt_note(material: SlotMaterial, object_name: str, before_m: float, after_m: float) -> str:
    """Return the note that a relief has the height of its material, and how to insist on its own; "" if it has not.

    `before_m` and `after_m` are its heights from top to bottom [m].
    """
    if not material.doubt:
        return ""
    return (
        f"material '{material.shader}' on '{object_name}': its relief is {format_height(before_m)} from top to "
        f"bottom, {material.doubt}; its shape is felt at the height of {material.library.name} "
        f"({format_height(after_m)}). If it is meant, tick Height as Authored under Materials in the Touch tab."
    )


def format_own_relief_note(shader: str, object_name: str, library: str) -> str:
    """Return the note that a material given on the command line does not replace the relief of the shader."""
    return (
        f"material '{shader}' on '{object_name}': the relief of its shader is kept; {library} gives friction, "
        "stiffness and the bands that this relief does not show."
    )


def format_stated_note(shader: str, height_m: float) -> str:
    """Return the note that a shader states a height [m] that will not be believed if it is true, and how to insist."""
    return (
        f"material '{shader}': its shader says {format_height(height_m)} of relief; if that is true, more than any "
        "surface has, its shape is felt at the height of what it is taken for. If it is meant, tick Height as Authored "
        "under Materials in the Touch tab."
    )


def format_height(metres: float) -> str:
    """Format a height [m] for a person, in m or mm."""
    return f"{metres:.3g} m" if metres >= 1.0 else f"{m_to_mm(metres):.3g} mm"
