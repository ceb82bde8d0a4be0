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
from hnf_core.simulation.classes import category_of, classes  # noqa: E402
from hnf_core.training.conditions import middle_conditions, speed_grid  # noqa: E402
from hnf_core.training.gathering import Sizes, gather, specimens_of  # noqa: E402
from hnf_core.training.model import FieldNetwork  # noqa: E402
from hnf_core.training.recipe import (  # noqa: E402
    HELD_OUT,
    SHARED,
    Plan,
    fit_gathered,
    gathered_for,
    references_for,
)
from hnf_core.training.references import expected_at, on_new_patches_db  # noqa: E402
from hnf_core.training.shared_bars import (  # noqa: E402
    LONG_SCHEDULE,
    directions_of,
    eight_directions,
    only_classes,
    only_materials,
    own_config,
    own_field_db,
    unseen_materials,
    with_training_tokens_db,
)

OWN_HIDDEN = 64
OWN_SIZES = (8, 16, 32)
"""Smaller ones, tried on every OWN_EVERY-th material."""
OWN_EVERY = 12
LONG_STROKES = 1600
"""Of 0.3 s: 480 s of one material."""
LONG_HARD = 5
CURVE = (11, 43)
"""Materials; the shipped field is the last point."""
DIRECTED = 10
"""Materials asked for their directions: those that the linear contact of the token calls most anisotropic."""


class Bench:
    """What every part needs, loaded once."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.seed, self.cache, self.workers = arguments.seed, arguments.cache, arguments.workers
        library, self.plan = ROOT / "hnf_core" / "data" / "library.json", Plan()
        self.gathered = gathered_for(library, self.plan, self.seed, self.cache, self.workers)
        self.specimens = specimens_of(library, self.plan.sizes)
        self.references = references_for(self.specimens, middle_conditions(), self.seed, self.cache, self.workers)
        field = load_field(arguments.weights)
        self.weights = arguments.weights
        self.network = FieldNetwork(field.config, field.parameters)
        self.new_db = on_new_patches_db(self.network, self.references)


def own(bench: Bench) -> dict[str, Any]:
    """Per-material fields of OWN_HIDDEN for all, smaller ones for some, and the shared field's distances."""
    count = len(bench.specimens)
    some = list(range(3, count, OWN_EVERY))
    jobs = [(m, OWN_HIDDEN) for m in range(count)] + [(m, hidden) for hidden in OWN_SIZES for m in some]
    material = bench.gathered.material_of_strokes()
    alone = [bench.gathered.only(material == m) for m in range(count)]
    calls = [(alone[m], bench.references, m, hidden, bench.seed) for m, hidden in jobs]
    with ProcessPoolExecutor(bench.workers, mp_context=get_context("fork")) as pool:
        found = dict(zip(jobs, pool.map(own_field_db, *zip(*calls, strict=True)), strict=True))
    distance = [found[m, OWN_HIDDEN] for m in range(count)]
    smaller = {str(hidden): [found[m, hidden] for m in some] for hidden in OWN_SIZES}
    seen = with_training_tokens_db(bench.network, bench.references, bench.gathered)
    return {
        "own": distance,
        "smaller": smaller,
        "some": some,
        "shared": bench.new_db.tolist(),
        "seen": seen.tolist(),
        "bytes": {str(hidden): parameter_bytes(own_config(hidden)) for hidden in (*OWN_SIZES, OWN_HIDDEN)},
    }


def long(bench: Bench) -> dict[str, Any]:
    """Per-material fields of some materials with as much data as one material may ever have: of every OWN_EVERY-th, and
    of those from which the shared field is farthest."""
    some = list(range(3, len(bench.specimens), OWN_EVERY))
    some += [int(m) for m in np.argsort(-bench.new_db) if m not in some][:LONG_HARD]
    sizes = Sizes(patches=2, described=0, strokes=LONG_STROKES // 2, middle_share=1.0, random=0)
    gathered = gather([bench.specimens[m] for m in some], sizes, bench.seed + 10, bench.workers)
    references = only_materials(bench.references, some)
    material = gathered.material_of_strokes()
    calls = [
        (gathered.only(material == row), references, row, OWN_HIDDEN, bench.seed, LONG_SCHEDULE)
        for row in range(len(some))
    ]
    with ProcessPoolExecutor(bench.workers, mp_context=get_context("fork")) as pool:
        distance = list(pool.map(own_field_db, *zip(*calls, strict=True)))
    return {"some": some, "hard": LONG_HARD, "own": distance, "seconds": LONG_STROKES * sizes.seconds}


def curve(bench: Bench) -> dict[str, Any]:
    """Fields for fewer materials, each with the surfaces of no material, and as many passes."""
    points = []
    for count in CURVE:
        chosen = np.arange(len(bench.specimens)) * count // len(bench.specimens)
        kept = [int(row) for row in np.unique(chosen, return_index=True)[1]]
        material = bench.gathered.material_of_strokes()
        network = fit_gathered(
            bench.gathered.only((material < 0) | np.isin(material, kept)), bench.plan, SHARED, bench.seed
        )
        distance = on_new_patches_db(network, only_materials(bench.references, kept))
        points.append({"materials": kept, "distance": distance.tolist()})
    return {"points": points}


def direction(bench: Bench) -> dict[str, Any]:
    """Eight directions of the most anisotropic materials."""
    speed = int(np.argmin(np.abs(speed_grid() - 0.1)))
    library = bench.specimens[: len(classes())]
    conditions = eight_directions(speed, 1.0)
    tokens = bench.gathered.tokens[[int(np.flatnonzero(bench.gathered.material == m)[0]) for m in range(len(library))]]
    blank = only_materials(bench.references, range(len(library)))
    shape = np.zeros((len(library), len(conditions), blank.spectra.shape[-1]))
    asked = expected_at(bench.network, replace(blank, conditions=tuple(conditions), spectra=shape), tokens)
    most = np.argsort(-np.ptp(np.log(asked.sum(axis=2)), axis=1))[:DIRECTED]
    chosen = [library[int(row)] for row in most]
    references = references_for(chosen, conditions, bench.seed, bench.cache, bench.workers)
    expected = np.mean(
        [expected_at(bench.network, references, references.tokens[:, k]) for k in range(references.tokens.shape[1])],
        axis=0,
    )
    return {"rows": [asdict(each) for each in directions_of(references, expected)],
            "scatter": float(np.median(references.scatter_db))}  # fmt: skip


def unseen(bench: Bench) -> dict[str, Any]:
    """A field trained without the held-out classes, asked about them."""
    kept = [name for name in classes() if name not in HELD_OUT]
    network = fit_gathered(only_classes(bench.gathered, kept), bench.plan, SHARED, bench.seed)
    categories = {name: category_of(name) for name in classes()}
    rows = unseen_materials(network, bench.references, HELD_OUT, categories)
    known = [m for m, each in enumerate(bench.specimens) if each.class_name in kept]
    seen = on_new_patches_db(network, only_materials(bench.references, known))
    return {"rows": [asdict(each) for each in rows], "seen": seen.tolist()}


PARTS: dict[str, Callable[[Bench], dict[str, Any]]] = {
    "own": own,
    "long": long,
    "curve": curve,
    "direction": direction,
    "unseen": unseen,
}


def parameter_bytes(config: FieldConfig) -> int:
    return 4 * sum(int(np.prod(shape)) for shape in config.shapes().values())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--weights", type=Path, default=DEFAULT_WEIGHTS)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cache", type=Path, default=ROOT / "build" / "shared-field")
    parser.add_argument("--parts", default=",".join(PARTS))
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # the processes forked later must not share a pool of threads
    bench = Bench(arguments)
    identity = load_field(arguments.weights).identity
    for part in filter(None, arguments.parts.split(",")):
        began = time.monotonic()
        found = {"weights": identity, **PARTS[part](bench)}
        (arguments.cache / f"{part}.json").write_text(json.dumps(found), encoding="utf-8")
        print(f"{part}: {time.monotonic() - began:.0f} s", file=sys.stderr)
    files = {part: arguments.cache / f"{part}.json" for part in PARTS}
    results = {part: json.loads(file.read_text(encoding="utf-8")) for part, file in files.items() if file.exists()}
    stale = [part for part in PARTS if results.get(part, {}).get("weights") != identity]
    if stale:
        print(f"not measured with these weights: {stale}; run these parts too.", file=sys.stderr)
        return 1
    print(page(bench, results))
    return 0


def page(bench: Bench, results: dict[str, dict[str, Any]]) -> str:
    """docs/shared-field.md."""
    from shared_field_page import write_page

    return write_page(bench, results, OWN_HIDDEN, parameter_bytes)


if __name__ == "__main__":
    sys.exit(main())
