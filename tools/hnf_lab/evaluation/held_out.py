"""Test the shared field on held-out classes.

The field's expected spectrum is compared with the mean of the category and with the material of the nearest token. All
materials are stroked with the same action, so a category's mean is a mean of log spectra at the same u(t).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.datasets.recording import TextureProcess
from hnf_core.datasets.simulated import SimulatedLibrary
from hnf_core.field.features import normalise_tokens
from hnf_core.field.field import Field
from hnf_core.field.stroke import uniform_stroke
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import get_material
from hnf_core.metrics.spectra import average_spectrum_distance_db, welch

from ..bootstrap import bootstrap_mean
from .methods import compute_expected_densities
from .metrics import power_bias_db
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
