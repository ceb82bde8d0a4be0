"""Build hnf_core/data/library.json from hnf_core/simulation/material_classes.py and print its simulated statistics.

Usage: python tools/build_library.py [--check] [NAME …]    --check writes nothing; names restrict the table printed.
Exit code 1 where an entry breaks a MUST.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from hnf_core.files import write_text
from hnf_core.material.band_descriptor import describe
from hnf_core.material.token import ENCODER_ID
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.material_classes import (
    MATERIAL_TABLE,
    MaterialEntry,
    build_recipe,
    derive_seed,
)
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, height_map
from hnf_core.tactile.height import tactile_map_from_height
from hnf_lab.evaluation.texture_statistics import TextureStatistics, compute_texture_statistics
from hnf_lab.experiments.simulator import check_ranges

SCHEMA = 1
ENTRIES_PER_BATCH = 8
"""Entries per batch: ten strokes each."""
LIMITS = {"rms": (0.1, 30.0), "below_1k": (0.5, 1.0), "v_exponent": (0.4, 1.4), "f_exponent": (-0.1, 0.7)}
"""Limits of the statistics that every entry must meet (rms in m/s²)."""


def find_breaches(statistics: TextureStatistics) -> list[str]:
    """List the limits that the statistics exceed."""
    values = asdict(statistics)
    found = [f"{key} {values[key]:.2f}" for key, (low, high) in LIMITS.items() if not low <= values[key] <= high]
    low, high = LIMITS["rms"]
    found += [f"{key} {values[key]:.2f}" for key in ("rms_along", "rms_across") if not low <= values[key] <= high]
    return found


def measure_entries(entries: Sequence[MaterialEntry]) -> list[TextureStatistics]:
    """Simulate the pen on the entries' own height maps and compute the statistics."""
    surfaces = [
        (SmoothedMaps(height_map(build_recipe(entry), derive_seed(entry.name))), entry.mechanics) for entry in entries
    ]
    return compute_texture_statistics(surfaces, 2.0)


def make_record(entry: MaterialEntry) -> dict[str, Any]:
    """Make the record of an entry in library.json."""
    recipe, seed = build_recipe(entry), derive_seed(entry.name)
    pitch = TILE_SIZE_M / TILE_PIXELS
    token = describe(tactile_map_from_height(height_map(recipe, seed), None, pitch, 2.0 * pitch))
    if not token.known.all():
        raise SystemExit(f"{entry.name}: its own tile leaves parts of the token unknown.")
    return {
        "name": entry.name,
        "category": entry.category,
        "words": entry.words.split(),
        "appearance": asdict(entry.appearance),
        "mechanics": asdict(entry.mechanics),
        "recipe": recipe.to_dict(),
        "seed": seed,
        "token": [round(float(value), 5) for value in token.values],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("names", nargs="*", help="only these entries (implies --check)")
    arguments = parser.parse_args()
    chosen = [entry for entry in MATERIAL_TABLE if not arguments.names or entry.name in arguments.names]
    heads = f"{'RMS':>6}{'along':>7}{'across':>7}{'centr.':>7}{'<1k':>6}{'v exp':>7}{'F exp':>7}"
    print(f"{'name':18}{heads}  outside the recorded range")
    failed = 0
    batches = [chosen[low : low + ENTRIES_PER_BATCH] for low in range(0, len(chosen), ENTRIES_PER_BATCH)]
    for entry, statistics in (
        (entry, statistics)
        for batch in batches
        for entry, statistics in zip(batch, measure_entries(batch), strict=True)
    ):
        breaches = find_breaches(statistics)
        outside = [name for name, inside in check_ranges(statistics, entry.hatt).items() if not inside]
        failed += bool(breaches)
        print(
            f"{entry.name:18}{statistics.rms:6.2f}{statistics.rms_along:7.2f}{statistics.rms_across:7.2f}{statistics.centroid_hz:7.0f}"
            f"{statistics.below_1k:6.2f}{statistics.v_exponent:7.2f}{statistics.f_exponent:7.2f}  {', '.join(outside)}"
            + (f"  BROKEN: {', '.join(breaches)}" if breaches else ""),
            flush=True,
        )
    if failed:
        print(f"{failed} entries break a MUST; nothing written.", file=sys.stderr)
        return 1
    if not (arguments.check or arguments.names):
        library = {
            "schema": SCHEMA,
            "encoder": ENCODER_ID,
            "materials": [make_record(entry) for entry in MATERIAL_TABLE],
        }
        write_text(ROOT / "hnf_core" / "data" / "library.json", json.dumps(library, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
