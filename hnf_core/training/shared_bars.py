"""The shared field against its bars: per-material fields, fewer materials, other directions, classes never met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..field.config import FieldConfig
from ..field.features import normalised_tokens
from .conditions import Condition
from .fit import Schedule, fit, training_set
from .gathering import Gathered
from .model import FieldNetwork
from .references import References, distances_db, expected_at, on_new_patches_db

Float = NDArray[np.float64]

OWN_SCHEDULE = Schedule(epochs=100, batch=32, learning_rate=5e-3, token_noise=0.0, ridge=1e-3)
LONG_SCHEDULE = replace(OWN_SCHEDULE, epochs=40)
"""For twelve times the data."""
RESAMPLED = 4000
"""Draws of the bootstrap."""


def own_config(hidden: int) -> FieldConfig:
    """A field for one material: the same carriers and linear contact, two layers."""
    return FieldConfig(hidden=hidden, layers=2, line_gains=True, stroke_frame=True)


def own_field_db(
    gathered: Gathered,
    references: References,
    material: int,
    hidden: int,
    seed: int,
    schedule: Schedule = OWN_SCHEDULE,
) -> float:
    """Distance, mean over conditions, of a field trained on that material's strokes alone and asked with one of its
    training tokens: for one material a token is a constant."""
    strokes = gathered.only(gathered.material_of_strokes() == material)
    patch = int(np.flatnonzero(gathered.material == material)[0])
    constant = tuple(replace(stroke, surface=patch) for stroke in strokes.strokes)
    config = own_config(hidden)
    data = training_set(config, constant, gathered.tokens, strokes.power, 1, seed)
    network = fit(config, data, schedule, seed)
    alone = only_materials(references, [material])
    return float(distances_db(alone, expected_at(network, alone, gathered.tokens[[patch]])).mean())


def only_materials(references: References, materials: Sequence[int]) -> References:
    """The references of some materials."""
    rows = list(materials)
    return replace(
        references,
        specimens=tuple(references.specimens[row] for row in rows),
        tokens=references.tokens[rows],
        spectra=references.spectra[rows],
        scatter_db=references.scatter_db[rows],
    )


def with_training_tokens_db(network: FieldNetwork, references: References, gathered: Gathered) -> Float:
    """(M,) as on_new_patches_db, but asked with the tokens of the patches trained on."""
    stroked = np.unique([stroke.surface for stroke in gathered.strokes])
    patches = [stroked[gathered.material[stroked] == material] for material in range(len(gathered.names))]
    return np.asarray(
        np.mean(
            [
                distances_db(references, expected_at(network, references, gathered.tokens[[p[k] for p in patches]]))
                for k in range(min(len(p) for p in patches))
            ],
            axis=(0, 2),
        )
    )


def only_classes(gathered: Gathered, kept: Sequence[str]) -> Gathered:
    """Strokes on materials of these classes and on surfaces of no material."""
    classes = np.array([name in kept for name in gathered.classes])
    material = gathered.material_of_strokes()
    return gathered.only(np.where(material < 0, True, classes[material]))


@dataclass(frozen=True)
class Unseen:
    """Of one material of a class that was left out: distance [dB] of the field, of the mean log spectrum of its
    category under the same strokes, and of the nearest material in token space (its name: nearest)."""

    name: str
    class_name: str
    field_db: float
    category_db: float
    nearest_db: float
    nearest: str


def unseen_materials(
    network: FieldNetwork, references: References, held_out: Sequence[str], category_of: dict[str, str]
) -> list[Unseen]:
    """Every material of the held-out classes. The rivals know the simulator's own long-run spectra of all others."""
    classes = [each.class_name for each in references.specimens]
    known = np.array([name not in held_out for name in classes])
    field_db = on_new_patches_db(network, references)
    level = np.log(references.spectra)
    token = normalised_tokens(references.tokens.astype(np.float64).mean(axis=1))
    found = []
    for row in np.flatnonzero(~known):
        alone = only_materials(references, [int(row)])
        same = known & np.array([category_of[name] == category_of[classes[row]] for name in classes])
        mean = np.exp(level[same].mean(axis=0))[None]
        apart = np.where(known, np.linalg.norm(token - token[row], axis=1), np.inf)
        nearest = int(np.argmin(apart))
        found.append(
            Unseen(
                name=references.specimens[row].name,
                class_name=classes[row],
                field_db=float(field_db[row]),
                category_db=float(distances_db(alone, mean).mean()),
                nearest_db=float(distances_db(alone, references.spectra[[nearest]]).mean()),
                nearest=references.specimens[nearest].name,
            )
        )
    return found


def mean_with_interval(values: Float, seed: int) -> tuple[float, float, float]:
    """Mean and its 95 % interval by bootstrap (B. Efron 1979) over values."""
    rng = np.random.default_rng(seed)
    means = rng.choice(values, (RESAMPLED, len(values))).mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(values.mean()), float(low), float(high)


def eight_directions(speed: int, force: float) -> list[Condition]:
    """Every 22.5° over half a turn, from 11.25° on: the other half is the same line backwards."""
    return [Condition(speed, force, float(np.radians(11.25 + 22.5 * k))) for k in range(8)]


@dataclass(frozen=True)
class Directions:
    """Of one material under eight directions. anisotropy_db: loudest over quietest power, of the simulator, and as the
    field has it. ratio_db: RMS error of the level of each direction's spectrum over the loudest's, per 10 Hz bin;
    third_db: the same of third octaves; power_db: the same of the whole band's power."""

    name: str
    anisotropy_db: float
    field_anisotropy_db: float
    ratio_db: float
    third_db: float
    power_db: float


def directions_of(references: References, expected: Float) -> list[Directions]:
    """references: of eight_directions. expected: (M, 8, FINE_BINS) of the field."""
    found = []
    for row, each in enumerate(references.specimens):
        true, inside = references.spectra[row], references.inside()[row]
        loudest = int(np.argmax(true.sum(axis=1)))
        others = [k for k in range(len(true)) if k != loudest]
        error = _ratio_error(expected[row], true, loudest)
        both = inside & inside[loudest]
        third_field, third_true = (_summed(s, _thirds()) for s in (expected[row], true))
        counts = np.stack([both[:, a:b].all(axis=1) for a, b in _thirds()], axis=1)
        whole = [10.0 * np.log10(s.sum(axis=1)) for s in (true, expected[row])]
        found.append(
            Directions(
                name=each.name,
                anisotropy_db=float(np.ptp(whole[0])),
                field_anisotropy_db=float(np.ptp(whole[1])),
                ratio_db=_rms_where(error[others], both[others]),
                third_db=_rms_where(_ratio_error(third_field, third_true, loudest)[others], counts[others]),
                power_db=float(np.sqrt(np.mean(np.square(((whole[1] - whole[1][loudest]) -
                                                          (whole[0] - whole[0][loudest]))[others])))),
            )
        )  # fmt: skip
    return found


def _ratio_error(expected: Float, true: Float, loudest: int) -> Float:
    level = 10.0 * np.log10(expected / true)
    return np.asarray(level - level[loudest])


def _summed(spectrum: Float, bands: Sequence[tuple[int, int]]) -> Float:
    return np.stack([spectrum[:, a:b].sum(axis=1) for a, b in bands], axis=1)


def _thirds() -> list[tuple[int, int]]:
    """Bins of the third octaves from 31.5 Hz to 800 Hz, as slices of bins 1–100."""
    centres = 1000.0 * 2.0 ** (np.arange(-15, 0) / 3.0)
    edges = np.unique(
        np.rint(np.append(centres * 2.0 ** (-1.0 / 6.0), 1000.0 * 2.0 ** (-1.0 / 6.0)) / 10.0).astype(int)
    )
    return [(int(a) - 1, int(b) - 1) for a, b in pairwise(edges)]


def _rms_where(values: Float, inside: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.where(inside, np.square(values), 0.0).sum() / max(int(inside.sum()), 1)))
