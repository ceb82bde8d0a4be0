"""Whole classes that the shared field never met: beside the mean of their category and the nearest token.

All are stroked with one and the same action, so that a category's mean is the mean of log spectra at the same u.

Photo → token → spectrum on textures that were recorded, one left out at a time. Reported, never gated.

The simplest honest way from a photograph to a token, and named so in the table: grey level is height. A photograph has
no metres along z, so one factor turns grey into metres for all textures: the geometric mean of what would have suited
each of the *others*. Nothing else is fitted.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.datasets.recording import DataSet, TextureProcess
from hnf_core.datasets.simulated import SimulatedLibrary
from hnf_core.errors import FileError
from hnf_core.field.features import normalise_tokens
from hnf_core.field.field import Field
from hnf_core.field.stroke import uniform_stroke
from hnf_core.material.band_descriptor import describe
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, Mechanics
from hnf_core.material.library import get_material
from hnf_core.material.token import LEVELS, SMOOTH_LEVEL
from hnf_core.metrics.spectra import average_spectrum_distance_db, power_bias_db, welch
from hnf_core.tactile.height import tactile_map_from_height

from .methods import compute_expected_densities
from .report import ExtraTable
from .scoring import FREQUENCY_HZ, RATE_HZ

Float = NDArray[np.float64]

COUNTED_BINS = slice(1, 101)
METHOD_NAMES = ("field, shared", "category mean", "nearest token", "oracle, 8 s")
BOOTSTRAPS = 2000


@dataclass(frozen=True)
class KnownMaterial:
    """A material of which E's token, mechanics and category are known. density: (501,) long-run, under the common
    action. oracle: (501,) of 8 s, from another seed."""

    name: str
    category: str
    token: NDArray[np.float32]
    mechanics: Mechanics
    density: Float
    oracle: Float | None = None


def find_held_out_names(field: Field, names: Sequence[str]) -> tuple[str, ...]:
    """Those of the names that the field's own metadata["held_out"] (a JSON list) says it was not trained on."""
    try:
        listed = json.loads(field.metadata.get("held_out", "[]"))
    except ValueError:
        return ()
    return tuple(name for name in names if name in listed)


def measure_long_run(process: TextureProcess, action: Action, draws: int, seed: int) -> Float:
    """(501,) mean Welch density of `draws` realisations of one stroke."""
    recordings = process.record([action] * draws, seed)
    return np.asarray(np.mean([welch(each.samples, RATE_HZ)[1] for each in recordings], axis=0))


def measure_known_material(name: str, action: Action, draws: int, oracle_draws: int, seed: int) -> KnownMaterial:
    """A simulated library material under the action; oracle_draws 0: without an oracle. A job for a process of its
    own."""
    material, process = get_material(name), SimulatedLibrary().process(name)
    density = measure_long_run(process, action, draws, 31 + seed)
    oracle = measure_long_run(process, action, oracle_draws, 7_000_032 + seed) if oracle_draws else None
    return KnownMaterial(name, material.category, material.token, material.mechanics, density, oracle)


def compute_category_mean(material: KnownMaterial, others: Sequence[KnownMaterial]) -> tuple[Float, str]:
    """Mean of log spectra of the others in its category; of all others where it has none. And which of the two."""
    same = [each for each in others if each.category == material.category and each.category]
    return _compute_log_mean([each.density for each in same or others]), material.category if same else "all others"


def find_nearest_token(material: KnownMaterial, others: Sequence[KnownMaterial]) -> KnownMaterial:
    """Least Euclidean distance between tokens as the network sees them: every component of order 1."""
    tokens = normalise_tokens(np.stack([each.token for each in others]).astype(np.float64))
    own = normalise_tokens(material.token[None, :].astype(np.float64))
    return others[int(np.argmin(np.sum(np.square(tokens - own), axis=1)))]


def predict_spectrum(field: Field, material: KnownMaterial, action: Action) -> Float:
    """(100,) what the field expects the whole stroke's average spectrum to be, bins 1–100."""
    return np.asarray(
        compute_expected_densities(field, uniform_stroke(action, material.token, material.mechanics), 2).mean(axis=0)
    )


def compute_distance_db(density: Float, reference: Float) -> float:
    """Average-spectrum distance over bins 1–100, from (100,) or (501,)."""
    ours = density[COUNTED_BINS] if len(density) > 100 else density
    return average_spectrum_distance_db(ours, reference[COUNTED_BINS], FREQUENCY_HZ[COUNTED_BINS])


def make_held_out_table(
    field: Field, action: Action, held_out: Sequence[KnownMaterial], trained: Sequence[KnownMaterial], seed: int
) -> ExtraTable:
    """Distance of each prediction for every held-out class, medians, and the field's margin over both stand-ins with
    the 95 % interval of its mean (bootstrap over classes)."""
    rows, figures = [], []
    for one in held_out:
        mean, what = compute_category_mean(one, trained)
        near = find_nearest_token(one, trained)
        field_density = predict_spectrum(field, one, action)
        values = [
            compute_distance_db(field_density, one.density),
            compute_distance_db(mean, one.density),
            compute_distance_db(near.density, one.density),
            float("nan") if one.oracle is None else compute_distance_db(one.oracle, one.density),
        ]
        bias = power_bias_db(field_density, one.density[COUNTED_BINS], FREQUENCY_HZ[COUNTED_BINS])
        figures.append({"material": one.name, "category": what, "nearest": near.name, "field_power_bias_db": bias,
                        **dict(zip(METHOD_NAMES, values, strict=True))})  # fmt: skip
        rows.append((one.name, *(f"{value:.2f}" for value in values), f"{bias:+.2f}", what, near.name))
    table = np.array([[entry[name] for name in METHOD_NAMES] for entry in figures])
    medians = np.median(table, axis=0)
    rows.append(("median", *(f"{value:.2f}" for value in medians), "", "", ""))
    margins = {
        name: bootstrap_margin(table[:, index] - table[:, 0], seed)
        for index, name in ((1, METHOD_NAMES[1]), (2, METHOD_NAMES[2]))
    }
    for name, (mean_db, low, high) in margins.items():
        rows.append((f"margin over {name}", f"{mean_db:+.2f} dB, 95 % {low:+.2f} … {high:+.2f}", *[""] * 6))
    return ExtraTable(
        "held_out",
        "(c) Held-out classes: average-spectrum distance [dB]",
        f"{len(held_out)} whole classes that the weights name as never trained on, {len(trained)} others known; one "
        f"wandering stroke of {action.duration_s:g} s for all. The field is judged by its expected spectrum, the "
        "oracle by 8 s of recording.",
        ("class", *METHOD_NAMES, "field's power [dB]", "mean of", "nearest"),
        tuple(rows),
        {"classes": figures, "margins": {name: list(value) for name, value in margins.items()}},
    )


def bootstrap_margin(differences: Float, seed: int) -> tuple[float, float, float]:
    """Mean, and 2.5 % and 97.5 % points of the bootstrap of it."""
    rng = np.random.default_rng(seed)
    means = rng.choice(differences, (BOOTSTRAPS, len(differences))).mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(differences.mean()), float(low), float(high)


def _compute_log_mean(densities: Sequence[Float]) -> Float:
    return np.asarray(np.exp(np.mean(np.log(np.maximum(densities, 1e-30)), axis=0)))


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
