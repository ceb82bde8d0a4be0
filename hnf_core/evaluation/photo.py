"""Photo → token → spectrum on textures that were recorded, one left out at a time. Reported, never gated.

The simplest honest way from a photograph to a token, and named so in the table: grey level is height. A photograph has
no metres along z, so one factor turns grey into metres for all textures: the geometric mean of what would have suited
each of the *others*. Nothing else is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.dataset import DataSet
from ..errors import FileError
from ..field.field import Field
from ..material.encoder import describe
from ..material.mechanics import UNKNOWN_MECHANICS
from ..material.token import LEVELS, SMOOTH_LEVEL
from ..tactile.height import tactile_map_from_height
from .held_out import (
    COUNTED_BINS,
    KnownMaterial,
    compute_category_mean,
    compute_distance_db,
    find_nearest_token,
    measure_long_run,
    predict_spectrum,
)
from .report import ExtraTable

Float = NDArray[np.float64]

PIXELS_PER_MM = 15.0
PATCH_MM = 20.0
GREY_HEIGHT_M = 1e-5
"""Height of the whole grey scale before the factor: where its search begins."""
LOG_FACTORS = np.linspace(-2.5, 2.0, 19)
"""log10 of the factors tried for each texture, read linearly between."""
CATEGORIES = {
    "wood": ("wood", "cork", "plywood", "mdf", "balsa"),
    "metal": ("aluminum", "metal", "steel", "mesh metal"),
    "stone": ("brick", "stone", "granite", "marble", "terra", "concrete", "slate", "pumice"),
    "tile": ("tile", "ceramic"),
    "paper": ("paper", "cardboard", "cardstock", "whiteboard", "book", "folder", "poster"),
    "plastic": ("plastic", "acrylic", "nylon mesh", "vinyl", "frosted"),
    "foam": ("foam", "styrofoam", "sponge"),
    "carpet": ("carpet", "artificial grass"),
    "carbon fibre": ("carbon",),
    "fabric": ("canvas", "denim", "silk", "velvet", "leather", "cotton", "felt", "wool", "nylon", "suede", "corduroy",
               "satin", "fleece", "flannel", "lace", "burlap", "velcro", "towel"),
}  # fmt: skip


def find_category(name: str) -> str:
    """By words in a texture's name (paper before its grit: sandpaper is paper, as in the toolkit); "" = none fits."""
    plain = name.lower().replace("_", " ")
    return next((category for category, words in CATEGORIES.items() if any(word in plain for word in words)), "")


def describe_photo(path: Path) -> NDArray[np.float32]:
    """Token of the middle 20 mm of a square photograph of 15 pixels/mm, height = GREY_M × grey level.

    Raises FileError where the picture cannot be read or is too small.
    """
    try:
        import matplotlib.image

        pixels = np.asarray(matplotlib.image.imread(path), dtype=np.float64)
    except (ImportError, OSError, ValueError, SyntaxError) as error:
        raise FileError(f"cannot be read as a picture ({error}).", where=str(path), remedy="Get it again.") from error
    if pixels.ndim not in (2, 3) or min(pixels.shape[:2]) < PATCH_MM * PIXELS_PER_MM / 2:
        raise FileError(f"has {pixels.shape} pixels.", where=str(path), remedy="Expected some 1000 × 1000.")
    top = 255.0 if pixels.max() > 1.0 else 1.0
    grey = pixels[..., :3] @ np.array([0.2126, 0.7152, 0.0722]) if pixels.ndim == 3 else pixels
    side = min(round(PATCH_MM * PIXELS_PER_MM), *grey.shape)
    row, column = (grey.shape[0] - side) // 2, (grey.shape[1] - side) // 2
    pitch = 1e-3 / PIXELS_PER_MM
    height = GREY_HEIGHT_M / top * grey[row : row + side, column : column + side]
    return describe(tactile_map_from_height(height, None, pitch, 2.0 * pitch)).values


def scale_token(token: NDArray[np.float32], decades: float) -> NDArray[np.float32]:
    """The token of a surface 10^decades times as high. Waves too short for the photograph (133 µm) go on with the slope
    of the resolved ones, as those of a self-affine surface do."""
    out = token.copy()
    levels = out[LEVELS].astype(np.float64)
    seen = np.flatnonzero(levels > SMOOTH_LEVEL)
    if len(seen) >= 2:
        slope, level = np.polyfit(seen, levels[seen], 1)
        beyond = np.arange(len(levels)) > seen[-1]
        levels[beyond] = level + slope * np.flatnonzero(beyond)
        seen = np.flatnonzero(beyond | (levels > SMOOTH_LEVEL))
    levels[seen] += decades
    out[LEVELS] = np.maximum(levels, SMOOTH_LEVEL)
    return out


def load_textures(data: DataSet, action: Action, draws: int, seed: int) -> list[KnownMaterial]:
    """Every texture that has both a process and a photograph. The action must suit all of them."""
    out = []
    for name in data.materials:
        image, process = data.image(name), data.process(name)
        if image is not None and process is not None:
            density = measure_long_run(process, action, draws, seed)
            out.append(KnownMaterial(name, find_category(name), describe_photo(image), UNKNOWN_MECHANICS, density))
    return out


def fit_height_decades(field: Field, material: KnownMaterial, action: Action) -> float:
    """log10 of the factor with which the field's power in 10–1000 Hz is the recorded one."""
    levels = np.log([max(_predict_power(field, material, action, float(each)), 1e-30) for each in LOG_FACTORS])
    return float(
        np.interp(np.log(float(material.density[COUNTED_BINS].sum())), np.maximum.accumulate(levels), LOG_FACTORS)
    )


def make_photo_table(field: Field, known: Sequence[KnownMaterial], action: Action) -> ExtraTable:
    """Leave one out: distance in dB of the field from the photo's token, the category mean and the nearest photo."""
    decades = np.array([fit_height_decades(field, one, action) for one in known])
    rows, figures = [], []
    for index, one in enumerate(known):
        others = [each for each in known if each is not one]
        left_out = float(np.delete(decades, index).mean())
        mean, what = compute_category_mean(one, others)
        near = find_nearest_token(one, others)
        values = (
            compute_distance_db(predict_spectrum(field, _scale_material(one, left_out), action), one.density),
            compute_distance_db(mean, one.density),
            compute_distance_db(near.density, one.density),
        )
        figures.append({"texture": one.name, "photo_token_field_db": values[0], "category_mean_db": values[1],
                        "nearest_photo_db": values[2], "category": what, "nearest": near.name})  # fmt: skip
        rows.append((one.name, *(f"{value:.2f}" for value in values), what, near.name))
    keys = ("photo_token_field_db", "category_mean_db", "nearest_photo_db")
    medians = [float(np.median([entry[key] for entry in figures])) for key in keys]
    rows.append(("median", *(f"{value:.2f}" for value in medians), "", ""))
    return ExtraTable(
        "photos",
        "(d) HaTT: photo → token → spectrum, leaving one out [dB]",
        "Reported, not gated. Grey level stands for height, with one factor for all from the other textures; the "
        "shared field never saw a recording. Steady, "
        f"{1e3 * float(action.speed[0]):.0f} mm/s, {float(action.force[0]):g} N.",
        ("texture", "photo → token → field", "category mean", "nearest photo", "mean of", "nearest"),
        tuple(rows),
        {"textures": figures, "medians_db": dict(zip(keys, medians, strict=True))},
    )


def _scale_material(material: KnownMaterial, decades: float) -> KnownMaterial:
    return KnownMaterial(
        material.name, material.category, scale_token(material.token, decades), material.mechanics, material.density
    )


def _predict_power(field: Field, material: KnownMaterial, action: Action, decades: float) -> float:
    return float(predict_spectrum(field, _scale_material(material, decades), action).sum())
