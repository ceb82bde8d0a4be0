"""Train the shared field, whose weights are shipped, on simulated strokes over many materials, and evaluate it."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from hnf_core import simulation as simulation_room
from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.datasets.tactile_pairs import UNSEEN_CLASSES
from hnf_core.field.field import Field, FieldConfig
from hnf_core.field.training_ranges import TrainingRanges, compute_training_ranges
from hnf_core.files import write_atomically
from hnf_core.material import contact_model
from hnf_core.material.encoder_registry import get_encoder
from hnf_core.material.token import ENCODER_ID
from hnf_core.training.model import FieldNetwork
from hnf_lab.shared_field.references import (
    References,
    compute_new_patch_distances_db,
    load_references,
    save_references,
    select_materials,
    simulate_references,
)
from hnf_lab.shared_field.simulated_strokes import Specimen, StrokeCondition, make_middle_conditions, make_speed_grid
from hnf_lab.shared_field.training_data import (
    Sizes,
    TrainingData,
    build_training_data,
    encode_surfaces,
    load_specimens,
    load_training_data,
    save_training_data,
    select_classes,
)

from .fit import Schedule, build_training_set, fit_network

Float = NDArray[np.float64]

LICENCE = "GPL-3.0-or-later"
SHARED_CONFIG = FieldConfig(hidden=256, line_gains=True, stroke_frame=True, force_noise=True)


@dataclass(frozen=True)
class TrainingPlan:
    """Amount of data and hyperparameters for training a shared field.

    Attributes
    ----------
    sizes, schedule
        Amounts of data, and hyperparameters.
    variants
        Number of network inputs per stroke with its own token but different mechanics withheld, see build_training_set.
    alternative_patches
        Number of network inputs per stroke with the token of another patch of the same material.
    encoders
        Further encoders (image to token; names or files): the field is also trained on the tokens they give for those
        other patches.
    """

    sizes: Sizes = field(default_factory=Sizes)
    schedule: Schedule = field(default_factory=lambda: Schedule(epochs=50, batch=64, token_noise=0.15, ridge=1e-4))
    variants: int = 2
    alternative_patches: int = 4
    encoders: tuple[str, ...] = ()


HELD_OUT = UNSEEN_CLASSES
"""Classes for evaluating a field that was trained without them: the last of every category in the table."""


def train_shared_field(
    library: Path,
    plan: TrainingPlan,
    config: FieldConfig,
    seed: int,
    cache: Path,
    workers: int = 2,
    held_out: Sequence[str] = (),
) -> Field:
    """Simulate, train and evaluate a shared field.

    The same seed gives the same weights on the same machine with the same torch.

    Parameters
    ----------
    library
        File of the library's materials.
    plan
        Amounts and hyperparameters.
    config
        Architecture.
    seed
        Seed of data and training.
    cache
        Folder that stores simulated strokes for the next run.
    workers
        Number of processes.
    held_out
        Material classes to leave out; the field's metadata names them.

    Returns
    -------
    Field
        With metadata, training ranges and metrics.
    """
    began = time.monotonic()
    gathered = load_or_build_training_data(library, plan, seed, cache, workers)
    specimens = load_specimens(library, plan.sizes)
    references = load_or_simulate_references(specimens, make_middle_conditions(), seed, cache, workers)
    known = [row for row, each in enumerate(specimens) if each.class_name not in held_out]
    if held_out:
        gathered = select_classes(gathered, [specimens[row].class_name for row in known])
        references = select_materials(references, known)
    print(f"simulated after {time.monotonic() - began:.0f} s", file=sys.stderr)
    tokens = [load_or_encode_tokens(each, specimens, plan, seed, cache, workers) for each in plan.encoders]
    network = fit_shared_field(gathered, plan, config, seed, tokens)
    print(f"trained after {time.monotonic() - began:.0f} s", file=sys.stderr)
    field = describe_field(network, gathered, references, [specimens[row] for row in known], plan, seed)
    return replace(field, metadata={**field.metadata, "held_out": json.dumps(held_out)}) if held_out else field


def describe_field(
    network: FieldNetwork,
    data: TrainingData,
    references: References,
    specimens: Sequence[Specimen],
    plan: TrainingPlan,
    seed: int,
) -> Field:
    """Build the field of a trained network, with metadata, training ranges and its distance from the simulation.

    references: long simulations to compare with, one row per material (specimen).
    """
    distance = compute_new_patch_distances_db(network, references)
    metrics = (
        f"average spectrum, {len(distance)} materials x {len(references.conditions)} conditions, tokens of patches not "
        f"trained on, against long runs of the simulator: median {np.median(distance):.2f} dB, "
        f"90 % below {np.percentile(distance, 90):.2f} dB, worst {distance.max():.2f} dB "
        f"({specimens[int(np.argmax(distance))].name}); the references themselves scatter by "
        f"{float(np.median(references.scatter_db)):.2f} dB"
    )
    print(metrics, file=sys.stderr)
    sizes = plan.sizes
    return Field(
        network.config, network.to_numpy_parameters(), collect_training_ranges(data, sizes.seconds),
        {
            "training_data": f"contact simulator of this project: {len(specimens)} materials of "
            f"{len({specimen.class_name for specimen in specimens})} classes x {sizes.patches} patches, "
            f"{sizes.random} random and fused surfaces, {len(data.strokes)} steady strokes of "
            f"{sizes.seconds:g} s, pen and finger; no recorded data",
            "seed": str(seed),
            "metrics": metrics,
            "licence": LICENCE,
            "encoder": json.dumps(list(dict.fromkeys((ENCODER_ID, *map(_find_encoder_name, plan.encoders))))),
        },
    )  # fmt: skip


def fit_shared_field(
    training_data: TrainingData,
    plan: TrainingPlan,
    config: FieldConfig,
    seed: int,
    extra_tokens: Sequence[NDArray[np.float32]] = (),
) -> FieldNetwork:
    """Fit one field to all strokes.

    Parameters
    ----------
    training_data
        Simulated strokes and their spectra.
    plan
        Variants and hyperparameters.
    config
        Architecture.
    seed
        Seed of the training.
    extra_tokens
        Tokens (surfaces, TOKEN_DIM) of the same surfaces by further encoders; each adds alternative_patches variants of
        every stroke.

    Returns
    -------
    FieldNetwork
        The trained network.
    """
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    alternatives = [training_data.draw_alternative_patches(rng) for _ in range(plan.alternative_patches)]
    for encoder in range(1, len(extra_tokens) + 1):
        first = encoder * len(training_data.tokens)
        alternatives += [
            [first + row for row in training_data.draw_alternative_patches(rng)]
            for _ in range(plan.alternative_patches)
        ]
    tokens = np.concatenate([training_data.tokens, *extra_tokens])
    data = build_training_set(
        config, training_data.strokes, tokens, training_data.power, plan.variants, seed, alternatives
    )
    return fit_network(config, data, plan.schedule, seed)


def load_or_build_training_data(
    library: Path, plan: TrainingPlan, seed: int, cache: Path, workers: int
) -> TrainingData:
    """Read the training data from the cache, or simulate and store it.

    The cache is used only for the same simulator code, library, sizes and seed.
    """
    path = cache / f"strokes-{_compute_cache_key(library.read_bytes(), plan.sizes, seed)}.safetensors"
    if path.exists():
        return load_training_data(path)
    data = build_training_data(load_specimens(library, plan.sizes), plan.sizes, seed, workers)
    save_training_data(path, data)
    return data


def load_or_encode_tokens(
    encoder: str, specimens: Sequence[Specimen], plan: TrainingPlan, seed: int, cache: Path, workers: int
) -> NDArray[np.float32]:
    """Return tokens (surfaces, TOKEN_DIM) by another encoder, from the cache if possible."""
    content_id = get_encoder(encoder).content_id
    path = cache / f"tokens-{_compute_cache_key(content_id.encode(), (list(specimens), plan.sizes), seed)}.npy"
    if path.exists():
        return np.asarray(np.load(path, allow_pickle=False), dtype=np.float32)
    tokens = encode_surfaces(encoder, specimens, plan.sizes, seed, workers)
    write_atomically(path, lambda temporary: np.save(temporary, tokens))
    return tokens


def load_or_simulate_references(
    specimens: Sequence[Specimen], conditions: Sequence[StrokeCondition], seed: int, cache: Path, workers: int
) -> References:
    """Return the long simulations that a field is compared with, from the cache if possible."""
    path = cache / f"references-{_compute_cache_key(b'', (list(specimens), list(conditions)), seed)}.safetensors"
    if path.exists():
        return load_references(path, specimens, conditions)
    references = simulate_references(specimens, conditions, seed, workers)
    save_references(path, references)
    return references


def collect_training_ranges(data: TrainingData, seconds: float) -> TrainingRanges:
    """Return the ranges of speed, force, direction, token and mechanics that the strokes cover.

    seconds: duration of a stroke.
    """
    speeds = make_speed_grid()
    actions = [
        make_steady_action(seconds, float(speeds[s.speed]), s.force, s.angle, s.probe)
        for s in data.strokes
    ]  # fmt: skip
    return compute_training_ranges(actions, data.tokens, [s.mechanics for s in data.strokes], withheld=True)


def _find_encoder_name(encoder: str) -> str:
    return get_encoder(encoder).name


def _compute_cache_key(content: bytes, sizes: object, seed: int) -> str:
    """Return a hash of content, sizes, seed and the simulator's source code."""
    digest = blake2b(content, digest_size=8)
    digest.update(repr((sizes, seed)).encode())
    for source in (*sorted(Path(simulation_room.__path__[0]).glob("*.py")), Path(contact_model.__file__)):
        digest.update(source.read_bytes())
    return digest.hexdigest()
