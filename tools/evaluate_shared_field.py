"""Measure the shared field against its bars and print docs/shared-field.md.

Usage: python tools/evaluate_shared_field.py [--weights FILE] [--seed N] [--workers N] [--cache DIR] [--parts LIST]
       > docs/shared-field.md
Uses what tools/train_default_field.py left in the cache. --parts: of own,long,curve,direction,unseen; results of a part
stay in the cache as JSON, so that parts can be run one by one.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from hnf_core.field.config import FieldConfig  # noqa: E402
from hnf_core.field.weights import DEFAULT_WEIGHTS, load_field  # noqa: E402
from hnf_core.simulation.classes import get_category, list_classes  # noqa: E402
from hnf_core.training.conditions import make_middle_conditions, make_speed_grid  # noqa: E402
from hnf_core.training.gathering import Sizes, build_training_data, load_specimens, select_classes  # noqa: E402
from hnf_core.training.model import FieldNetwork  # noqa: E402
from hnf_core.training.recipe import (  # noqa: E402
    HELD_OUT,
    SHARED_CONFIG,
    TrainingPlan,
    fit_shared_field,
    load_or_build_training_data,
    load_or_simulate_references,
)
from hnf_core.training.references import compute_new_patch_distances_db, predict_spectra, select_materials  # noqa: E402
from hnf_core.training.shared_bars import (
    LONG_SCHEDULE,
    make_eight_directions,
    make_single_material_config,
    measure_directions,
    measure_single_material_field_db,
    measure_training_token_db,
    measure_unseen_materials,
)

SINGLE_HIDDEN = 64
SMALLER_HIDDEN = (8, 16, 32)
"""Smaller ones, tried on every OWN_EVERY-th material."""
MATERIAL_STRIDE = 12
LONG_STROKES = 1600
"""Of 0.3 s: 480 s of one material."""
LONG_HARDEST = 5
MATERIAL_COUNTS = (11, 43)
"""Materials; the shipped field is the last point."""
ANISOTROPIC_COUNT = 10
"""Materials asked for their directions: those that the linear contact of the token calls most anisotropic."""


class EvaluationContext:
    """What every part needs, loaded once."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.seed, self.cache, self.workers = arguments.seed, arguments.cache, arguments.workers
        library, self.plan = ROOT / "hnf_core" / "data" / "library.json", TrainingPlan()
        self.gathered = load_or_build_training_data(library, self.plan, self.seed, self.cache, self.workers)
        self.specimens = load_specimens(library, self.plan.sizes)
        self.references = load_or_simulate_references(
            self.specimens, make_middle_conditions(), self.seed, self.cache, self.workers
        )
        field = load_field(arguments.weights)
        self.weights = arguments.weights
        self.network = FieldNetwork(field.config, field.parameters)
        self.new_db = compute_new_patch_distances_db(self.network, self.references)


def measure_single_fields(context: EvaluationContext) -> dict[str, Any]:
    """Per-material fields of OWN_HIDDEN for all, smaller ones for some, and the shared field's distances."""
    count = len(context.specimens)
    some = list(range(3, count, MATERIAL_STRIDE))
    jobs = [(m, SINGLE_HIDDEN) for m in range(count)] + [(m, hidden) for hidden in SMALLER_HIDDEN for m in some]
    material = context.gathered.get_stroke_materials()
    alone = [context.gathered.select_strokes(material == m) for m in range(count)]
    calls = [(alone[m], context.references, m, hidden, context.seed) for m, hidden in jobs]
    with ProcessPoolExecutor(context.workers, mp_context=get_context("fork")) as pool:
        found = dict(zip(jobs, pool.map(measure_single_material_field_db, *zip(*calls, strict=True)), strict=True))
    distance = [found[m, SINGLE_HIDDEN] for m in range(count)]
    smaller = {str(hidden): [found[m, hidden] for m in some] for hidden in SMALLER_HIDDEN}
    seen = measure_training_token_db(context.network, context.references, context.gathered)
    return {
        "own": distance,
        "smaller": smaller,
        "some": some,
        "shared": context.new_db.tolist(),
        "seen": seen.tolist(),
        "bytes": {
            str(hidden): count_parameter_bytes(make_single_material_config(hidden))
            for hidden in (*SMALLER_HIDDEN, SINGLE_HIDDEN)
        },
    }


def measure_long_recordings(context: EvaluationContext) -> dict[str, Any]:
    """Per-material fields of some materials with as much data as one material may ever have: of every OWN_EVERY-th, and
    of those from which the shared field is farthest."""
    some = list(range(3, len(context.specimens), MATERIAL_STRIDE))
    some += [int(m) for m in np.argsort(-context.new_db) if m not in some][:LONG_HARDEST]
    sizes = Sizes(patches=2, described=0, strokes=LONG_STROKES // 2, middle_share=1.0, random=0)
    gathered = build_training_data([context.specimens[m] for m in some], sizes, context.seed + 10, context.workers)
    references = select_materials(context.references, some)
    material = gathered.get_stroke_materials()
    calls = [
        (gathered.select_strokes(material == row), references, row, SINGLE_HIDDEN, context.seed, LONG_SCHEDULE)
        for row in range(len(some))
    ]
    with ProcessPoolExecutor(context.workers, mp_context=get_context("fork")) as pool:
        distance = list(pool.map(measure_single_material_field_db, *zip(*calls, strict=True)))
    return {"some": some, "hard": LONG_HARDEST, "own": distance, "seconds": LONG_STROKES * sizes.seconds}


def measure_material_count(context: EvaluationContext) -> dict[str, Any]:
    """Fields for fewer materials, each with the surfaces of no material, and as many passes."""
    points = []
    for count in MATERIAL_COUNTS:
        chosen = np.arange(len(context.specimens)) * count // len(context.specimens)
        kept = [int(row) for row in np.unique(chosen, return_index=True)[1]]
        material = context.gathered.get_stroke_materials()
        network = fit_shared_field(
            context.gathered.select_strokes((material < 0) | np.isin(material, kept)),
            context.plan,
            SHARED_CONFIG,
            context.seed,
        )
        distance = compute_new_patch_distances_db(network, select_materials(context.references, kept))
        points.append({"materials": kept, "distance": distance.tolist()})
    return {"points": points}


def measure_direction(context: EvaluationContext) -> dict[str, Any]:
    """Eight directions of the most anisotropic materials."""
    speed = int(np.argmin(np.abs(make_speed_grid() - 0.1)))
    library = context.specimens[: len(list_classes())]
    conditions = make_eight_directions(speed, 1.0)
    tokens = context.gathered.tokens[
        [int(np.flatnonzero(context.gathered.material == m)[0]) for m in range(len(library))]
    ]
    blank = select_materials(context.references, range(len(library)))
    shape = np.zeros((len(library), len(conditions), blank.spectra.shape[-1]))
    asked = predict_spectra(context.network, replace(blank, conditions=tuple(conditions), spectra=shape), tokens)
    most = np.argsort(-np.ptp(np.log(asked.sum(axis=2)), axis=1))[:ANISOTROPIC_COUNT]
    chosen = [library[int(row)] for row in most]
    references = load_or_simulate_references(chosen, conditions, context.seed, context.cache, context.workers)
    expected = np.mean(
        [
            predict_spectra(context.network, references, references.tokens[:, k])
            for k in range(references.tokens.shape[1])
        ],
        axis=0,
    )
    return {"rows": [asdict(each) for each in measure_directions(references, expected)],
            "scatter": float(np.median(references.scatter_db))}  # fmt: skip


def measure_unseen_classes(context: EvaluationContext) -> dict[str, Any]:
    """A field trained without the held-out classes, asked about them."""
    kept = [name for name in list_classes() if name not in HELD_OUT]
    network = fit_shared_field(select_classes(context.gathered, kept), context.plan, SHARED_CONFIG, context.seed)
    categories = {name: get_category(name) for name in list_classes()}
    rows = measure_unseen_materials(network, context.references, HELD_OUT, categories)
    known = [m for m, each in enumerate(context.specimens) if each.class_name in kept]
    seen = compute_new_patch_distances_db(network, select_materials(context.references, known))
    return {"rows": [asdict(each) for each in rows], "seen": seen.tolist()}


SECTIONS: dict[str, Callable[[EvaluationContext], dict[str, Any]]] = {
    "own": measure_single_fields,
    "long": measure_long_recordings,
    "curve": measure_material_count,
    "direction": measure_direction,
    "unseen": measure_unseen_classes,
}


def count_parameter_bytes(config: FieldConfig) -> int:
    return 4 * sum(int(np.prod(shape)) for shape in config.shapes().values())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--weights", type=Path, default=DEFAULT_WEIGHTS)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cache", type=Path, default=ROOT / "build" / "shared-field")
    parser.add_argument("--parts", default=",".join(SECTIONS))
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # the processes forked later must not share a pool of threads
    bench = EvaluationContext(arguments)
    identity = load_field(arguments.weights).identity
    for part in filter(None, arguments.parts.split(",")):
        began = time.monotonic()
        found = {"weights": identity, **SECTIONS[part](bench)}
        (arguments.cache / f"{part}.json").write_text(json.dumps(found), encoding="utf-8")
        print(f"{part}: {time.monotonic() - began:.0f} s", file=sys.stderr)
    files = {part: arguments.cache / f"{part}.json" for part in SECTIONS}
    results = {part: json.loads(file.read_text(encoding="utf-8")) for part, file in files.items() if file.exists()}
    stale = [part for part in SECTIONS if results.get(part, {}).get("weights") != identity]
    if stale:
        print(f"not measured with these weights: {stale}; run these parts too.", file=sys.stderr)
        return 1
    print(make_page(bench, results))
    return 0


def make_page(context: EvaluationContext, results: dict[str, dict[str, Any]]) -> str:
    """docs/shared-field.md."""
    from shared_field_page import format_page

    return format_page(context, results, SINGLE_HIDDEN, count_parameter_bytes)


if __name__ == "__main__":
    sys.exit(main())
