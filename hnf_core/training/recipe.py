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
from ..field.field import Field, FieldConfig
from ..field.ranges import Ranges, ranges_of
from ..material import contact
from .conditions import Condition, middle_conditions, speed_grid
from .fit import Schedule, fit, training_set
from .gathering import Gathered, Sizes, gather, load_gathered, save_gathered, specimens_of
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
    """variants, elsewhere: of a stroke's input, by its own patch and by others of the material, see training_set."""

    sizes: Sizes = field(default_factory=Sizes)
    schedule: Schedule = field(default_factory=lambda: Schedule(epochs=50, batch=64, token_noise=0.15, ridge=1e-4))
    variants: int = 2
    elsewhere: int = 4


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
    network = fit_gathered(gathered, plan, config, seed)
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
        },
    )  # fmt: skip


def fit_gathered(gathered: Gathered, plan: Plan, config: FieldConfig, seed: int) -> FieldNetwork:
    """One field for all strokes gathered."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    elsewhere = [gathered.other_patches(rng) for _ in range(plan.elsewhere)]
    data = training_set(config, gathered.strokes, gathered.tokens, gathered.power, plan.variants, seed, elsewhere)
    return fit(config, data, plan.schedule, seed)


def gathered_for(library: Path, plan: Plan, seed: int, cache: Path, workers: int) -> Gathered:
    """Simulate, or read what an earlier run with the same simulator, library, sizes and seed has left in the cache."""
    path = cache / f"strokes-{_key(library.read_bytes(), plan.sizes, seed)}.safetensors"
    if path.exists():
        return load_gathered(path)
    gathered = gather(specimens_of(library, plan.sizes), plan.sizes, seed, workers)
    save_gathered(path, gathered)
    return gathered


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


def _key(content: bytes, sizes: object, seed: int) -> str:
    digest = blake2b(content, digest_size=8)
    digest.update(repr((sizes, seed)).encode())
    for source in (*sorted(Path(simulation_room.__path__[0]).glob("*.py")), Path(contact.__file__)):
        digest.update(source.read_bytes())
    return digest.hexdigest()
