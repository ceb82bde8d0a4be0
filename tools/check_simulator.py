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

from recorded_ranges import RECORDED, instrument, within  # noqa: E402
from simulator_ablations import rows as ablations  # noqa: E402

from hnf_core.files import write_text  # noqa: E402
from hnf_core.simulation.classes import classes, instance, recorded_category_of  # noqa: E402
from hnf_core.simulation.feel import Feel, stroked, summed  # noqa: E402
from hnf_core.simulation.sampling import SmoothedMaps  # noqa: E402
from hnf_core.simulation.simulate import simulate_batch, straight_stroke  # noqa: E402
from hnf_core.simulation.surface import height_map  # noqa: E402

FIRST_SEED = 1000
"""Constants were chosen on seeds below it."""
TOGETHER = 12
"""Instances per batch: ten strokes each."""
Piece = tuple[str, int]
HEADS = (
    "category", "classes", "instances", "RMS median (recorded)", "dB", "centroid median (recorded)", "%",
    "RMS in", "centroid in", "< 1 kHz in", "v exp in", "F exp in", "all numbers", "all five at once",
)  # fmt: skip


def felt(pieces: Sequence[Piece]) -> list[tuple[Feel, Feel]]:
    """The five numbers of some instances, as the instrument would record them and of the contact alone: one process's
    share of the work."""
    surfaces = []
    for name, seed in pieces:
        recipe, mechanics = instance(name, seed)
        surfaces.append((SmoothedMaps(height_map(recipe, seed)), mechanics))
    power, frequency = stroked(surfaces)
    return [(summed(each, frequency, instrument), summed(each, frequency)) for each in power]


def felt_by_all(pieces: Sequence[Piece], workers: int) -> list[tuple[Feel, Feel]]:
    parts = [pieces[low : low + TOGETHER] for low in range(0, len(pieces), TOGETHER)]
    with ProcessPoolExecutor(workers, mp_context=get_context("fork")) as pool:
        return [each for part in pool.map(felt, parts) for each in part]


def percent(values: Sequence[bool]) -> str:
    return f"{100.0 * np.mean(values):.0f} %" if len(values) else "–"


def row_of(label: str, names: int, felts: Sequence[Feel], inside: Sequence[dict[str, bool]], median: bool) -> list[str]:
    """One line of the table. Without `median` the middle columns stay empty."""
    middle = ["", "", "", ""]
    if median:
        recorded = RECORDED[label]
        rms = float(np.median([each.rms for each in felts]))
        centroid = float(np.median([each.centroid_hz for each in felts]))
        middle = [
            f"{rms:.2f} ({recorded.rms_median:.2f})",
            f"{20.0 * np.log10(rms / recorded.rms_median):+.1f}",
            f"{centroid:.0f} ({recorded.centroid_median})",
            f"{100.0 * (centroid / recorded.centroid_median - 1.0):+.0f}",
        ]
    shares = [
        percent([each[name] for each in inside if name in each])
        for name in ("rms", "centroid_hz", "below_1k", "v_exponent", "f_exponent")
    ]
    pooled = percent([value for each in inside for value in each.values()])
    return [label, str(names), str(len(felts)), *middle, *shares, pooled, percent([all(e.values()) for e in inside])]


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def ranges_tables(instances: int, first_seed: int, only: Sequence[str], by_class: bool, workers: int) -> list[str]:
    """Instances of every recorded class against the ranges of its category: with the recording instrument, without."""
    names = [n for n in classes() if recorded_category_of(n) and (not only or recorded_category_of(n) in only)]
    pieces = [(name, first_seed + k) for name in names for k in range(instances)]
    tables = []
    for felts in zip(*felt_by_all(pieces, workers), strict=True):
        inside = [within(each, recorded_category_of(name)) for each, (name, _) in zip(felts, pieces, strict=True)]
        if by_class:
            show_classes(names, pieces, felts, inside)
        rows = []
        for category in RECORDED:
            chosen = [k for k, (name, _) in enumerate(pieces) if recorded_category_of(name) == category]
            if chosen:
                count = len({pieces[k][0] for k in chosen})
                rows.append(row_of(category, count, [felts[k] for k in chosen], [inside[k] for k in chosen], True))
        rows.append(row_of("all", len(names), felts, inside, False))
        tables.append(markdown(HEADS, rows))
    return tables


def show_classes(
    names: Sequence[str], pieces: Sequence[Piece], felts: Sequence[Feel], inside: Sequence[dict[str, bool]]
) -> None:
    for name in names:
        chosen = [k for k, (other, _) in enumerate(pieces) if other == name]
        numbers = np.array([[f.rms, f.centroid_hz, f.below_1k, f.v_exponent, f.f_exponent] for f in felts])[chosen]
        spread = "  ".join(f"{np.median(column):7.3f} [{column.min():.3f} {column.max():.3f}]" for column in numbers.T)
        misses = {key: sum(not inside[k][key] for k in chosen) for key in inside[chosen[0]]}
        print(f"{name:18}{spread}  {({key: n for key, n in misses.items() if n}) or ''}", flush=True)


SPEED_ROWS, SPEED_SECONDS = 192, 1.0


def timed(worker: int) -> tuple[float, float]:
    """Wall and CPU seconds of one batch: sixteen surfaces, twelve strokes each, sampling of the maps included."""
    surfaces = []
    for name in classes()[worker::2][:16]:
        recipe, mechanics = instance(name, 0)
        surfaces.append((SmoothedMaps(height_map(recipe, 0)), mechanics))
    each = SPEED_ROWS // len(surfaces)
    rows = [(maps, mechanics, k) for maps, mechanics in surfaces for k in range(each)]
    strokes = [straight_stroke(0.02 * (1 + k), 1.0, SPEED_SECONDS, angle_rad=0.5 * k) for _, _, k in rows]
    wall, cpu = time.perf_counter(), time.process_time()
    simulate_batch([maps for maps, _, _ in rows], strokes, [mechanics for _, mechanics, _ in rows])
    return time.perf_counter() - wall, time.process_time() - cpu


def speed_table() -> str:
    """Seconds of signal per second, two processes side by side."""
    load = os.getloadavg()[0]
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        walls, cpus = zip(*pool.map(timed, range(2)), strict=True)
    signal = 2 * SPEED_ROWS * SPEED_SECONDS
    rows = [
        [f"wall clock, two processes, load {load:.1f} before on {os.cpu_count()} cores", f"{signal / max(walls):.0f}×"],
        ["CPU time, per core", f"{signal / sum(cpus):.0f}×"],
    ]
    return markdown(["measured by", f"real time ({2 * SPEED_ROWS} strokes of {SPEED_SECONDS:g} s)"], rows)


def fill(document: Path, tables: dict[str, str]) -> None:
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
    tables = {"speed": speed_table()} if a.speed else all_tables(a)
    print("\n\n".join(tables.values()))
    if a.write:
        fill(ROOT / "docs" / "simulator.md", tables)
    return 0


def all_tables(a: argparse.Namespace) -> dict[str, str]:
    recorded, alone = ranges_tables(a.instances, a.first_seed, a.only, a.classes, a.workers)
    seeds = f"{a.instances} instances per class, seeds {a.first_seed}–{a.first_seed + a.instances - 1}."
    tables = {"recorded": f"{seeds}\n\n{recorded}", "alone": alone}
    if not a.only:
        tables["ablations"] = markdown(["part", "statistic", "measured", "what the model says"], ablations())
        tables["speed"] = speed_table()
    return tables


if __name__ == "__main__":
    sys.exit(main())
