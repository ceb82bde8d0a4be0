"""Surfaces to train on: the library's and random ones, also with long waves of one and short waves of another."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..datasets.pair_tiles import CROSSOVER_WAVELENGTH_M, RANDOM_SCALE_DECADES, splice_spectra
from ..material.encoders import get_encoder
from ..material.mechanics import Mechanics
from ..material.token import ENCODER_ID
from ..simulation.classes import derive_seed, list_classes, sample_instance
from ..simulation.recipes import random_recipe
from ..simulation.sampling import SmoothedMaps
from ..simulation.surface import TILE_SIZE_M, SurfaceRecipe, height_map
from ..tactile.height import tactile_map_from_height

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Surface:
    """A height map with what E says of it. mechanics: of the material it comes from, None = any."""

    name: str
    maps: SmoothedMaps
    token: NDArray[np.float32]
    mechanics: Mechanics | None = None


def make_surface(
    name: str, height: NDArray[np.float32], mechanics: Mechanics | None = None, encoder: str = ENCODER_ID
) -> Surface:
    """Describe a height map (one 20 mm tile) by the product's own path: sensor image, then E (a make, or its file)."""
    pitch = TILE_SIZE_M / height.shape[0]
    token = get_encoder(encoder).describe(tactile_map_from_height(height, None, pitch, 2.0 * pitch)).values
    return Surface(name, SmoothedMaps(height, cache_size=4), token, mechanics)


def make_random_surfaces(count: int, seed: int, workers: int = 1, encoder: str = ENCODER_ID) -> list[Surface]:
    """Random recipes; every second one fused from two, because tokens in use are: measured long waves of a bake with a
    library material's short waves."""
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
    """One material: a surface process with its mechanics. name: unique. class_name: of simulation.classes. seed: of its
    first patch; a later patch of the same material has a later one."""

    name: str
    class_name: str
    recipe: SurfaceRecipe
    mechanics: Mechanics
    seed: int


def load_library_specimens(path: Path) -> list[Specimen]:
    """The materials of a library file; each is named after its class."""
    return [
        Specimen(entry["name"], entry["name"], SurfaceRecipe.from_dict(entry["recipe"]),
                 Mechanics(**entry["mechanics"]), int(entry["seed"]))
        for entry in json.loads(path.read_text(encoding="utf-8"))["materials"]
    ]  # fmt: skip


def make_class_specimens(seeds: Sequence[int]) -> list[Specimen]:
    """One instance of every class for each seed."""
    return [
        Specimen(f"{name}/{seed}", name, *sample_instance(name, seed), derive_seed(f"{name}/{seed}"))
        for seed in seeds
        for name in list_classes()
    ]


def make_patches(
    specimens: Sequence[Specimen], first: int, count: int, workers: int = 1, encoder: str = ENCODER_ID
) -> list[Surface]:
    """Patches first … first + count − 1 of every specimen, described; those of one specimen stand together."""
    jobs: list[SurfaceJob] = [
        (each.name, height_map(each.recipe, each.seed + first + index), each.mechanics, encoder)
        for each in specimens
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
