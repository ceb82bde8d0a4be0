"""The shared field against its bars: per-material fields, fewer materials, other directions, classes never met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..field.config import FieldConfig
from ..field.features import normalise_tokens
from .conditions import StrokeCondition
from .fit import Schedule, build_training_set, fit_network
from .gathering import TrainingData
from .model import FieldNetwork
from .references import (
    References,
    compute_distances_db,
    compute_new_patch_distances_db,
    predict_spectra,
    select_materials,
)

Float = NDArray[np.float64]

SINGLE_MATERIAL_SCHEDULE = Schedule(epochs=100, batch=32, learning_rate=5e-3, token_noise=0.0, ridge=1e-3)
LONG_SCHEDULE = replace(SINGLE_MATERIAL_SCHEDULE, epochs=40)
"""For twelve times the data."""
BOOTSTRAP_DRAWS = 4000
"""Draws of the bootstrap."""


def make_single_material_config(hidden: int) -> FieldConfig:
    """A field for one material: the same carriers and linear contact, two layers."""
    return FieldConfig(hidden=hidden, layers=2, line_gains=True, stroke_frame=True)


def measure_single_material_field_db(
    training_data: TrainingData,
    references: References,
    material: int,
    hidden: int,
    seed: int,
    schedule: Schedule = SINGLE_MATERIAL_SCHEDULE,
) -> float:
    """Distance, mean over conditions, of a field trained on that material's strokes alone and asked with one of its
    training tokens: for one material a token is a constant."""
    strokes = training_data.select_strokes(training_data.get_stroke_materials() == material)
    patch = int(np.flatnonzero(training_data.material == material)[0])
    constant = tuple(replace(stroke, surface=patch) for stroke in strokes.strokes)
    config = make_single_material_config(hidden)
    data = build_training_set(config, constant, training_data.tokens, strokes.power, 1, seed)
    network = fit_network(config, data, schedule, seed)
    alone = select_materials(references, [material])
    return float(compute_distances_db(alone, predict_spectra(network, alone, training_data.tokens[[patch]])).mean())


def measure_training_token_db(network: FieldNetwork, references: References, data: TrainingData) -> Float:
    """(M,) as on_new_patches_db, but asked with the tokens of the patches trained on."""
    stroked = np.unique([stroke.surface for stroke in data.strokes])
    patches = [stroked[data.material[stroked] == material] for material in range(len(data.names))]
    return np.asarray(
        np.mean(
            [
                compute_distances_db(
                    references, predict_spectra(network, references, data.tokens[[p[k] for p in patches]])
                )
                for k in range(min(len(p) for p in patches))
            ],
            axis=(0, 2),
        )
    )


@dataclass(frozen=True)
class UnseenMaterial:
    """Of one material of a class that was left out: distance [dB] of the field, of the mean log spectrum of its
    category under the same strokes, and of the nearest material in token space (its name: nearest)."""

    name: str
    class_name: str
    field_db: float
    category_db: float
    nearest_db: float
    nearest: str


def measure_unseen_materials(
    network: FieldNetwork, references: References, held_out: Sequence[str], category_of: dict[str, str]
) -> list[UnseenMaterial]:
    """Every material of the held-out classes. The rivals know the simulator's own long-run spectra of all others."""
    classes = [each.class_name for each in references.specimens]
    known = np.array([name not in held_out for name in classes])
    field_db = compute_new_patch_distances_db(network, references)
    level = np.log(references.spectra)
    token = normalise_tokens(references.tokens.astype(np.float64).mean(axis=1))
    found = []
    for row in np.flatnonzero(~known):
        alone = select_materials(references, [int(row)])
        same = known & np.array([category_of[name] == category_of[classes[row]] for name in classes])
        mean = np.exp(level[same].mean(axis=0))[None]
        apart = np.where(known, np.linalg.norm(token - token[row], axis=1), np.inf)
        nearest = int(np.argmin(apart))
        found.append(
            UnseenMaterial(
                name=references.specimens[row].name,
                class_name=classes[row],
                field_db=float(field_db[row]),
                category_db=float(compute_distances_db(alone, mean).mean()),
                nearest_db=float(compute_distances_db(alone, references.spectra[[nearest]]).mean()),
                nearest=references.specimens[nearest].name,
            )
        )
    return found


def bootstrap_mean(values: Float, seed: int) -> tuple[float, float, float]:
    """Mean and its 95 % interval by bootstrap (B. Efron 1979) over values."""
    rng = np.random.default_rng(seed)
    means = rng.choice(values, (BOOTSTRAP_DRAWS, len(values))).mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(values.mean()), float(low), float(high)


def make_eight_directions(speed: int, force: float) -> list[StrokeCondition]:
    """Every 22.5° over half a turn, from 11.25° on: the other half is the same line backwards."""
    return [StrokeCondition(speed, force, float(np.radians(11.25 + 22.5 * k))) for k in range(8)]


@dataclass(frozen=True)
class DirectionErrors:
    """Of one material under eight directions. anisotropy_db: loudest over quietest power, of the simulator, and as the
    field has it. ratio_db: RMS error of the level of each direction's spectrum over the loudest's, per 10 Hz bin;
    third_db: the same of third octaves; power_db: the same of the whole band's power."""

    name: str
    anisotropy_db: float
    field_anisotropy_db: float
    ratio_db: float
    third_db: float
    power_db: float


def measure_directions(references: References, expected: Float) -> list[DirectionErrors]:
    """references: of eight_directions. expected: (M, 8, FINE_BINS) of the field."""
    found = []
    for row, each in enumerate(references.specimens):
        true, inside = references.spectra[row], references.mask_counted_bins()[row]
        loudest = int(np.argmax(true.sum(axis=1)))
        others = [k for k in range(len(true)) if k != loudest]
        error = _compute_ratio_error(expected[row], true, loudest)
        both = inside & inside[loudest]
        third_field, third_true = (_sum_bands(s, _make_third_octaves()) for s in (expected[row], true))
        counts = np.stack([both[:, a:b].all(axis=1) for a, b in _make_third_octaves()], axis=1)
        whole = [10.0 * np.log10(s.sum(axis=1)) for s in (true, expected[row])]
        found.append(
            DirectionErrors(
                name=each.name,
                anisotropy_db=float(np.ptp(whole[0])),
                field_anisotropy_db=float(np.ptp(whole[1])),
                ratio_db=_compute_masked_rms(error[others], both[others]),
                third_db=_compute_masked_rms(_compute_ratio_error(third_field, third_true, loudest)[others], counts[others]),
                power_db=float(np.sqrt(np.mean(np.square(((whole[1] - whole[1][loudest]) -
                                                          (whole[0] - whole[0][loudest]))[others])))),
            )
        )  # fmt: skip
    return found


def _compute_ratio_error(expected: Float, true: Float, loudest: int) -> Float:
    level = 10.0 * np.log10(expected / true)
    return np.asarray(level - level[loudest])


def _sum_bands(spectrum: Float, bands: Sequence[tuple[int, int]]) -> Float:
    return np.stack([spectrum[:, a:b].sum(axis=1) for a, b in bands], axis=1)


def _make_third_octaves() -> list[tuple[int, int]]:
    """Bins of the third octaves from 31.5 Hz to 800 Hz, as slices of bins 1–100."""
    centres = 1000.0 * 2.0 ** (np.arange(-15, 0) / 3.0)
    edges = np.unique(
        np.rint(np.append(centres * 2.0 ** (-1.0 / 6.0), 1000.0 * 2.0 ** (-1.0 / 6.0)) / 10.0).astype(int)
    )
    return [(int(a) - 1, int(b) - 1) for a, b in pairwise(edges)]


def _compute_masked_rms(values: Float, inside: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.where(inside, np.square(values), 0.0).sum() / max(int(inside.sum()), 1)))
