"""Simulated training strokes: surfaces with tokens, random conditions of speed, force and direction, and their spectra.

Surfaces are patches of the library's materials, random instances of material classes (wood, denim, …), and random ones,
some of which combine the long waves of one with the short waves of another. The contact simulator gives the
acceleration of each steady stroke, whose spectrum is pooled into the 107 densities that the likelihood uses.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.pair_generation import CROSSOVER_WAVELENGTH_M, RANDOM_SCALE_DECADES, splice_spectra
from hnf_core.field.features import PROBE_KINDS
from hnf_core.material.contact_model import LEARNED_MECHANICS, Mechanics
from hnf_core.material.encoder_registry import get_encoder
from hnf_core.material.probe import get_probe
from hnf_core.material.token import ENCODER_ID
from hnf_core.metrics.spectra import window_power
from hnf_core.signal import dft321
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.material_classes import derive_seed, list_classes, sample_instance
from hnf_core.simulation.simulate import LEARNED_PHYSICS, SAMPLE_RATE_HZ, Stroke, simulate_batch, straight_stroke
from hnf_core.simulation.surface_recipe import TILE_SIZE_M, SurfaceRecipe, height_map, random_recipe
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.training.windows import COARSE_EDGES_HZ, FINE_BINS, pool_bins

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Surface:
    """A height map to stroke, and its material token.

    mechanics: stiffness, damping and friction of the material it comes from, None for a random surface.
    """

    name: str
    maps: SmoothedMaps
    token: NDArray[np.float32]
    mechanics: Mechanics | None = None


def make_surface(
    name: str, height: NDArray[np.float32], mechanics: Mechanics | None = None, encoder: str = ENCODER_ID
) -> Surface:
    """Build a surface from a height map (one 20 mm tile), with the token that an encoder gives it.

    encoder: name or file.
    """
    pitch = TILE_SIZE_M / height.shape[0]
    token = get_encoder(encoder).describe(tactile_map_from_height(height, None, pitch, 2.0 * pitch)).values
    return Surface(name, SmoothedMaps(height, cache_size=4), token, mechanics)


def make_random_surfaces(count: int, seed: int, workers: int = 1, encoder: str = ENCODER_ID) -> list[Surface]:
    """Build random surfaces, every second one with the long waves of one and the short waves of another.

    Tokens in use are combined like that: a baked height map gives the long waves, a library material the short ones.
    """
    rng = np.random.default_rng(seed)
    heights = []
    for _ in range(count):
        scale = 10.0 ** rng.uniform(*RANDOM_SCALE_DECADES)
        heights.append(height_map(random_recipe(rng), int(rng.integers(2**31))) * np.float32(scale))
    jobs: list[SurfaceJob] = []
    for index, height in enumerate(heights):
        if index % 2:
            border_m = np.exp(rng.uniform(*np.log(CROSSOVER_WAVELENGTH_M)))
            height = splice_spectra(height, heights[int(rng.integers(count))], 1.0 / border_m)
        jobs.append((f"random-{index}", height, None, encoder))
    return _make_surfaces(jobs, workers)


@dataclass(frozen=True)
class Specimen:
    """One material to train or evaluate on: a recipe for random height maps, with its mechanics.

    name: unique. class_name: its class in simulation.material_classes. mechanics: stiffness, damping, friction. seed:
    of its first patch; the seeds of later patches add their index.
    """

    name: str
    class_name: str
    recipe: SurfaceRecipe
    mechanics: Mechanics
    seed: int


def load_library_specimens(path: Path) -> list[Specimen]:
    """Read the materials of a library file as specimens; each is named after its class."""
    return [
        Specimen(entry["name"], entry["name"], SurfaceRecipe.from_dict(entry["recipe"]),
                 Mechanics(*(entry["mechanics"][name] for name in LEARNED_MECHANICS)), int(entry["seed"]))
        for entry in json.loads(path.read_text(encoding="utf-8"))["materials"]
    ]  # fmt: skip


def make_class_specimens(seeds: Sequence[int]) -> list[Specimen]:
    """Return one random material of every material class for each seed."""
    return [
        Specimen(f"{name}/{seed}", name, *_sample_learned(name, seed), derive_seed(f"{name}/{seed}"))
        for seed in seeds
        for name in list_classes()
    ]


def make_patches(
    specimens: Sequence[Specimen], first: int, count: int, workers: int = 1, encoder: str = ENCODER_ID
) -> list[Surface]:
    """Build height maps (patches) number first … first + count − 1 of every material.

    Those of one material are adjacent in the result. encoder: of the token, a name or file.
    """
    jobs: list[SurfaceJob] = [
        (specimen.name, height_map(specimen.recipe, specimen.seed + first + index), specimen.mechanics, encoder)
        for specimen in specimens
        for index in range(count)
    ]
    return _make_surfaces(jobs, workers)


SurfaceJob = tuple[str, NDArray[np.float32], Mechanics | None, str]


def _make_surfaces(jobs: list[SurfaceJob], workers: int) -> list[Surface]:
    if workers <= 1:
        return [make_surface(*job) for job in jobs]
    with ProcessPoolExecutor(workers, mp_context=get_context("fork")) as pool:
        return list(pool.map(_make_from_job, jobs, chunksize=8))


def _make_from_job(job: SurfaceJob) -> Surface:
    return make_surface(*job)


SPEED_RANGE_M_S = (0.005, 0.4)
FORCE_RANGE_N = (0.1, 5.0)
SPEED_COUNT = 64
"""Speeds in the grid: the expectation of a window needs one matrix per speed."""
FORCE_COUNT = 24
"""Forces in the grid: a surface smoothed by one contact radius serves many strokes."""
STIFFNESS_RANGE_N_M = (8e2, 4e5)
DAMPING_RANGE = (0.05, 0.8)
FRICTION_RANGE = (0.1, 1.3)
MIDDLE_SPEED_M_S = (0.03, 0.25)
MIDDLE_FORCE_N = (0.3, 3.0)
"""Middle ranges of speed and force, where most strokes lie and where materials are evaluated."""
MATERIAL_MECHANICS_SHARE = 0.6
"""Probability that a stroke has the mechanics of its material."""
WITHHELD_SHARE = 0.25
"""Probability that each mechanical property is withheld from the network."""
SPEEDS_AND_FORCES = ((0.05, 1.0), (0.1, 0.5), (0.1, 1.0), (0.1, 2.0), (0.2, 1.0), (0.15, 0.7))
ANGLES_RAD = np.radians([10.0, 77.0, 33.0, 121.0, 154.0, 55.0])
"""Directions of make_middle_conditions."""


@dataclass(frozen=True)
class SteadyStroke:
    """A straight stroke at constant speed and force.

    surface: index of the surface. speed: index into make_speed_grid(). angle: direction [rad]. force: [N]. start: (x,
    y) on the surface [m].
    """

    surface: int
    mechanics: Mechanics
    probe: str
    speed: int
    angle: float
    force: float
    start: tuple[float, float]


def make_speed_grid() -> Float:
    """Return the speeds (SPEED_COUNT,) [m/s] that simulated strokes are limited to."""
    return np.geomspace(*SPEED_RANGE_M_S, SPEED_COUNT)


def make_force_grid() -> Float:
    """Return the forces (FORCE_COUNT,) [N] that simulated strokes are limited to."""
    return np.geomspace(*FORCE_RANGE_N, FORCE_COUNT)


def draw_steady_strokes(
    surfaces: Sequence[Surface], per_surface: int, seed: int, *, middle_share: float = 0.0
) -> list[SteadyStroke]:
    """Draw random steady strokes on each surface, log-uniform in speed and force, two thirds with the pen.

    A fraction middle_share keeps to the middle ranges, to the pen and to the surface's own mechanics. Directions are
    uniform over the circle, so that every direction lies between trained ones.
    """
    rng = np.random.default_rng(seed)
    forces = make_force_grid()
    low, high = np.searchsorted(make_speed_grid(), MIDDLE_SPEED_M_S)
    lightest, firmest = np.searchsorted(forces, MIDDLE_FORCE_N)
    strokes = []
    for index, surface in enumerate(surfaces):
        for draw in range(per_surface):
            middle = rng.random() < middle_share and surface.mechanics is not None
            own_mechanics = surface.mechanics if middle else None
            strokes.append(
                SteadyStroke(
                    surface=index,
                    mechanics=own_mechanics or draw_mechanics(surface.mechanics, rng),
                    probe="pen" if middle or draw % 3 else "finger",
                    speed=int(rng.integers(low, high)) if middle else int(rng.integers(SPEED_COUNT)),
                    angle=float(rng.uniform(0.0, 2.0 * np.pi)),
                    force=float(forces[rng.integers(lightest, firmest) if middle else rng.integers(FORCE_COUNT)]),
                    start=(float(rng.uniform(0.0, 0.02)), float(rng.uniform(0.0, 0.02))),
                )
            )
    return strokes


def _sample_learned(name: str, seed: int) -> tuple[SurfaceRecipe, Mechanics]:
    """Sample an instance of a class, with the properties that F_Θ sees alone."""
    recipe, mechanics = sample_instance(name, seed)
    return recipe, Mechanics(*(getattr(mechanics, each) for each in LEARNED_MECHANICS))


def draw_mechanics(typical: Mechanics | None, rng: np.random.Generator) -> Mechanics:
    """Draw stiffness, damping and friction: the material's own (with 20 % scatter), or any.

    Otherwise the network would infer them from the token.
    """
    if typical is not None and rng.random() < MATERIAL_MECHANICS_SHARE:
        scatter = np.exp(0.2 * rng.standard_normal(3))
        return Mechanics(
            None if typical.stiffness_n_m is None else typical.stiffness_n_m * float(scatter[0]),
            None if typical.damping_ratio is None else typical.damping_ratio * float(scatter[1]),
            None if typical.friction is None else typical.friction * float(scatter[2]),
        )
    return Mechanics(
        float(np.exp(rng.uniform(*np.log(STIFFNESS_RANGE_N_M)))),
        float(np.exp(rng.uniform(*np.log(DAMPING_RANGE)))),
        float(np.exp(rng.uniform(*np.log(FRICTION_RANGE)))),
    )


def withhold_mechanics(mechanics: Mechanics, rng: np.random.Generator) -> Mechanics:
    """Set each property to unknown with probability WITHHELD_SHARE; one time in eight all of them."""
    if rng.random() < 0.125:
        return Mechanics()
    keep = rng.random(3) >= WITHHELD_SHARE
    return Mechanics(
        mechanics.stiffness_n_m if keep[0] else None,
        mechanics.damping_ratio if keep[1] else None,
        mechanics.friction if keep[2] else None,
    )


@dataclass(frozen=True)
class StrokeCondition:
    """Speed, force and direction of a steady stroke with the pen.

    speed: index into make_speed_grid(). force: [N]. angle: [rad].
    """

    speed: int
    force: float
    angle: float


def make_middle_conditions() -> list[StrokeCondition]:
    """Return six conditions of medium speed and force, with directions between the height map's axes."""
    grid = make_speed_grid()
    return [
        StrokeCondition(int(np.argmin(np.abs(np.log(grid / speed)))), force, float(angle))
        for (speed, force), angle in zip(SPEEDS_AND_FORCES, ANGLES_RAD, strict=True)
    ]


SETTLE_S = 0.06
"""Start of a simulation that is discarded [s]."""
STROKES_PER_BATCH = 512


def record_strokes(
    surfaces: Sequence[Surface], strokes: Sequence[SteadyStroke], seconds: float, workers: int = 2
) -> Float:
    """Simulate n steady strokes and return their mean spectra (n, 107), three axes fused to one by DFT321.

    The result does not depend on the number of workers.
    """
    jobs: list[list[int]] = []
    for probe in PROBE_KINDS:
        rows = sorted((row for row, stroke in enumerate(strokes) if stroke.probe == probe),
                      key=lambda row: (strokes[row].surface, strokes[row].force))  # fmt: skip
        jobs += [rows[low : low + STROKES_PER_BATCH] for low in range(0, len(rows), STROKES_PER_BATCH)]
    out = np.zeros((len(strokes), FINE_BINS + len(COARSE_EDGES_HZ) - 1))
    calls = [_make_job(surfaces, [strokes[row] for row in rows], seconds) for rows in jobs]
    with ProcessPoolExecutor(workers, mp_context=get_context("fork")) as pool:
        for done, (rows, power) in enumerate(zip(jobs, pool.map(_record_batch, calls), strict=True)):
            out[rows] = power
            print(f"\rsimulated {done + 1}/{len(jobs)} batches", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return out


RecordingJob = tuple[list[Surface], list[SteadyStroke], float]


def _make_job(surfaces: Sequence[Surface], strokes: list[SteadyStroke], seconds: float) -> RecordingJob:
    """Return a batch of strokes with only the surfaces it needs, to be sent to a worker process."""
    used = sorted({stroke.surface for stroke in strokes})
    index_of = {surface: index for index, surface in enumerate(used)}
    local_strokes = [
        SteadyStroke(index_of[s.surface], s.mechanics, s.probe, s.speed, s.angle, s.force, s.start) for s in strokes
    ]
    return [surfaces[index] for index in used], local_strokes, seconds


def _record_batch(job: RecordingJob) -> Float:
    """Simulate a batch of strokes and return their mean spectra (n, 107)."""
    surfaces, strokes, seconds = job
    speeds = make_speed_grid()
    acceleration = simulate_batch(
        [surfaces[stroke.surface].maps for stroke in strokes],
        [_make_path(stroke, float(speeds[stroke.speed]), seconds + SETTLE_S) for stroke in strokes],
        [stroke.mechanics for stroke in strokes],
        get_probe(strokes[0].probe),
        physics=LEARNED_PHYSICS,
    )
    settled = acceleration[:, round(SETTLE_S * SAMPLE_RATE_HZ) :]
    fused = dft321(settled - settled.mean(axis=1, keepdims=True))
    return np.stack([pool_bins(window_power(signal, SAMPLE_RATE_HZ)).mean(axis=0) for signal in fused])


def _make_path(stroke: SteadyStroke, speed: float, seconds: float) -> Stroke:
    return straight_stroke(speed, stroke.force, seconds, angle_rad=stroke.angle, start_m=stroke.start)
