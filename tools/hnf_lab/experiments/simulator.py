"""Compare the contact simulator with recorded textures; measure its ablations and its speed. Prints Markdown.

  Usage: python -m hnf_lab.experiments.simulator [--instances N] [--first-seed S] [--only CATEGORY …] [--classes]
         [--speed] [--write]

--write puts the results into docs/simulator.md, between its markers; --classes shows every class as well.

The ranges of recorded textures are HaTT's per category, from the published AR models of its 100 textures (H. Culbertson
et al. 2014, "One hundred data-driven haptic texture models and open-source methods for rendering on 3D objects", IEEE
Haptics Symposium). An ablation removes one part of the contact model, and one named statistic changes as the cited
model predicts; tests/experiments/test_simulation_ablations.py asserts the same.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.files import write_text
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.probe import Probe, get_probe
from hnf_core.simulation.contact_dynamics import Physics, SmoothedMaps
from hnf_core.simulation.material_classes import get_recorded_category, list_classes, sample_instance
from hnf_core.simulation.simulate import (
    SAMPLE_RATE_HZ,
    Stroke,
    simulate,
    simulate_batch,
    simulate_motion,
    straight_stroke,
)
from hnf_core.simulation.surface_recipe import Noise, SurfaceRecipe, height_map
from hnf_lab import ROOT
from hnf_lab.evaluation.texture_statistics import (
    TextureStatistics,
    aggregate_strokes,
    compute_fused_spectra,
    simulate_strokes,
)

Range = tuple[float, float]


@dataclass(frozen=True)
class CategoryRanges:
    """Recorded statistics of one category: number of textures, medians, and 5–95 % ranges.

    RMS [m/s²] (full range) and centroid [Hz] are at 100 mm/s and 1 N. f_exponent is None for carbon fibre, which has a
    single value.
    """

    count: int
    rms_median: float
    rms: Range
    centroid_median: float
    centroid_hz: Range
    below_1k: Range
    v_exponent: Range
    f_exponent: Range | None


HATT_RANGES = {
    "Carbon fibre": CategoryRanges(2, 1.78, (1.57, 2.00), 271, (241, 301), (0.98, 0.99), (1.31, 1.48), None),
    "Carpet": CategoryRanges(5, 2.86, (2.05, 6.84), 61, (50, 117), (0.99, 1.00), (0.02, 1.64), (0.32, 0.85)),
    "Fabric": CategoryRanges(30, 0.55, (0.24, 3.44), 256, (67, 754), (0.72, 1.00), (0.51, 1.55), (-0.11, 0.83)),
    "Foam": CategoryRanges(6, 0.97, (0.71, 1.47), 187, (73, 319), (0.96, 0.99), (0.42, 0.95), (0.15, 0.31)),
    "Metal": CategoryRanges(6, 1.71, (0.38, 6.24), 466, (234, 695), (0.89, 0.99), (0.06, 0.97), (-0.40, 0.62)),
    "Paper": CategoryRanges(22, 0.79, (0.33, 7.51), 261, (149, 601), (0.87, 1.00), (0.29, 1.37), (-0.07, 0.89)),
    "Plastic": CategoryRanges(10, 0.98, (0.22, 3.30), 209, (137, 771), (0.72, 1.00), (0.73, 1.36), (-0.14, 0.57)),
    "Stone": CategoryRanges(7, 5.29, (1.05, 13.8), 513, (407, 579), (0.85, 0.98), (0.50, 1.31), (-0.37, 0.27)),
    "Tile": CategoryRanges(7, 1.68, (0.69, 4.14), 169, (131, 196), (0.97, 1.00), (0.70, 1.36), (0.10, 0.56)),
    "Wood": CategoryRanges(5, 0.79, (0.49, 1.47), 282, (144, 345), (0.95, 0.99), (0.55, 1.49), (0.05, 0.49)),
}
PUBLISHED_DECIMALS = {"rms": 2, "centroid_hz": 0, "below_1k": 2, "v_exponent": 2, "f_exponent": 2}
"""Decimals of the published ranges; values are rounded alike before the comparison."""


NOISE_FLOOR_M_S2_PER_ROOT_HZ = 0.9e-3
LINE_HZ = 1915.0
LINE_RMS_M_S2 = 0.107
"""Noise of HaTT's instrument: floor, frequency and RMS of a spectral line.

Above 1.3 kHz eleven of twenty soft textures (silk, velvet, cork, foam, …) have the same spectrum at 50, 100 and 150
mm/s: a flat floor and a line, together 0.115–0.126 m/s² (medians). This cannot come from the contact. In silk it is a
tenth of the power, and it keeps foam's fraction below 1 kHz under 1.
"""


def compute_instrument_noise(frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the power density [(m/s²)²/Hz] of the instrument's noise; the line is 20 Hz wide."""
    width = 20.0
    line = LINE_RMS_M_S2**2 / (width * np.sqrt(np.pi)) * np.exp(-np.square((frequency_hz - LINE_HZ) / width))
    return np.asarray(NOISE_FLOOR_M_S2_PER_ROOT_HZ**2 + line)


def check_ranges(statistics: TextureStatistics, category: str) -> dict[str, bool]:
    """Return statistic → True if it lies in the category's range; empty for a category without recordings."""
    if category not in HATT_RANGES:
        return {}
    inside = {}
    for name, digits in PUBLISHED_DECIMALS.items():
        limits = getattr(HATT_RANGES[category], name)
        if limits is not None:
            inside[name] = limits[0] <= round(getattr(statistics, name), digits) <= limits[1]
    return inside


Float = NDArray[np.float64]

PEN = get_probe("pen")
WOOD_MECHANICS = Mechanics(1.0e5, 0.2, 0.3)
ROUGH_RECIPE = SurfaceRecipe(noise=(Noise(6e-6, slope=2.0),))
FLAT_SURFACE = SmoothedMaps(np.zeros((64, 64), np.float32))
ANGLES = (0.3, 1.1, 1.9, 2.7)


def simulate_over(recipe: SurfaceRecipe, force_n: float, probe: Probe, physics: Physics, speed_m_s: float) -> Float:
    """Simulate half a second in four directions, (4, n, 3), without the first 50 ms."""
    surface = SmoothedMaps(height_map(recipe, 1))
    strokes = [straight_stroke(speed_m_s, force_n, 0.55, angle_rad=angle) for angle in ANGLES]
    count = len(strokes)
    acceleration = simulate_batch([surface] * count, strokes, [WOOD_MECHANICS] * count, probe, physics=physics)
    return acceleration[:, round(0.05 * SAMPLE_RATE_HZ) :]


def measure_centroid(radius_m: float) -> float:
    """Return the centroid [Hz] of the normal acceleration on a fine rough surface, 100 mm/s, 1 N.

    By Hertz, a contact of width a ∝ R^(1/3) averages short waves, so the centroid falls with the tip radius. The
    stiffness is kept constant (k ∝ R^(1/3) is divided out) to isolate the tip's low-pass.
    """
    probe = PEN._replace(tip_radius_m=radius_m)
    mechanics = replace(WOOD_MECHANICS, stiffness_n_m=1.0e5 * (PEN.tip_radius_m / radius_m) ** (1.0 / 3.0))
    surface = SmoothedMaps(height_map(ROUGH_RECIPE.scale_heights(0.05), 1))
    strokes = [straight_stroke(0.1, 1.0, 0.35, angle_rad=angle) for angle in ANGLES]
    acceleration = simulate_batch([surface] * 4, strokes, [mechanics] * 4, probe)[:, 500:, 2]
    power = np.square(np.abs(np.fft.rfft(acceleration * np.hanning(acceleration.shape[1]), axis=1))).mean(axis=0)
    frequency = np.fft.rfftfreq(acceleration.shape[1], 1.0 / SAMPLE_RATE_HZ)
    return float((power * frequency)[frequency >= 10.0].sum() / power[frequency >= 10.0].sum())


def simulate_slow_pull(speeds_m_s: Sequence[float], friction: str, seconds: float = 1.6) -> Float:
    """Return the tip velocity (speeds, steps) of a pen pulled over a flat, uniform surface at 1 N by the hand's spring.

    The pull starts from rest; the second half of `seconds` is returned.
    """
    n = round(seconds * SAMPLE_RATE_HZ)
    start = np.minimum(np.arange(n) / (0.05 * SAMPLE_RATE_HZ), 1.0)
    strokes = [
        Stroke(np.stack([np.cumsum(v * start) / SAMPLE_RATE_HZ, np.zeros(n)], axis=1), np.ones(n)) for v in speeds_m_s
    ]
    rows = len(strokes)
    motion = simulate_motion(
        [FLAT_SURFACE] * rows, strokes, [WOOD_MECHANICS] * rows,
        physics=Physics(friction=friction, friction_noise=False),
    )  # fmt: skip
    return motion.sliding_m_s[len(motion.sliding_m_s) // 2 :, 0].T


def compute_stuck_share(sliding: Float, speed_m_s: float) -> float:
    """Return the fraction of time in which the tip moves at less than a fifth of the hand's speed."""
    return float(np.mean(np.abs(sliding) < 0.2 * speed_m_s))


def count_slips_per_second(sliding: Float, speed_m_s: float) -> float:
    """Return the number of slips per second, from the first slip to the last."""
    fast = sliding > 2.0 * speed_m_s
    breaks = np.flatnonzero(fast[1:] & ~fast[:-1])
    return float((len(breaks) - 1) / ((breaks[-1] - breaks[0]) / (2.0 * SAMPLE_RATE_HZ))) if len(breaks) > 1 else 0.0


def measure_level_db(friction: str) -> float:
    """Return the level of all three axes on a rough surface at 100 mm/s, 1 N, in dB of (m/s²)²."""
    power, _ = compute_fused_spectra(simulate_over(ROUGH_RECIPE, 1.0, PEN, Physics(friction=friction), 0.1))
    return float(10.0 * np.log10(power.sum(axis=1).mean()))


def measure_flight_and_skewness(unilateral: bool) -> tuple[float, float]:
    """Return the fraction of time in free fall and the skewness of the normal acceleration.

    The stroke is light (0.3 N, 150 mm/s) on a rough surface. A unilateral contact gives long falls at −F/m and short
    upward impacts; a bilateral one gives neither. The probe is rigid here, since the resonances of its body ring on
    through each fall.
    """
    force = 0.3
    normal = simulate_over(ROUGH_RECIPE, force, PEN, Physics(unilateral=unilateral, body=False), 0.15)[:, :, 2]
    falling = np.abs(normal + force / PEN.mass_kg) < 0.03 * force / PEN.mass_kg
    centred = normal - normal.mean()
    return float(falling.mean()), float(np.mean(centred**3) / np.mean(centred**2) ** 1.5)


def measure_ring_hz(mass_kg: float) -> float:
    """Return the probe's ringing frequency [Hz] after a step of force from 1.0 to 1.1 N: sqrt(k/m) / 2π."""
    n = 2500
    force = np.where(np.arange(n) < 500, 1.0, 1.1)
    stroke = Stroke(np.zeros((n, 2)), force)
    normal = simulate(FLAT_SURFACE, stroke, replace(WOOD_MECHANICS, damping_ratio=0.03), PEN._replace(mass_kg=mass_kg))[
        520:, 2
    ]
    spectrum = np.abs(np.fft.rfft(normal * np.hanning(len(normal)), 1 << 16))
    return float(np.fft.rfftfreq(1 << 16, 1.0 / SAMPLE_RATE_HZ)[np.argmax(spectrum)])


def measure_ablations() -> list[tuple[str, str, str, str]]:
    """Return (part, statistic, figures, prediction of the cited model) for docs/simulator.md."""
    tips = [measure_centroid(r) for r in (0.25e-3, 0.5e-3, 1e-3, 2e-3)]
    slow, quick = (0.5e-3, 1e-3, 4e-3), (0.02, 0.1)
    pulled = simulate_slow_pull((*slow, *quick), "lugre", 12.0)
    stuck = [compute_stuck_share(pulled[1], 1e-3), compute_stuck_share(simulate_slow_pull([1e-3], "coulomb")[0], 1e-3)]
    slips = [count_slips_per_second(sliding, v) for sliding, v in zip(pulled, slow, strict=False)]
    fast = [compute_stuck_share(sliding, v) for sliding, v in zip(pulled[3:], quick, strict=True)]
    levels = [measure_level_db(friction) for friction in ("lugre", "coulomb")]
    loss = [measure_flight_and_skewness(unilateral) for unilateral in (True, False)]
    rings = [measure_ring_hz(m) for m in (0.0175, 0.035, 0.07, 0.14)]
    return [
        ("tip radius 0.25, 0.5, 1, 2 mm", "centroid of the normal axis",
         ", ".join(f"{c:.0f}" for c in tips) + " Hz", "falls: a wider contact averages short waves (Hertz)"),
        ("LuGre → Coulomb", "share of time stuck, pulled at 1 mm/s", f"{100 * stuck[0]:.0f} % → {100 * stuck[1]:.0f} %",
         "stick–slip needs stiction and the falling Stribeck branch (Canudas de Wit 1995)"),
        ("LuGre, pulled at 0.5, 1, 4 mm/s", "slips per second", ", ".join(f"{s:.2f}" for s in slips),
         "v k / ΔF = 0.67, 1.33: the damped hand unwinds its spring by ΔF / k and no further (Rabinowicz 1965); none "
         "above 1.9 mm/s"),
        ("LuGre, pulled at 20, 100 mm/s", "share of time stuck", ", ".join(f"{100 * s:.0f} %" for s in fast),
         "none far above the Stribeck speed"),
        ("LuGre → Coulomb", "level at 100 mm/s on a rough surface", f"{levels[0]:.2f} → {levels[1]:.2f} dB",
         "unchanged far above the Stribeck speed"),
        ("contact loss → N < 0 allowed", "time in free fall; skewness of the normal axis",
         f"{100 * loss[0][0]:.0f} % → {100 * loss[1][0]:.0f} %; {loss[0][1]:+.2f} → {loss[1][1]:+.2f}",
         "falls at −F/m and blows upwards only where the surface cannot pull"),
        ("mass 17.5, 35, 70, 140 g", "ringing after a step of force", ", ".join(f"{r:.0f}" for r in rings) + " Hz",
         "∝ m^(−1/2) (contact resonance)"),
    ]  # fmt: skip


FIRST_SEED = 1000
"""First seed of the instances; constants were chosen on lower seeds."""
INSTANCES_PER_BATCH = 12
"""Instances per batch, with ten strokes each."""
Instance = tuple[str, int]
TABLE_HEADER = (
    "category", "classes", "instances", "RMS median (recorded)", "dB", "centroid median (recorded)", "%",
    "RMS in", "centroid in", "< 1 kHz in", "v exp in", "F exp in", "all numbers", "all five at once",
)  # fmt: skip


def measure_instances(instances: Sequence[Instance]) -> list[tuple[TextureStatistics, TextureStatistics]]:
    """Return the five statistics of some instances, with and without the instrument's noise."""
    surfaces = []
    for name, seed in instances:
        recipe, mechanics = sample_instance(name, seed)
        surfaces.append((SmoothedMaps(height_map(recipe, seed)), mechanics))
    power, frequency = simulate_strokes(surfaces)
    return [
        (
            aggregate_strokes(strokes_power, frequency, compute_instrument_noise),
            aggregate_strokes(strokes_power, frequency),
        )
        for strokes_power in power
    ]


def measure_in_parallel(
    instances: Sequence[Instance], workers: int
) -> list[tuple[TextureStatistics, TextureStatistics]]:
    batches = [instances[low : low + INSTANCES_PER_BATCH] for low in range(0, len(instances), INSTANCES_PER_BATCH)]
    with ProcessPoolExecutor(workers, mp_context=get_context("fork")) as pool:
        return [item for batch in pool.map(measure_instances, batches) for item in batch]


def format_percent(values: Sequence[bool]) -> str:
    return f"{100.0 * np.mean(values):.0f} %" if len(values) else "–"


def make_row(
    label: str, names: int, statistics: Sequence[TextureStatistics], inside: Sequence[dict[str, bool]], median: bool
) -> list[str]:
    """Format one row of the table. Without `median` the middle columns stay empty."""
    middle = ["", "", "", ""]
    if median:
        recorded = HATT_RANGES[label]
        rms = float(np.median([statistic.rms for statistic in statistics]))
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
    """Compare instances of every recorded class with the ranges, with and without the instrument's noise."""
    names = [n for n in list_classes() if get_recorded_category(n) and (not only or get_recorded_category(n) in only)]
    all_instances = [(name, first_seed + k) for name in names for k in range(instances)]
    tables = []
    for statistics in zip(*measure_in_parallel(all_instances, workers), strict=True):
        inside = [
            check_ranges(item, get_recorded_category(name))
            for item, (name, _) in zip(statistics, all_instances, strict=True)
        ]
        if by_class:
            print_classes(names, all_instances, statistics, inside)
        rows = []
        for category in HATT_RANGES:
            chosen = [k for k, (name, _) in enumerate(all_instances) if get_recorded_category(name) == category]
            if chosen:
                count = len({all_instances[k][0] for k in chosen})
                rows.append(
                    make_row(category, count, [statistics[k] for k in chosen], [inside[k] for k in chosen], True)
                )
        rows.append(make_row("all", len(names), statistics, inside, False))
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
    """Return wall and processor seconds of one batch of sixteen surfaces with twelve strokes each."""
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


def make_speed_table(workers: int) -> str:
    """Measure the seconds of signal per second with one or two processes in parallel."""
    load, workers = os.getloadavg()[0], min(workers, 2)
    with ProcessPoolExecutor(workers, mp_context=get_context("fork")) as pool:
        walls, cpus = zip(*pool.map(time_batch, range(workers)), strict=True)
    strokes = workers * SPEED_ROWS
    signal, processes = strokes * SPEED_SECONDS, ("one process", "two processes")[workers - 1]
    rows = [
        [f"wall clock, {processes}, load {load:.1f} before on {os.cpu_count()} cores", f"{signal / max(walls):.0f}×"],
        ["CPU time, per core", f"{signal / sum(cpus):.0f}×"],
    ]
    return format_table(["measured by", f"real time ({strokes} strokes of {SPEED_SECONDS:g} s)"], rows)


def fill_markers(document: Path, tables: dict[str, str]) -> None:
    """Insert each table between its markers <!-- name --> … <!-- /name -->."""
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
    tables = {"speed": make_speed_table(a.workers)} if a.speed else make_all_tables(a)
    print("\n\n".join(tables.values()))
    if a.write:
        fill_markers(ROOT / "docs" / "simulator.md", tables)
    return 0


def make_all_tables(a: argparse.Namespace) -> dict[str, str]:
    recorded, alone = make_range_tables(a.instances, a.first_seed, a.only, a.classes, a.workers)
    seeds = f"{a.instances} instances per class, seeds {a.first_seed}–{a.first_seed + a.instances - 1}."
    tables = {"recorded": f"{seeds}\n\n{recorded}", "alone": alone}
    if not a.only:
        tables["ablations"] = format_table(
            ["part", "statistic", "measured", "what the model says"], measure_ablations()
        )
        tables["speed"] = make_speed_table(a.workers)
    return tables


if __name__ == "__main__":
    sys.exit(main())
