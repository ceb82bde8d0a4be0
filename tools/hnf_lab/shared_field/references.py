"""Long-run spectra of the contact simulator, to evaluate a trained field, and their distance from its prediction.

The distance is that of the benchmark: RMS over the 10 Hz bins in 10–1000 Hz within 30 dB of the simulated spectrum's
peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hnf_core.errors import FileError
from hnf_core.field.field import FieldConfig
from hnf_core.files import write_bytes
from hnf_core.safetensors_io import dump_tensors, load_tensors
from hnf_core.training.model import FieldNetwork
from hnf_core.training.windows import FINE_BINS
from hnf_lab.shared_field.simulated_strokes import (
    Specimen,
    SteadyStroke,
    StrokeCondition,
    Surface,
    make_patches,
    record_strokes,
)

from .fit import Likelihood, build_network_inputs

Float = NDArray[np.float64]

FIRST_REFERENCE_PATCH = 100
"""Index of the first reference patch; no patch from here on is trained on."""
PATCHES, STARTS, SECONDS = 3, 3, 1.0
"""Patches, starts and seconds per condition: 9 s in all, whose mean scatters by some 0.35 dB per bin."""
WITHIN_DB = 30.0
"""Range below the peak in which bins count [dB]."""


@dataclass(frozen=True)
class References:
    """Simulated mean spectra of M materials under C conditions (speed, force, direction), to compare a field with.

    Attributes
    ----------
    specimens, conditions
        Materials and conditions, in the order of the arrays.
    tokens
        (M, PATCHES, TOKEN_DIM) of the simulated patches.
    spectra
        (M, C, FINE_BINS) power density per 10 Hz bin, mean over patches and starting points of strokes.
    scatter_db
        (M, C) standard error of a bin of the mean spectrum [dB], RMS over the bins that count.
    """

    specimens: tuple[Specimen, ...]
    conditions: tuple[StrokeCondition, ...]
    tokens: NDArray[np.float32]
    spectra: Float
    scatter_db: Float

    def mask_counted_bins(self) -> NDArray[np.bool_]:
        """Return a mask (M, C, FINE_BINS) of the bins that are compared, within WITHIN_DB of each spectrum's peak."""
        return np.asarray(self.spectra >= self.spectra.max(axis=-1, keepdims=True) * 10.0 ** (-WITHIN_DB / 10.0))


def simulate_references(
    specimens: Sequence[Specimen],
    conditions: Sequence[StrokeCondition],
    seed: int,
    workers: int = 2,
    seconds: float = SECONDS,
) -> References:
    """Simulate strokes on every material (specimen) under every condition, and average their spectra.

    seconds: duration of each stroke.
    """
    surfaces: list[Surface] = make_patches(specimens, FIRST_REFERENCE_PATCH, PATCHES, workers)
    rng = np.random.default_rng(seed)
    strokes = [
        SteadyStroke(m * PATCHES + patch, specimen.mechanics, "pen", c.speed, c.angle, c.force,
               (float(rng.uniform(0.0, 0.02)), float(rng.uniform(0.0, 0.02))))
        for m, specimen in enumerate(specimens) for c in conditions for _ in range(STARTS) for patch in range(PATCHES)
    ]  # fmt: skip
    shape = (len(specimens), len(conditions), STARTS, PATCHES, -1)
    power = record_strokes(surfaces, strokes, seconds, workers).reshape(shape)[..., :FINE_BINS]
    start_means = power.mean(axis=3)
    tokens = np.stack([surface.token for surface in surfaces]).reshape(len(specimens), PATCHES, -1)
    references = References(tuple(specimens), tuple(conditions), tokens, start_means.mean(axis=2), np.zeros(0))
    error = (10.0 * np.log10(start_means)).std(axis=2, ddof=1) / np.sqrt(STARTS)
    return replace(references, scatter_db=_compute_rms(error, references.mask_counted_bins()))


def predict_spectra(
    network: FieldNetwork, references: References, tokens: NDArray[np.float32], mechanics_known: bool = True
) -> Float:
    """Compute the spectra (M, C, FINE_BINS) that a field predicts for the simulated materials and conditions.

    tokens: (M, TOKEN_DIM). mechanics_known: False leaves all mechanics unknown.
    """
    strokes = [
        SteadyStroke(m, specimen.mechanics, "pen", c.speed, c.angle, c.force, (0.0, 0.0))
        for m, specimen in enumerate(references.specimens)
        for c in references.conditions
    ]
    mechanics = [stroke.mechanics if mechanics_known else replace(stroke.mechanics, stiffness_n_m=None,
                 damping_ratio=None, friction=None) for stroke in strokes]  # fmt: skip
    config: FieldConfig = network.config
    x, prior, gate = (torch.tensor(array) for array in build_network_inputs(config, strokes, tokens, mechanics))
    with torch.no_grad():
        amplitude = network.compute_steady_amplitude(x, prior, gate)
        expected = Likelihood(config).compute_expected_power(
            amplitude, torch.tensor([stroke.speed for stroke in strokes])
        )
    return expected.numpy().astype(np.float64)[:, :FINE_BINS].reshape(references.spectra.shape)


def compute_distances_db(references: References, expected: Float) -> Float:
    """Compute the RMS distance (M, C) [dB] of predicted spectra (M, C, FINE_BINS) from the simulated ones."""
    return _compute_rms(10.0 * np.log10(expected / references.spectra), references.mask_counted_bins())


def compute_new_patch_distances_db(network: FieldNetwork, references: References) -> Float:
    """Compute per material the distance (M,) [dB] of a field from the simulation on patches not trained on.

    Averaged over conditions and patches; the field is given each patch's own token.
    """
    patches_db = [
        compute_distances_db(references, predict_spectra(network, references, references.tokens[:, patch]))
        for patch in range(references.tokens.shape[1])
    ]
    return np.asarray(np.mean(patches_db, axis=(0, 2)))


def _compute_rms(level: Float, inside: NDArray[np.bool_]) -> Float:
    """Return the RMS of `level` over the last axis, counting only elements where `inside` is True."""
    return np.asarray(np.sqrt(np.where(inside, np.square(level), 0.0).sum(axis=-1) / inside.sum(axis=-1)))


def save_references(path: Path, references: References) -> None:
    """Write the simulated spectra and tokens as safetensors, without specimens and conditions. Raises FileError."""
    tensors: dict[str, NDArray[Any]] = {
        "tokens": references.tokens,
        "spectra": references.spectra,
        "scatter_db": references.scatter_db,
    }
    write_bytes(path, dump_tensors(tensors))


def load_references(path: Path, specimens: Sequence[Specimen], conditions: Sequence[StrokeCondition]) -> References:
    """Read the simulated spectra of these materials and conditions. Raises FileError if the file does not fit."""
    try:
        tensors, _ = load_tensors(path.read_bytes())
        references = References(tuple(specimens), tuple(conditions), **tensors)
    except (OSError, ValueError, TypeError) as error:
        raise FileError(f"no references ({error}).", where=str(path), remedy="Delete it to simulate again.") from error
    if references.spectra.shape[:2] != (len(specimens), len(conditions)):
        raise FileError("references of other materials.", where=str(path), remedy="Delete it to simulate again.")
    return references


def select_materials(references: References, materials: Sequence[int]) -> References:
    """Return the simulated spectra of some materials, by index."""
    rows = list(materials)
    return replace(
        references,
        specimens=tuple(references.specimens[row] for row in rows),
        tokens=references.tokens[rows],
        spectra=references.spectra[rows],
        scatter_db=references.scatter_db[rows],
    )
