"""Whole classes that the shared field never met: beside the mean of their category and the nearest token.

All are stroked with one and the same action, so that a category's mean is the mean of log spectra at the same u.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.recording import TextureProcess
from ..datasets.simulated import SimulatedLibrary
from ..field.features import normalise_tokens
from ..field.field import Field
from ..field.stroke import uniform_stroke
from ..material.library import get_material
from ..material.mechanics import Mechanics
from ..metrics.average_spectrum import average_spectrum_distance_db, power_bias_db
from ..metrics.spectra import welch
from .expected_magnitude import compute_expected_densities
from .reference import FREQUENCY_HZ, RATE_HZ
from .report import ExtraTable

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
