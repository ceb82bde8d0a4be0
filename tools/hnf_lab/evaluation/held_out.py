"""Test the shared field on held-out classes and on photographs of recorded textures.

Held-out classes: the field's expected spectrum is compared with the mean of the category and with the material of the
nearest token. All materials are stroked with the same action, so a category's mean is a mean of log spectra at the same
u(t).

Photographs: photo → token → spectrum with one texture left out at a time. Grey level is used as height; one factor from
grey to metres serves all textures, the geometric mean of the factors fitted to the others. These results are reported
and have no pass criterion.
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

from ..bootstrap import bootstrap_mean
from .methods import compute_expected_densities
from .report import ExtraTable
from .scoring import FREQUENCY_HZ, RATE_HZ

Float = NDArray[np.float64]

COUNTED_BINS = slice(1, 101)
"""Welch bins 1–100 (10–1000 Hz)."""
METHOD_NAMES = ("field, shared", "category mean", "nearest token", "oracle, 8 s")


@dataclass(frozen=True)
class KnownMaterial:
    """A material with known token, mechanics and category.

    Attributes
    ----------
    density
        (501,) long-run spectrum under the common action.
    oracle
        (501,) spectrum of 8 s of signal from another seed, or None.
    """

    name: str
    category: str
    token: NDArray[np.float32]
    mechanics: Mechanics
    density: Float
    oracle: Float | None = None


def find_held_out_names(field: Field, names: Sequence[str]) -> tuple[str, ...]:
    """Return the names listed in the field's metadata["held_out"] (a JSON list): not used in training."""
    try:
        listed = json.loads(field.metadata.get("held_out", "[]"))
    except ValueError:
        return ()
    return tuple(name for name in names if name in listed)


def measure_long_run(process: TextureProcess, action: Action, draws: int, seed: int) -> Float:
    """Return the (501,) mean Welch density of `draws` realisations of one stroke."""
    recordings = process.record([action] * draws, seed)
    return np.asarray(np.mean([welch(recording.samples, RATE_HZ)[1] for recording in recordings], axis=0))


def measure_known_material(name: str, action: Action, draws: int, oracle_draws: int, seed: int) -> KnownMaterial:
    """Measure a simulated library material under the action; runs in a worker process.

    `oracle_draws` = 0 omits the oracle.
    """
    material, process = get_material(name), SimulatedLibrary().process(name)
    density = measure_long_run(process, action, draws, 31 + seed)
    oracle = measure_long_run(process, action, oracle_draws, 7_000_032 + seed) if oracle_draws else None
    return KnownMaterial(name, material.category, material.token, material.mechanics, density, oracle)


def compute_category_mean(material: KnownMaterial, others: Sequence[KnownMaterial]) -> tuple[Float, str]:
    """Return the mean log spectrum of the other materials of the category, and the name of that set.

    All others are used if the category has no other material.
    """
    same_category = [other for other in others if other.category == material.category and other.category]
    return _compute_log_mean(
        [other.density for other in same_category or others]
    ), material.category if same_category else "all others"


def find_nearest_token(material: KnownMaterial, others: Sequence[KnownMaterial]) -> KnownMaterial:
    """Return the material with the least Euclidean distance between normalised tokens.

    Normalisation is that of the network's input: every component is of order 1.
    """
    tokens = normalise_tokens(np.stack([other.token for other in others]).astype(np.float64))
    target = normalise_tokens(material.token[None, :].astype(np.float64))
    return others[int(np.argmin(np.sum(np.square(tokens - target), axis=1)))]


def predict_spectrum(field: Field, material: KnownMaterial, action: Action) -> Float:
    """Return the (100,) average spectrum that the field expects of the stroke, bins 1–100."""
    return np.asarray(
        compute_expected_densities(field, uniform_stroke(action, material.token, material.mechanics), 2).mean(axis=0)
    )


def compute_distance_db(density: Float, reference: Float) -> float:
    """Return the average-spectrum distance [dB] over bins 1–100; `density` is (100,) or (501,)."""
    values = density[COUNTED_BINS] if len(density) > 100 else density
    return average_spectrum_distance_db(values, reference[COUNTED_BINS], FREQUENCY_HZ[COUNTED_BINS])


def make_held_out_table(
    field: Field, action: Action, held_out: Sequence[KnownMaterial], trained: Sequence[KnownMaterial], seed: int
) -> ExtraTable:
    """Build the table of average-spectrum distances for every held-out class.

    It includes the medians and the field's margin over both baselines with its 95 % interval (bootstrap over classes).
    """
    rows, figures = [], []
    for material in held_out:
        mean_density, mean_source = compute_category_mean(material, trained)
        nearest = find_nearest_token(material, trained)
        field_density = predict_spectrum(field, material, action)
        values = [
            compute_distance_db(field_density, material.density),
            compute_distance_db(mean_density, material.density),
            compute_distance_db(nearest.density, material.density),
            float("nan") if material.oracle is None else compute_distance_db(material.oracle, material.density),
        ]
        bias = power_bias_db(field_density, material.density[COUNTED_BINS], FREQUENCY_HZ[COUNTED_BINS])
        figures.append({"material": material.name, "category": mean_source, "nearest": nearest.name,
                        "field_power_bias_db": bias, **dict(zip(METHOD_NAMES, values, strict=True))})  # fmt: skip
        rows.append((material.name, *(f"{value:.2f}" for value in values), f"{bias:+.2f}", mean_source, nearest.name))
    table = np.array([[entry[name] for name in METHOD_NAMES] for entry in figures])
    medians = np.median(table, axis=0)
    rows.append(("median", *(f"{value:.2f}" for value in medians), "", "", ""))
    margins = {
        name: bootstrap_mean(table[:, index] - table[:, 0], seed)
        for index, name in ((1, METHOD_NAMES[1]), (2, METHOD_NAMES[2]))
    }
    for name, margin in margins.items():
        value = f"{margin.value:+.2f} dB, 95 % {margin.low:+.2f} … {margin.high:+.2f}"
        rows.append((f"margin over {name}", value, *[""] * 6))
    return ExtraTable(
        "held_out",
        "(c) Held-out classes: average-spectrum distance [dB]",
        f"{len(held_out)} whole classes that the weights name as never trained on, {len(trained)} others known; one "
        f"wandering stroke of {action.duration_s:g} s for all. The field is judged by its expected spectrum, the "
        "oracle by 8 s of recording.",
        ("class", *METHOD_NAMES, "field's power [dB]", "mean of", "nearest"),
        tuple(rows),
        {"classes": figures, "margins": {name: margin.to_list() for name, margin in margins.items()}},
    )


def _compute_log_mean(densities: Sequence[Float]) -> Float:
    return np.asarray(np.exp(np.mean(np.log(np.maximum(densities, 1e-30)), axis=0)))


PIXELS_PER_MM = 15.0
"""Resolution of the photographs [pixels/mm]."""
PATCH_MM = 20.0
"""Side of the described patch [mm]."""
GREY_HEIGHT_M = 1e-5
"""Height of the full grey scale before the fitted factor [m]."""
LOG_FACTORS = np.linspace(-2.5, 2.0, 19)
"""log10 of the height factors tried for each texture; values between are interpolated."""
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
"""Category → words in texture names that identify it."""


def find_category(name: str) -> str:
    """Return the category found by words in a texture's name, or "".

    Paper is tested before the abrasive, so sandpaper is paper, as in the toolkit.
    """
    plain = name.lower().replace("_", " ")
    return next((category for category, words in CATEGORIES.items() if any(word in plain for word in words)), "")


def describe_photo(path: Path) -> NDArray[np.float32]:
    """Compute the token of the middle 20 mm of a square photograph with 15 pixels/mm.

    Height is GREY_HEIGHT_M × grey level.

    Raises
    ------
    FileError
        If the image cannot be read or is too small.
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
    """Return the token of a surface 10^decades times as high.

    Bands too short for the photograph (below 133 µm) are extrapolated with the slope of the resolved bands, as for a
    self-affine surface.
    """
    out = token.copy()
    levels = out[LEVELS].astype(np.float64)
    resolved = np.flatnonzero(levels > SMOOTH_LEVEL)
    if len(resolved) >= 2:
        slope, level = np.polyfit(resolved, levels[resolved], 1)
        beyond = np.arange(len(levels)) > resolved[-1]
        levels[beyond] = level + slope * np.flatnonzero(beyond)
        resolved = np.flatnonzero(beyond | (levels > SMOOTH_LEVEL))
    levels[resolved] += decades
    out[LEVELS] = np.maximum(levels, SMOOTH_LEVEL)
    return out


def load_textures(data: DataSet, action: Action, draws: int, seed: int) -> list[KnownMaterial]:
    """Load every texture that has both a process and a photograph. The action must suit all of them."""
    out = []
    for name in data.materials:
        image, process = data.image(name), data.process(name)
        if image is not None and process is not None:
            density = measure_long_run(process, action, draws, seed)
            out.append(KnownMaterial(name, find_category(name), describe_photo(image), UNKNOWN_MECHANICS, density))
    return out


def fit_height_decades(field: Field, material: KnownMaterial, action: Action) -> float:
    """Return log10 of the height factor at which the field's power in 10–1000 Hz equals the recorded power."""
    levels = np.log([max(_predict_power(field, material, action, float(factor)), 1e-30) for factor in LOG_FACTORS])
    return float(
        np.interp(np.log(float(material.density[COUNTED_BINS].sum())), np.maximum.accumulate(levels), LOG_FACTORS)
    )


def make_photo_table(field: Field, known: Sequence[KnownMaterial], action: Action) -> ExtraTable:
    """Build the leave-one-out table of distances [dB] for three predictions.

    They are the field with the photo's token, the category mean and the nearest photo.
    """
    decades = np.array([fit_height_decades(field, material, action) for material in known])
    rows, figures = [], []
    for index, material in enumerate(known):
        others = [other for other in known if other is not material]
        mean_decades = float(np.delete(decades, index).mean())
        mean_density, mean_source = compute_category_mean(material, others)
        nearest = find_nearest_token(material, others)
        values = (
            compute_distance_db(
                predict_spectrum(field, _scale_material(material, mean_decades), action), material.density
            ),
            compute_distance_db(mean_density, material.density),
            compute_distance_db(nearest.density, material.density),
        )
        figures.append({"texture": material.name, "photo_token_field_db": values[0], "category_mean_db": values[1],
                        "nearest_photo_db": values[2], "category": mean_source, "nearest": nearest.name})  # fmt: skip
        rows.append((material.name, *(f"{value:.2f}" for value in values), mean_source, nearest.name))
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
