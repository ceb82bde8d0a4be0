"""Fit the constants of the material classes to recorded textures, and write hnf_core/data/material_constants.json.

Usage: python tools/fit_library.py --hatt DIR [--write | --leave-out | --ablate]

DIR is a copy of the Penn Haptic Texture Toolkit. Every class has six constants: height and slope of the relief,
stiffness and damping of the contact, level and slope of friction's force noise. They are fitted to the mean level, in
10 Hz bins of 20 to 1000 Hz at nine speeds and forces, of the recordings that a class is named after, blended with the
mean of their kind of stuff, since one recording differs from the next of its name almost as much as from its kind.
Classes without a recording follow by analogy. Only rounded constants are written, no spectrum. --leave-out refits each
recording's class without it and states the distance beside that of the kind's mean.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from hnf_core.field.carriers import Carriers
from hnf_core.field.force_noise import body_gains, force_noise_bands
from hnf_core.field.linear_contact import Condition, compute_axis_power
from hnf_core.files import write_text
from hnf_core.material.band_descriptor import describe
from hnf_core.material.probe import get_probe
from hnf_core.simulation.material_classes import (
    CLASS_ENTRIES,
    CONSTANTS_PATH,
    FittedConstants,
    MaterialEntry,
    build_recipe,
    derive_seed,
)
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, height_map
from hnf_core.tactile.height import tactile_map_from_height
from hnf_lab.evaluation.recordings.measure import (
    CONDITIONS,
    DIRECTIONS_RAD,
    RecordedTexture,
    read_textures,
)
from hnf_lab.evaluation.recordings.spectra import (
    DEPTH_DB,
    FINE_HZ,
    STEP_HZ,
    average_bins_db,
    average_distances,
    compare_levels,
)

Float = NDArray[np.float64]

RECORDINGS = {
    "oak-wood": ("Wood",), "painted-wood": ("Painted Wood",), "cork": ("Cork",),
    "smooth-metal": ("Aluminum",), "painted-metal": ("Metal Shelving",), "embossed-metal": ("Textured Metal",),
    "brick": ("Brick 1",), "stone-tile": ("Stone Tile 1",), "terracotta": ("Terra Cotta",),
    "cotton-canvas": ("Canvas 1", "Canvas 2"), "cotton": ("Cotton",), "denim": ("Denim",), "velvet": ("Velvet",),
    "silk": ("Silk 1",), "polyester-knit": ("Athletic Shirt",), "fleece": ("Fleece",), "terry-towel": ("Towel",),
    "velcro": ("Velcro Loops",),
    "copy-paper": ("Resume Paper",), "card": ("Greeting Card",), "cardboard": ("Cardboard",),
    "kraft-paper": ("Paper Bag",), "tissue-paper": ("Tissue Paper",), "glitter-paper": ("Glitter Paper",),
    "sandpaper": ("Sandpaper 100", "Sandpaper 220"),
    "smooth-plastic": ("Binder",), "textured-plastic": ("ABS Plastic",), "plastic-mesh": ("Plastic Mesh 1",),
    "acrylic": ("Frosted Acrylic",), "vinyl": ("Vinyl 1",), "laminate": ("Whiteboard",),
    "bubble-wrap": ("Bubble Envelope",), "carbon-fibre": ("Carbon Fiber",),
    "eva-foam": ("EPDM Foam", "Polyethylene Foam"), "styrofoam": ("Styrofoam",),
    "loop-carpet": ("Carpet 1", "Carpet 2"), "artificial-grass": ("Artificial Grass",),
    "glazed-tile": ("Ceramic",), "floor-tile": ("Floortile 1", "Floortile 2", "Floortile 4", "Floortile 6"),
    "leather": ("Leather 1 Front",), "suede": ("Leather 1 Back",), "synthetic-leather": ("Pleather",),
    "rubber": ("Textured Rubber",),
}  # fmt: skip
"""Recordings that a class is named after."""
KINDS = {
    "wood": ("Wood", "Painted Wood", "Cork"),
    "metal": ("Aluminum", "Metal Shelving", "Textured Metal"),
    "stone": ("Brick 1", "Stone Tile 1", "Terra Cotta"),
    "tile": ("Ceramic", "Floortile 1", "Floortile 2", "Floortile 4", "Floortile 6", "Stone Tile 1", "Terra Cotta"),
    "fabric": ("Canvas 1", "Canvas 2", "Cotton", "Denim", "Velvet", "Silk 1", "Athletic Shirt", "Fleece", "Towel",
               "Velcro Loops", "Leather 1 Front", "Leather 1 Back", "Pleather"),
    "leather": ("Leather 1 Front", "Leather 1 Back", "Pleather", "Canvas 1", "Canvas 2", "Denim", "Velvet"),
    "paper": ("Resume Paper", "Greeting Card", "Cardboard", "Paper Bag", "Tissue Paper", "Glitter Paper",
              "Bubble Envelope", "Binder"),
    "plastic": ("Binder", "ABS Plastic", "Plastic Mesh 1", "Frosted Acrylic", "Vinyl 1", "Whiteboard",
                "Bubble Envelope", "Carbon Fiber"),
    "foam": ("EPDM Foam", "Polyethylene Foam", "Styrofoam"),
    "carpet": ("Carpet 1", "Carpet 2", "Artificial Grass"),
    "rubber": ("Textured Rubber", "EPDM Foam", "Vinyl 1"),
    "glass": ("Whiteboard", "Frosted Acrylic", "Ceramic"),
    "abrasive": ("Sandpaper 100", "Sandpaper 220"),
}  # fmt: skip
"""Recordings of each kind of stuff; a few of a neighbouring kind where there are few."""
KIND_OF = {"sandpaper": "abrasive"}
"""Kinds of classes that are not called after their category."""


@dataclass(frozen=True)
class Analogy:
    """How the constants of a class without recording follow from another class, or from its kind.

    Attributes
    ----------
    like
        Class that it resembles, "" for the mean of its kind.
    height, stiffness, noise
        Factors on height, stiffness and level of the friction noise, set by hand.
    """

    like: str = ""
    height: float = 1.0
    stiffness: float = 1.0
    noise: float = 1.0


ANALOGIES = {
    "varnished-wood": Analogy("painted-wood", height=0.8, noise=0.9),
    "rough-sawn-wood": Analogy(height=1.6, noise=1.2),
    "bamboo": Analogy("oak-wood", noise=1.15),
    "brushed-metal": Analogy("smooth-metal", height=1.3),
    "metal-foil": Analogy("smooth-metal", stiffness=0.5),
    "metal-mesh": Analogy("embossed-metal"),
    "cast-metal": Analogy(height=1.2),
    "rusty-metal": Analogy(height=1.5, noise=1.2),
    "brass": Analogy("smooth-metal", height=0.9),
    "knurled-metal": Analogy("embossed-metal"),
    "marble": Analogy(height=0.6, noise=0.7),
    "sandstone": Analogy(height=1.2),
    "corduroy": Analogy("cotton-canvas"),
    "felt": Analogy("fleece", height=1.2),
    "wool-cloth": Analogy("cotton-canvas"),
    "flannel": Analogy("fleece"),
    "upholstery-fabric": Analogy("cotton-canvas", noise=1.1),
    "nylon-webbing": Analogy("cotton-canvas"),
    "nylon-fabric": Analogy("silk", height=1.2),
    "wax-paper": Analogy("copy-paper", height=0.8, noise=0.8),
    "ribbed-plastic": Analogy("textured-plastic", height=0.7),
    "tyre-rubber": Analogy("rubber", height=1.3),
    "clear-glass": Analogy(height=0.3, stiffness=6.0, noise=0.5),
    "frosted-glass": Analogy(height=0.8, stiffness=5.0),
}
"""Classes that differ from their kind; other classes without recording are its mean."""

LEAST_NOISE_SLOPES = {"bubble-wrap": 1.9}
"""Least slope of the force noise of classes whose level would grow with speed by an exponent below 0.4."""
SPREAD_WITHIN_NAME = 0.5
"""Variance of recordings of one name over that of names within a kind; between 0.3 and 0.8 the left-out distance is the
same, so recordings count more than the two variances alone would say (about 0.8)."""
START = np.array([-6.1, 3.6, 4.7, -0.5, -2.0, 1.9])
"""Typical log10 height [m], slope, log10 stiffness [N/m], log10 damping ratio, log10 friction noise [N] and its
slope."""
SPREAD = np.array([0.5, 0.8, 0.4, 0.2, 0.4, 0.5])
"""Standard deviation of the values in START over textures."""
PRIOR_WEIGHT = 0.1
"""Weight of a deviation from START by SPREAD, in dB: far below what a recording says."""
SLOPES = np.arange(0.0, 5.1, 0.5)
"""Slopes at which tokens are computed; they are interpolated in between."""
LOW, HIGH = np.array([-8.0, 0.0, 3.0, -1.2, -4.5, -1.0]), np.array([-4.0, 5.0, 6.5, -0.05, -0.5, 4.0])
"""Limits of the six values."""
CARRIERS = Carriers()
PEN = get_probe("pen")
Target = tuple[Float, Float]
"""Levels (conditions, bins) [dB], and weights of the same shape, 0 where a level does not count."""


@lru_cache(maxsize=128)
def compute_tokens(entry: MaterialEntry) -> NDArray[np.float32]:
    """Compute the tokens (slopes, TOKEN_DIM) of a class at the slopes SLOPES, for a height of 1 µm."""
    pitch = TILE_SIZE_M / TILE_PIXELS
    tokens = []
    for slope in SLOPES:
        constants = replace(entry.constants, height_um=1.0, slope=float(slope))
        height = height_map(build_recipe(replace(entry, constants=constants)), derive_seed(entry.name))
        tokens.append(describe(tactile_map_from_height(height, None, pitch, 2.0 * pitch)).values)
    return np.stack(tokens)


def set_constants(entry: MaterialEntry, values: Float, calibrated_on: str = "") -> MaterialEntry:
    """Return a class with constants from six values in the order of START."""
    height, slope, stiffness, damping, noise, noise_slope = (float(value) for value in values)
    return replace(
        entry,
        constants=FittedConstants(
            1e6 * 10.0**height, slope, 10.0**stiffness, 10.0**damping, 10.0**noise, noise_slope, calibrated_on
        ),
    )


def predict_levels(entry: MaterialEntry, values: Float, without: str = "") -> Float:
    """Return the levels (9, bins) [dB] of a class with six values, by the linear contact, mean over four directions.

    without: one of PARTS, which is left out.
    """
    tokens, position = compute_tokens(entry), np.clip(values[1], 0.0, SLOPES[-1]) / 0.5
    below = min(int(position), len(SLOPES) - 2)
    token = (tokens[below] * (below + 1 - position) + tokens[below + 1] * (position - below)).astype(np.float64)
    token[0:49:7] += values[0] + 6.0
    mechanics = set_constants(entry, values).mechanics
    speed, force = np.array(CONDITIONS).T
    power = np.zeros((len(speed), CARRIERS.count))
    for angle in DIRECTIONS_RAD:
        direction = np.tile([np.cos(angle), np.sin(angle)], (len(speed), 1))
        condition = Condition(
            np.tile(token, (len(speed), 1)), (mechanics,), np.zeros(len(speed), dtype=np.int32), direction, speed,
            force, np.ones(len(speed), dtype=bool), "pen",
        )  # fmt: skip
        axes = compute_axis_power(condition, CARRIERS) / len(DIRECTIONS_RAD)
        if without == PARTS[0]:
            axes = axes[:2]
        elif without == PARTS[1]:
            axes = axes[2:]
        power[:, CARRIERS.arc_slice] += axes.sum(axis=0)
    if without != PARTS[2]:
        power += force_noise_bands(speed, force, mechanics, PEN, CARRIERS)
    if without != PARTS[3]:
        power *= np.square(body_gains(speed, PEN, CARRIERS))
    return average_bins_db(spread_over_frequencies(power, speed))


PARTS = ("response along the normal", "slopes, sideways", "friction's force noise", "modes of the pen's body")
"""Parts of the linear contact that an ablation leaves out."""


RECORDER_FLOOR = 10.0**-6.8
"""Noise of the recorder [(m/s²)²/Hz], which an ablation needs where nothing else is left."""


def ablate(textures: dict[str, RecordedTexture]) -> None:
    """Print the median distance from the recordings with each of PARTS left out, constants unchanged."""
    for without in ("", *PARTS):
        distances = []
        for name, recordings in RECORDINGS.items():
            entry = CLASS_ENTRIES[name]
            levels = predict_levels(entry, get_values(entry.constants), without)
            levels = 10.0 * np.log10(10.0 ** (0.1 * levels) + RECORDER_FLOOR)
            for texture in (textures[each] for each in recordings if each in textures):
                recorded, chosen = average_bins_db(texture.density), list(texture.conditions)
                pairs = zip(levels[chosen], recorded, strict=True)
                distances.append(average_distances([compare_levels(a, b) for a, b in pairs]).total)
        print(f"{without or 'nothing':28} {np.median(distances):5.2f} dB, 90 % {np.percentile(distances, 90):5.2f} dB")


def get_values(constants: FittedConstants) -> Float:
    """Return the six values of a class's constants, in the order of START."""
    return np.array([
        np.log10(1e-6 * constants.height_um), constants.slope, np.log10(constants.stiffness_n_m),
        np.log10(constants.damping_ratio), np.log10(constants.friction_noise_n), constants.friction_noise_slope,
    ])  # fmt: skip


def spread_over_frequencies(power: Float, speed: Float) -> Float:
    """Convert powers (n, K) of carriers at speeds (n,) [m/s] to densities (n, FINE_HZ)."""
    edges = np.concatenate([FINE_HZ - 0.5 * STEP_HZ, FINE_HZ[-1:] + 0.5 * STEP_HZ])
    out = np.empty((len(speed), len(FINE_HZ)))
    for row, pace in enumerate(speed):
        total = np.zeros(len(edges))
        for part, limits in (
            (CARRIERS.time_slice, CARRIERS.time_edges()),
            (CARRIERS.arc_slice, CARRIERS.arc_edges() * pace),
        ):
            total += np.interp(edges, limits, np.concatenate([[0.0], np.cumsum(power[row, part])]))
        out[row] = np.diff(total) / STEP_HZ
    return out


def average_levels(textures: Sequence[RecordedTexture]) -> Float:
    """Return the mean levels (9, bins) [dB] of textures, NaN at conditions that none was recorded at."""
    levels = np.full((len(textures), len(CONDITIONS), len(average_bins_db(FINE_HZ))), np.nan)
    for row, texture in enumerate(textures):
        levels[row, list(texture.conditions)] = average_bins_db(texture.density)
    with np.errstate(invalid="ignore"):
        counted = np.isfinite(levels).sum(axis=0)
        return np.where(counted > 0, np.nansum(levels, axis=0) / np.maximum(counted, 1), np.nan)


def make_target(own: Sequence[RecordedTexture], kind: Sequence[RecordedTexture]) -> Target:
    """Blend the mean levels of a class's own recordings with those of its kind."""
    levels = average_levels(kind)
    if own:
        share = len(own) / (len(own) + SPREAD_WITHIN_NAME)
        mean = average_levels(own)
        levels = np.where(np.isfinite(mean), share * mean + (1.0 - share) * levels, levels)
    known = np.isfinite(levels)
    levels = np.where(known, levels, -300.0)
    weights = known & (levels >= levels.max(axis=1, keepdims=True) - DEPTH_DB)
    return levels, weights / np.sqrt(max(weights.sum(), 1))


def fit_class(entry: MaterialEntry, target: Target) -> Float:
    """Fit the six values of a class to a target by least squares of levels."""
    levels, weights = target

    def residuals(values: Float) -> Float:
        error = (predict_levels(entry, values) - levels) * weights
        return np.concatenate([error.ravel(), PRIOR_WEIGHT * (values - START) / SPREAD])

    shifts = np.array([[0.0] * 6, [-0.5, -1.0, 0.3, 0.0, 0.3, 0.3], [0.3, 0.0, -0.2, 0.0, -0.3, -0.2]])
    fits = [
        least_squares(residuals, START + shift, bounds=(LOW, HIGH), x_scale=SPREAD, diff_step=1e-3, max_nfev=30)
        for shift in shifts
    ]
    return np.asarray(min(fits, key=lambda fit: fit.cost).x)


def fit_job(job: tuple[str, Target]) -> Float:
    """Fit one class; `job` is its name and target."""
    return fit_class(CLASS_ENTRIES[job[0]], job[1])


def round_constants(constants: FittedConstants) -> FittedConstants:
    """Round constants to two significant digits, slopes to one decimal."""
    two = {
        name: float(f"{getattr(constants, name):.2g}")
        for name in ("height_um", "stiffness_n_m", "damping_ratio", "friction_noise_n")
    }
    slopes = {name: round(getattr(constants, name), 1) for name in ("slope", "friction_noise_slope")}
    return replace(constants, **two, **slopes)


def fit_all(textures: dict[str, RecordedTexture]) -> dict[str, FittedConstants]:
    """Fit all classes; those without recording follow by analogy."""
    jobs: dict[str, Target] = {}
    for name, entry in CLASS_ENTRIES.items():
        own = [textures[each] for each in RECORDINGS.get(name, ()) if each in textures]
        kind = [textures[each] for each in KINDS[KIND_OF.get(name, entry.category)] if each in textures]
        if own or not ANALOGIES.get(name, Analogy()).like:
            jobs[name] = make_target(own, kind)
    with ProcessPoolExecutor(2) as pool:
        values = dict(zip(jobs, pool.map(fit_job, jobs.items()), strict=True))
    fitted = {}
    for name, entry in CLASS_ENTRIES.items():
        analogy, count = ANALOGIES.get(name, Analogy()), len(RECORDINGS.get(name, ()))
        base = values[analogy.like or name].copy()
        if count:
            kind_name = KIND_OF.get(name, entry.category)
            source = f"{count} recorded texture{'s' * (count > 1)}, blended with the mean of {kind_name}"
        else:
            base = base + np.log10([analogy.height, 1.0, analogy.stiffness, 1.0, analogy.noise, 1.0])
            source = f"by analogy with {analogy.like or 'the mean of ' + entry.category}"
        base[5] = max(base[5], LEAST_NOISE_SLOPES.get(name, base[5]))
        fitted[name] = round_constants(set_constants(entry, base, source).constants)
    return fitted


def leave_out(textures: dict[str, RecordedTexture]) -> None:
    """Refit the class of every recording without it; print its distance beside that of its kind's mean."""
    cases = [(name, each) for name, recordings in RECORDINGS.items() for each in recordings if each in textures]
    jobs = []
    for name, left_out in cases:
        own = [textures[each] for each in RECORDINGS[name] if each in textures and each != left_out]
        kind = [
            textures[each]
            for each in KINDS[KIND_OF.get(name, CLASS_ENTRIES[name].category)]
            if each in textures and each != left_out
        ]
        jobs.append((name, make_target(own, kind)))
    with ProcessPoolExecutor(2) as pool:
        values = list(pool.map(fit_job, jobs))
    rows = []
    for (name, left_out), value in zip(cases, values, strict=True):
        texture = textures[left_out]
        recorded, chosen = average_bins_db(texture.density), list(texture.conditions)
        kind = [
            textures[each]
            for each in KINDS[KIND_OF.get(name, CLASS_ENTRIES[name].category)]
            if each in textures and each != left_out
        ]
        answers = predict_levels(CLASS_ENTRIES[name], value)[chosen], average_levels(kind)[chosen]
        distances = [
            average_distances(
                [compare_levels(a, b) for a, b in zip(answer, recorded, strict=True) if np.isfinite(a).all()]
            )
            for answer in answers
        ]
        rows.append([distance.total for distance in distances])
        print(f"{left_out:20} {name:18} {rows[-1][0]:6.2f} {rows[-1][1]:6.2f}", flush=True)
    refitted, kind_mean = np.nanmedian(rows, axis=0)
    print(f"median: class refitted without it {refitted:.2f} dB, mean of its kind on the same folds {kind_mean:.2f} dB")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hatt", type=Path, required=True, help="copy of the Penn Haptic Texture Toolkit")
    parser.add_argument("--write", action="store_true", help=f"write {CONSTANTS_PATH.relative_to(ROOT)}")
    parser.add_argument("--leave-out", action="store_true", help="cross-validate instead")
    parser.add_argument("--ablate", action="store_true", help="state what each part of the contact contributes instead")
    arguments = parser.parse_args()
    textures = {texture.name: texture for texture in read_textures(arguments.hatt)}
    if arguments.leave_out:
        leave_out(textures)
        return 0
    if arguments.ablate:
        ablate(textures)
        return 0
    fitted = fit_all(textures)
    for name, constants in fitted.items():
        values = asdict(constants)
        print(f"{name:18}", *(f"{values[key]:>9}" for key in list(values)[:-1]), values["calibrated_on"])
    if arguments.write:
        record = {name: asdict(constants) for name, constants in fitted.items()}
        write_text(CONSTANTS_PATH, json.dumps(record, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
