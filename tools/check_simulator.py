"""Hold the contact simulator against recorded textures; measure its ablations and its speed. Prints Markdown.

Usage: python tools/check_simulator.py [--instances N] [--first-seed S] [--only CATEGORY …] [--classes] [--speed]
       [--write]

--write puts what was measured into docs/simulator.md, between its markers; --classes shows every class as well.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from recorded_ranges import HATT_RANGES, check_ranges, compute_instrument_noise  # noqa: E402
from simulator_ablations import measure_ablations as ablations  # noqa: E402

from hnf_core.files import write_text  # noqa: E402
from hnf_core.simulation.classes import get_recorded_category, list_classes, sample_instance  # noqa: E402
from hnf_core.simulation.feel import TextureStatistics, aggregate_strokes, simulate_strokes  # noqa: E402
from hnf_core.simulation.sampling import SmoothedMaps  # noqa: E402
from hnf_core.simulation.simulate import simulate_batch, straight_stroke  # noqa: E402
from hnf_core.simulation.surface import height_map  # noqa: E402

FIRST_SEED = 1000
"""Constants were chosen on seeds below it."""
INSTANCES_PER_BATCH = 12
"""Instances per batch: ten strokes each."""
Instance = tuple[str, int]
TABLE_HEADER = (
    "category", "classes", "instances", "RMS median (recorded)", "dB", "centroid median (recorded)", "%",
    "RMS in", "centroid in", "< 1 kHz in", "v exp in", "F exp in", "all numbers", "all five at once",
)  # fmt: skip


def measure_instances(instances: Sequence[Instance]) -> list[tuple[TextureStatistics, TextureStatistics]]:
    """The five numbers of some instances, as the instrument would record them and of the contact alone: one process's
    share of the work."""
    surfaces = []
    for name, seed in instances:
        recipe, mechanics = sample_instance(name, seed)
        surfaces.append((SmoothedMaps(height_map(recipe, seed)), mechanics))
    power, frequency = simulate_strokes(surfaces)
    return [
        (aggregate_strokes(each, frequency, compute_instrument_noise), aggregate_strokes(each, frequency))
        for each in power
    ]


def measure_in_parallel(
    instances: Sequence[Instance], workers: int
) -> list[tuple[TextureStatistics, TextureStatistics]]:
    parts = [instances[low : low + INSTANCES_PER_BATCH] for low in range(0, len(instances), INSTANCES_PER_BATCH)]
    with ProcessPoolExecutor(workers, mp_context=get_context("fork")) as pool:
        return [each for part in pool.map(measure_instances, parts) for each in part]


def format_percent(values: Sequence[bool]) -> str:
    return f"{100.0 * np.mean(values):.0f} %" if len(values) else "–"


def make_row(
    label: str, names: int, statistics: Sequence[TextureStatistics], inside: Sequence[dict[str, bool]], median: bool
) -> list[str]:
    """One line of the table. Without `median` the middle columns stay empty."""
    middle = ["", "", "", ""]
    if median:
        recorded = HATT_RANGES[label]
        rms = float(np.median([each.rms for each in statistics]))
        centroid = float(np.median([each.centroid_hz for each in statistics]))
        middle = [
            f"{rms:.2f} ({recorded.rms_median:.2f})",
            f"{20.0 * np.log10(rms / recorded.rms_median):+.1f}",
            f"{centroid:.0f} ({recorded.centroid_median})",
            f"{100.0 * (centroid / recorded.centroid_median - 1.0):+.0f}",
        ]
    shares = [
        format_percent([each[name] for each in inside if name in each])
        for name in ("rms", "centroid_hz", "below_1k", "v_exponent", "f_exponent")
    ]
    pooled = format_percent([value for each in inside for value in each.values()])
    return [
        label,
        str(names),
        str(len(statistics)),
        *middle,
        *shares,
        pooled,
        format_percent([all(e.values()) for e in inside]),
    ]


def format_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def make_range_tables(instances: int, first_seed: int, only: Sequence[str], by_class: bool, workers: int) -> list[str]:
    """Instances of every recorded class against the ranges of its category: with the recording instrument, without."""
    names = [n for n in list_classes() if get_recorded_category(n) and (not only or get_recorded_category(n) in only)]
    pieces = [(name, first_seed + k) for name in names for k in range(instances)]
    tables = []
    for felts in zip(*measure_in_parallel(pieces, workers), strict=True):
        inside = [
            check_ranges(each, get_recorded_category(name)) for each, (name, _) in zip(felts, pieces, strict=True)
        ]
        if by_class:
            print_classes(names, pieces, felts, inside)
        rows = []
        for category in HATT_RANGES:
            chosen = [k for k, (name, _) in enumerate(pieces) if get_recorded_category(name) == category]
            if chosen:
                count = len({pieces[k][0] for k in chosen})
                rows.append(make_row(category, count, [felts[k] for k in chosen], [inside[k] for k in chosen], True))
        rows.append(make_row("all", len(names), felts, inside, False))
        tables.append(format_table(TABLE_HEADER, rows))
    return tables


def print_classes(
    names: Sequence[str],
    instances: Sequence[Instance],
    statistics: Sequence[TextureStatistics],
    inside: Sequence[dict[str, bool]],
) -> None:
    for name in names:
        chosen = [k for k, (other, _) in enumerate(instances) if other == name]
        numbers = np.array([[f.rms, f.centroid_hz, f.below_1k, f.v_exponent, f.f_exponent] for f in statistics])[chosen]
        spread = "  ".join(f"{np.median(column):7.3f} [{column.min():.3f} {column.max():.3f}]" for column in numbers.T)
        misses = {key: sum(not inside[k][key] for k in chosen) for key in inside[chosen[0]]}
        print(f"{name:18}{spread}  {({key: n for key, n in misses.items() if n}) or ''}", flush=True)


SPEED_ROWS, SPEED_SECONDS = 192, 1.0


def time_batch(worker: int) -> tuple[float, float]:
    """Wall and CPU seconds of one batch: sixteen surfaces, twelve strokes each, sampling of the maps included."""
    surfaces = []
    for name in list_classes()[worker::2][:16]:
        recipe, mechanics = sample_instance(name, 0)
        surfaces.append((SmoothedMaps(height_map(recipe, 0)), mechanics))
    each = SPEED_ROWS // len(surfaces)
    rows = [(maps, mechanics, k) for maps, mechanics in surfaces for k in range(each)]
    strokes = [straight_stroke(0.02 * (1 + k), 1.0, SPEED_SECONDS, angle_rad=0.5 * k) for _, _, k in rows]
    wall, cpu = time.perf_counter(), time.process_time()
    simulate_batch([maps for maps, _, _ in rows], strokes, [mechanics for _, mechanics, _ in rows])
    return time.perf_counter() - wall, time.process_time() - cpu


def make_speed_table() -> str:
    """Seconds of signal per second, two processes side by side."""
    load = os.getloadavg()[0]
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        walls, cpus = zip(*pool.map(time_batch, range(2)), strict=True)
    signal = 2 * SPEED_ROWS * SPEED_SECONDS
    rows = [
        [f"wall clock, two processes, load {load:.1f} before on {os.cpu_count()} cores", f"{signal / max(walls):.0f}×"],
        ["CPU time, per core", f"{signal / sum(cpus):.0f}×"],
    ]
    return format_table(["measured by", f"real time ({2 * SPEED_ROWS} strokes of {SPEED_SECONDS:g} s)"], rows)


def fill_markers(document: Path, tables: dict[str, str]) -> None:
    """Put each table between its markers <!-- name --> … <!-- /name -->."""
    text = document.read_text(encoding="utf-8")
    for name, table in tables.items():
        start, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        if start not in text or end not in text:
            raise SystemExit(f"{document}: the markers {start} and {end} are missing; put them back.")
        text = re.sub(f"{start}.*?{end}", lambda _, a=start, b=end, c=table: f"{a}\n{c}\n{b}", text, flags=re.DOTALL)
    write_text(document, text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--instances", type=int, default=8, help="per class")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--only", nargs="*", default=[], help="categories")
    parser.add_argument("--classes", action="store_true", help="every class as well")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--speed", action="store_true", help="nothing but the speed")
    parser.add_argument("--write", action="store_true", help="into docs/simulator.md")
    a = parser.parse_args()
    tables = {"speed": make_speed_table()} if a.speed else make_all_tables(a)
    print("\n\n".join(tables.values()))
    if a.write:
        fill_markers(ROOT / "docs" / "simulator.md", tables)
    return 0


def make_all_tables(a: argparse.Namespace) -> dict[str, str]:
    recorded, alone = make_range_tables(a.instances, a.first_seed, a.only, a.classes, a.workers)
    seeds = f"{a.instances} instances per class, seeds {a.first_seed}–{a.first_seed + a.instances - 1}."
    tables = {"recorded": f"{seeds}\n\n{recorded}", "alone": alone}
    if not a.only:
        tables["ablations"] = format_table(["part", "statistic", "measured", "what the model says"], ablations())
        tables["speed"] = make_speed_table()
    return tables


if __name__ == "__main__":
    sys.exit(main())
