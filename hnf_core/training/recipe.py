"""How the shipped weights come about: simulated strokes on many materials, fitted by likelihood, held to long runs."""

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

from .. import simulation as simulation_room
from ..action.smooth import steady_action
from ..datasets.tactile_pairs import UNSEEN_CLASSES
from ..field.config import FieldConfig
from ..field.field import Field
from ..field.ranges import Ranges, ranges_of
from ..files import write_atomically
from ..material import contact
from ..material.encoders import encoder_by_name
from ..material.token import ENCODER_ID
from .conditions import Condition, middle_conditions, speed_grid
from .fit import Schedule, fit, training_set
from .gathering import Gathered, Sizes, gather, load_gathered, save_gathered, specimens_of, tokens_by
from .model import FieldNetwork
from .references import (
    References,
    load_references,
    on_new_patches_db,
    refer,
    save_references,
)
from .shared_bars import only_classes, only_materials
from .surfaces import Specimen

Float = NDArray[np.float64]

LICENCE = "GPL-3.0-or-later"
SHARED = FieldConfig(hidden=256, line_gains=True, stroke_frame=True)


@dataclass(frozen=True)
class Plan:
    """variants, elsewhere: of a stroke's input, by its own patch and by others of the material, see training_set.
    encoders: further makes of E (names or files) whose tokens of those other patches the field learns as well."""

    sizes: Sizes = field(default_factory=Sizes)
    schedule: Schedule = field(default_factory=lambda: Schedule(epochs=50, batch=64, token_noise=0.15, ridge=1e-4))
    variants: int = 2
    elsewhere: int = 4
    encoders: tuple[str, ...] = ()


HELD_OUT = UNSEEN_CLASSES
"""The last class of every category in the table: what a field is asked about that was trained without them."""


def train(
    library: Path,
    plan: Plan,
    config: FieldConfig,
    seed: int,
    cache: Path,
    workers: int = 2,
    held_out: Sequence[str] = (),
) -> Field:
    """The whole recipe. Deterministic: the same seed gives the same weights on the same machine and torch.

    cache: folder where simulated strokes are kept for the next run. held_out: classes to leave out; the field names
    them in its metadata.
    """
    began = time.monotonic()
    gathered = gathered_for(library, plan, seed, cache, workers)
    specimens = specimens_of(library, plan.sizes)
    references = references_for(specimens, middle_conditions(), seed, cache, workers)
    known = [row for row, each in enumerate(specimens) if each.class_name not in held_out]
    if held_out:
        gathered = only_classes(gathered, [specimens[row].class_name for row in known])
        references = only_materials(references, known)
    print(f"simulated after {time.monotonic() - began:.0f} s", file=sys.stderr)
    tokens = [tokens_for(each, specimens, plan, seed, cache, workers) for each in plan.encoders]
    network = fit_gathered(gathered, plan, config, seed, tokens)
    print(f"trained after {time.monotonic() - began:.0f} s", file=sys.stderr)
    field = described(network, gathered, references, [specimens[row] for row in known], plan, seed)
    return replace(field, metadata={**field.metadata, "held_out": json.dumps(held_out)}) if held_out else field


def described(
    network: FieldNetwork,
    gathered: Gathered,
    references: References,
    specimens: Sequence[Specimen],
    plan: Plan,
    seed: int,
) -> Field:
    """The field with what it was trained on (specimens, a row of references each), where that lay, and how far it is
    from the references."""
    distance = on_new_patches_db(network, references)
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
        network.config, network.parameters_numpy(), ranges_of_gathered(gathered, sizes.seconds),
        {
            "training_data": f"contact simulator of this project: {len(specimens)} materials of "
            f"{len({each.class_name for each in specimens})} classes x {sizes.patches} patches, {sizes.random} random "
            f"and fused surfaces, {len(gathered.strokes)} steady strokes of {sizes.seconds:g} s, pen and finger; no "
            "recorded data",
            "seed": str(seed),
            "metrics": metrics,
            "licence": LICENCE,
            "encoder": json.dumps(list(dict.fromkeys((ENCODER_ID, *map(_make_of, plan.encoders))))),
        },
    )  # fmt: skip


def fit_gathered(
    gathered: Gathered, plan: Plan, config: FieldConfig, seed: int, others: Sequence[NDArray[np.float32]] = ()
) -> FieldNetwork:
    """One field for all strokes gathered. others: what further makes of E say of the same surfaces, (surfaces,
    TOKEN_DIM) each; every one adds as many variants of every stroke as the library's make has elsewhere."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    elsewhere = [gathered.other_patches(rng) for _ in range(plan.elsewhere)]
    for make in range(1, len(others) + 1):
        first = make * len(gathered.tokens)
        elsewhere += [[first + row for row in gathered.other_patches(rng)] for _ in range(plan.elsewhere)]
    tokens = np.concatenate([gathered.tokens, *others])
    data = training_set(config, gathered.strokes, tokens, gathered.power, plan.variants, seed, elsewhere)
    return fit(config, data, plan.schedule, seed)


def gathered_for(library: Path, plan: Plan, seed: int, cache: Path, workers: int) -> Gathered:
    """Simulate, or read what an earlier run with the same simulator, library, sizes and seed has left in the cache."""
    path = cache / f"strokes-{_key(library.read_bytes(), plan.sizes, seed)}.safetensors"
    if path.exists():
        return load_gathered(path)
    gathered = gather(specimens_of(library, plan.sizes), plan.sizes, seed, workers)
    save_gathered(path, gathered)
    return gathered


def tokens_for(
    encoder: str, specimens: Sequence[Specimen], plan: Plan, seed: int, cache: Path, workers: int
) -> NDArray[np.float32]:
    """(surfaces, TOKEN_DIM) by another make of E, likewise kept in the cache."""
    make = encoder_by_name(encoder).content_id
    path = cache / f"tokens-{_key(make.encode(), (list(specimens), plan.sizes), seed)}.npy"
    if path.exists():
        return np.asarray(np.load(path, allow_pickle=False), dtype=np.float32)
    tokens = tokens_by(encoder, specimens, plan.sizes, seed, workers)
    write_atomically(path, lambda temporary: np.save(temporary, tokens))
    return tokens


def references_for(
    specimens: Sequence[Specimen], conditions: Sequence[Condition], seed: int, cache: Path, workers: int
) -> References:
    """Long runs, likewise kept in the cache."""
    path = cache / f"references-{_key(b'', (list(specimens), list(conditions)), seed)}.safetensors"
    if path.exists():
        return load_references(path, specimens, conditions)
    references = refer(specimens, conditions, seed, workers)
    save_references(path, references)
    return references


def ranges_of_gathered(gathered: Gathered, seconds: float) -> Ranges:
    """Where the strokes lay, in the terms of field.ranges."""
    speeds = speed_grid()
    actions = [
        steady_action(seconds, float(speeds[s.speed]), s.force, s.angle, s.probe)
        for s in gathered.strokes
    ]  # fmt: skip
    return ranges_of(actions, gathered.tokens, [s.mechanics for s in gathered.strokes], withheld=True)


def _make_of(encoder: str) -> str:
    return encoder_by_name(encoder).name


def _key(content: bytes, sizes: object, seed: int) -> str:
    digest = blake2b(content, digest_size=8)
    digest.update(repr((sizes, seed)).encode())
    for source in (*sorted(Path(simulation_room.__path__[0]).glob("*.py")), Path(contact.__file__)):
        digest.update(source.read_bytes())
    return digest.hexdigest()
