"""One material of the evaluation as a job of its own, so that two cores work on two of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from ..baselines.method import MaterialRecordings
from ..datasets.catalogue import open_dataset
from ..datasets.simulated import SimulatedLibrary
from ..errors import HnfError
from ..material.encoder import describe
from ..material.library import get_material
from ..simulation.surface import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map
from ..tactile.height import tactile_map_from_height
from ..tactile.optics import SENSORS
from .direction import DirectionSpectra, measure_directions
from .field_methods import SharedField
from .materials import EvaluatedMaterial, EvaluationSizes, MaterialResult, evaluate_material, score_method
from .methods import Budget, select_entries
from .report import Cell

DIRECTION_METHODS = ("field", "shared", "gacm", "ar", "playback")


@dataclass(frozen=True)
class EvaluationJob:
    """kind: "simulated" or "hatt". folder: of the HaTT copy. place: of the material in the run, from 0. directions:
    also measure spectra by direction."""

    kind: str
    name: str
    folder: Path | None
    index: int
    keys: tuple[str, ...]
    sizes: EvaluationSizes
    budget: Budget
    seed: int
    directions: bool = False


@dataclass(frozen=True)
class JobResult:
    """sensors: touch sensor → the shared field's cells with that sensor's token, on the column's own strokes."""

    job: EvaluationJob
    result: MaterialResult
    sensors: dict[str, list[Cell]]
    directions: DirectionSpectra | None


def make_subject(job: EvaluationJob) -> EvaluatedMaterial:
    """Raises HnfError where the data set does not have the material."""
    if job.kind == "simulated":
        data, material = SimulatedLibrary(), get_material(job.name)
        process = data.process(material.name)
        return EvaluatedMaterial(
            process, data.action_range(material.name), material.token, material.mechanics, material.category
        )
    data_set = open_dataset(job.kind, job.folder)
    modelled = data_set.process(job.name)
    if modelled is None:
        raise HnfError("it has no texture model.", where=job.name, remedy="Choose another material.")
    return EvaluatedMaterial(modelled, data_set.action_range(job.name), known=frozenset({"speed", "force"}))


def run_job(job: EvaluationJob, watch: Callable[[str], None] = lambda _: None) -> JobResult:
    """Everything about one material."""
    subject = make_subject(job)
    entries = [
        entry for entry in select_entries(job.keys) if entry.max_materials is None or job.index < entry.max_materials
    ]
    judged = evaluate_material(subject, entries, job.sizes, job.budget, job.seed, watch)
    sensors = _score_by_sensor(job, judged) if job.kind == "simulated" and "shared" in job.keys else {}
    directions = None
    if job.directions:
        watch(f"{job.name}: by direction")
        shown = {key: judged.fitted[key] for key in DIRECTION_METHODS if key in judged.fitted}
        directions = measure_directions(
            subject.process, subject.limits, shown, job.sizes.seconds, max(2, job.sizes.realisations // 4), job.seed
        )
    return JobResult(job, replace(judged, fitted={}), sensors, directions)


def run_jobs(jobs: Sequence[EvaluationJob], workers: int, watch: Callable[[str], None]) -> Iterator[JobResult]:
    """In order; each in a process of its own where there are workers for it."""
    if workers <= 1 or len(jobs) <= 1:
        for job in jobs:
            yield run_job(job, watch)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(run_job, job) for job in jobs]
        for job, future in zip(jobs, waiting, strict=True):
            watch(f"{job.name}")
            yield future.result()


def _score_by_sensor(job: EvaluationJob, result: MaterialResult) -> dict[str, list[Cell]]:
    """The shared field with tokens that E makes of each sensor's image of the same height map."""
    material = get_material(job.name)
    height = height_map(SurfaceRecipe.from_dict(material.recipe), material.seed)
    pitch = TILE_SIZE_M / TILE_PIXELS
    drawn = result.references["window"]
    shared = select_entries(["shared"])[0].build(job.budget)
    assert isinstance(shared, SharedField)
    out = {}
    for sensor in SENSORS:
        token = describe(tactile_map_from_height(height, None, pitch, 2.0 * pitch, sensor)).values
        fitted = shared.fit(MaterialRecordings(material.name, (), token, material.mechanics), job.seed)
        out[sensor] = score_method(shared, fitted, drawn, job.sizes.renders, job.seed)
    return out
