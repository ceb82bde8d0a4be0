"""Evaluate all methods on one material: training recordings, references, scores, and spectra by direction.

Every method is trained on its own kind of strokes and scored on strokes that are not among them (`evaluate_material`).
`run_jobs` evaluates several materials in worker processes. `DirectionSpectra` compares spectra by stroke direction on
an anisotropic material (as in HNF, fig. 5).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.datasets.pair_generation import compute_slopes
from hnf_core.datasets.recording import ActionRange, Recording, TextureProcess
from hnf_core.datasets.registry import open_dataset
from hnf_core.datasets.simulated import SimulatedLibrary
from hnf_core.errors import HnfError
from hnf_core.material.band_descriptor import describe
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, Mechanics
from hnf_core.material.encoder_registry import describe_views, get_default_encoder
from hnf_core.material.library import get_material
from hnf_core.material.shared_space import SharedSpace, find_touch, load_space
from hnf_core.material.token import ENCODER_NAMES
from hnf_core.metrics.spectra import select_compared_bins, welch
from hnf_core.simulation.appearance import (
    compute_ambient_occlusion,
    compute_cavity_depth,
    render_albedo,
    sample_appearance,
    sample_light,
    shade_surface,
)
from hnf_core.simulation.material_classes import CLASS_ENTRIES, get_category
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map
from hnf_core.tactile.diffusion import predict_tactile_maps
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.optics import SENSORS
from hnf_core.tactile.tactile_map import Route
from hnf_core.tactile.unet import load_map_weights
from hnf_core.tactile.views import cut_views

from ..baselines.interface import FittedMaterial, MaterialRecordings, Method
from .methods import Budget, FittedField, MethodEntry, SharedField, select_entries
from .report import BEST_NAME, ORACLE_NAME, Cell, Column, Row
from .scoring import (
    FREQUENCY_HZ,
    RATE_HZ,
    Reference,
    TrainingStrokes,
    Trial,
    make_references,
    make_training_actions,
    make_trials,
    score_best,
    score_expected_magnitude,
    score_natural,
)

Float = NDArray[np.float64]

DIRECTION_COUNT = 8
"""Directions over half a circle, 22.5° apart; opposite directions feel nearly the same."""


@dataclass(frozen=True)
class DirectionSpectra:
    """Spectra by stroke direction.

    Attributes
    ----------
    angle
        (8,) directions [rad].
    truth
        (8, 501) long-run densities.
    methods
        Method → (8, 501) densities.
    """

    material: str
    speed: float
    force: float
    angle: Float
    truth: Float
    methods: Mapping[str, Float]

    def compute_anisotropy_db(self) -> float:
        """Return the largest RMS level ratio of two directions' spectra over the bins valid in both."""
        return max(
            _compute_rms(_compute_ratio_db(self.truth, i, j), self._count_bins(i, j))
            for i in range(DIRECTION_COUNT)
            for j in range(i + 1, DIRECTION_COUNT)
        )

    def compute_ratio_error_db(self, name: str) -> float:
        """Return the RMS error of the level ratio of each direction's spectrum to the first one's."""
        spectra = self.methods[name]
        errors = [
            _compute_rms(_compute_ratio_db(spectra, i, 0) - _compute_ratio_db(self.truth, i, 0), self._count_bins(i, 0))
            for i in range(1, DIRECTION_COUNT)
        ]
        return float(np.sqrt(np.mean(np.square(errors))))

    def _count_bins(self, i: int, j: int) -> NDArray[np.bool_]:
        return select_compared_bins(self.truth[i], FREQUENCY_HZ) & select_compared_bins(self.truth[j], FREQUENCY_HZ)


def measure_directions(
    process: TextureProcess,
    limits: ActionRange,
    fitted: Mapping[str, FittedMaterial],
    seconds: float,
    draws: int,
    seed: int,
) -> DirectionSpectra:
    """Measure spectra of steady strokes at middle speed and force in eight directions.

    `draws` realisations of the true process and of each method are averaged.
    """
    speed, force = (float(np.sqrt(low * high)) for low, high in (limits.speed_m_s, limits.force_n))
    angle = np.arange(DIRECTION_COUNT) * np.pi / DIRECTION_COUNT
    actions = [make_steady_action(seconds, speed, force, float(each)) for each in angle]
    drawn = process.record([action for action in actions for _ in range(draws)], 900_000 + seed)
    truth = _average_spectra([each.samples for each in drawn])
    methods = {}
    for name, each in fitted.items():
        rendered = [each.render(actions, seed + 40 + draw) for draw in range(draws)]
        methods[name] = _average_spectra(
            [rendered[draw][index] for index in range(DIRECTION_COUNT) for draw in range(draws)]
        )
    return DirectionSpectra(process.name, speed, force, angle, truth, methods)


def _average_spectra(signals: list[Float]) -> Float:
    spectra = np.stack([welch(signal, RATE_HZ)[1] for signal in signals])
    return np.asarray(spectra.reshape(DIRECTION_COUNT, len(signals) // DIRECTION_COUNT, -1).mean(axis=1))


def _compute_ratio_db(spectra: Float, i: int, j: int) -> Float:
    floor = 1e-12 * float(spectra.max())
    return np.asarray(10.0 * np.log10(np.maximum(spectra[i], floor) / np.maximum(spectra[j], floor)))


def _compute_rms(values: Float, bins: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean(np.square(values[bins])))) if bins.any() else 0.0


ProgressCallback = Callable[[str], None]
"""Receives the name of the current step."""
T = TypeVar("T")


@dataclass(frozen=True)
class EvaluationSizes:
    """Sizes of an evaluation.

    Attributes
    ----------
    seconds
        Duration of each test stroke [s].
    realisations
        Realisations of the true process per stroke, for bounds and long-run spectrum.
    renders
        Averaged renderings of each method; the pass criteria refer to seconds × renders = 8 s.
    training_s
        Duration of the recordings that a method is trained on [s].
    simulated, hatt, held_out
        Number of materials of each kind.
    known
        Number of trained materials compared with the held-out ones; None = all.
    """

    seconds: float = 4.0
    realisations: int = 32
    renders: int = 2
    training_s: float = 120.0
    simulated: int = 3
    hatt: int = 3
    held_out: int = 8
    known: int | None = None


@dataclass(frozen=True)
class EvaluatedMaterial:
    """A material under evaluation. known: components of u(t) that its recordings contain."""

    process: TextureProcess
    limits: ActionRange
    token: NDArray[np.float32] | None = None
    mechanics: Mechanics = UNKNOWN_MECHANICS
    category: str = ""
    known: frozenset[str] = frozenset({"direction", "speed", "force"})


@dataclass(frozen=True)
class MaterialResult:
    """References of a material by kind of stroke, and the scores and fits of every method."""

    references: dict[str, list[Reference]]
    cells: dict[str, dict[str, list[Cell]]]
    seconds: dict[str, float]
    fitted: dict[str, FittedMaterial]
    notes: tuple[str, ...]


def evaluate_material(
    subject: EvaluatedMaterial,
    entries: Sequence[MethodEntry],
    sizes: EvaluationSizes,
    budget: Budget,
    seed: int,
    watch: ProgressCallback,
) -> MaterialResult:
    """Evaluate all entries on one material. A method that fails is reported in the notes and skipped.

    Parameters
    ----------
    subject
        Material and true process.
    entries
        Methods.
    sizes, budget
        Amounts of data and training.
    seed
        Seed of strokes, recordings, training and rendering.
    watch
        Progress callback.

    Returns
    -------
    MaterialResult
        References, scores, times and fitted methods.
    """
    name = subject.process.name
    watch(f"{name}: the true process")
    trials = make_trials(subject.limits, sizes.seconds, seed)
    references = make_references(
        subject.process, [(item.name, item.action) for item in trials], 77 + seed, sizes.realisations, sizes.renders
    )
    cells = {
        "oracle": _group_by_kind(trials, [_make_natural_cell(item.oracle, item) for item in references]),
        "best": _group_by_kind(trials, [Cell(item.material, item.stroke, score_best(item)) for item in references]),
    }
    seconds, notes = {"oracle": 0.0, "best": 0.0}, []
    fitted: dict[str, FittedMaterial] = {}
    recordings_by_kind: dict[TrainingStrokes, tuple[Recording, ...]] = {}
    for entry in entries:
        if entry.needs_token and subject.token is None:
            continue
        watch(f"{name}: {entry.key}")
        try:
            if (
                entry.needs_recordings
                and entry.reuses not in fitted
                and entry.training_strokes not in recordings_by_kind
            ):
                recordings_by_kind[entry.training_strokes] = record_training_strokes(
                    subject, entry.training_strokes, sizes.training_s, seed
                )
            start = time.monotonic()
            method = entry.build(budget)
            fitted[entry.key] = _fit_method(
                entry, method, subject, recordings_by_kind.get(entry.training_strokes, ()), fitted, seed
            )
            method_cells = score_method(method, fitted[entry.key], references, sizes.renders, seed)
            cells[entry.key] = _group_by_kind(trials, method_cells)
            seconds[entry.key] = time.monotonic() - start
        except (HnfError, ValueError) as error:
            notes.append(f"{entry.key} on {name}: {error}")
    return MaterialResult(_group_by_kind(trials, references), cells, seconds, fitted, tuple(notes))


def record_training_strokes(
    subject: EvaluatedMaterial, training_strokes: TrainingStrokes, seconds: float, seed: int
) -> tuple[Recording, ...]:
    """Record the true process on the training strokes of a method."""
    actions = make_training_actions(training_strokes, subject.limits, seconds, seed)
    recordings: list[Recording] = []
    for group, length in enumerate(sorted({len(action.speed) for action in actions})):
        equally_long = [action for action in actions if len(action.speed) == length]
        recordings += subject.process.record(equally_long, 500_000 + 1000 * seed + group)
    return tuple(replace(recording, known=subject.known) for recording in recordings)


def make_column(key: str, title: str, note: str, kinds: Sequence[str], results: Sequence[MaterialResult],
           entries: Sequence[MethodEntry], budget: Budget) -> Column:  # fmt: skip
    """Build one column of the table from evaluated materials: bounds first, then every entry that took part."""
    rows = []
    for row_key in ("oracle", "best", *(entry.key for entry in entries)):
        cells = [cell for result in results for kind in kinds for cell in result.cells.get(row_key, {}).get(kind, [])]
        if not cells:
            continue
        method = next((entry.build(budget) for entry in entries if entry.key == row_key), None)
        name = method.name if method else {"oracle": ORACLE_NAME, "best": BEST_NAME}[row_key]
        form = method.form if method else {"oracle": "natural", "best": "expected magnitude"}[row_key]
        seconds = sum(result.seconds.get(row_key, 0.0) for result in results)
        rows.append(Row(row_key, name, form, tuple(cells), seconds))  # type: ignore[arg-type]
    return Column(key, title, note, tuple(rows))


def _fit_method(
    entry: MethodEntry,
    method: Method,
    subject: EvaluatedMaterial,
    recordings: tuple[Recording, ...],
    fitted: dict[str, FittedMaterial],
    seed: int,
) -> FittedMaterial:
    reused = fitted.get(entry.reuses)
    if isinstance(reused, FittedField):
        return replace(reused, form=method.form)
    recordings_of_material = MaterialRecordings(
        subject.process.name, recordings, subject.token, subject.mechanics, subject.category
    )
    return method.fit(recordings_of_material, seed)


def score_method(
    method: Method, fitted: FittedMaterial, drawn: Sequence[Reference], renders: int, seed: int
) -> list[Cell]:
    """Return one cell per reference."""
    rendered = [fitted.render([each.action for each in drawn], seed + 1 + repeat) for repeat in range(renders)]
    out = []
    for index, reference in enumerate(drawn):
        signals = [each[index] for each in rendered]
        if method.form == "natural":
            out.append(_make_natural_cell(signals, reference))
        else:
            out.append(Cell(reference.material, reference.stroke, score_expected_magnitude(signals, reference)))
    return out


def _make_natural_cell(signals: Sequence[Float], reference: Reference) -> Cell:
    density = np.asarray(np.mean([welch(signal, RATE_HZ)[1] for signal in signals], axis=0))
    return Cell(reference.material, reference.stroke, score_natural(signals, reference), density)


def _group_by_kind(planned: Sequence[Trial], values: Sequence[T]) -> dict[str, list[T]]:
    groups: dict[str, list[T]] = {}
    for trial, value in zip(planned, values, strict=True):
        groups.setdefault(trial.kind, []).append(value)
    return groups


DIRECTION_METHODS = ("field", "shared", "gacm", "ar", "playback")
"""Methods whose spectra by direction are measured."""


@dataclass(frozen=True)
class EvaluationJob:
    """Evaluation of one material, to be run in a worker process.

    Attributes
    ----------
    kind
        "simulated" or "hatt".
    folder
        Folder of the HaTT copy, or None.
    index
        Position of the material in the run, from 0.
    directions
        True to measure spectra by direction as well.
    space
        File of a shared space, which gives bridged tokens, or None.
    """

    kind: str
    name: str
    folder: Path | None
    index: int
    keys: tuple[str, ...]
    sizes: EvaluationSizes
    budget: Budget
    seed: int
    directions: bool = False
    space: Path | None = None


@dataclass(frozen=True)
class JobResult:
    """Result of an EvaluationJob.

    sensors: touch sensor, "predicted map" or "bridged" → the shared field's cells with the token from there, on the
    strokes of the first column.
    """

    job: EvaluationJob
    result: MaterialResult
    sensors: dict[str, list[Cell]]
    directions: DirectionSpectra | None


def make_subject(job: EvaluationJob) -> EvaluatedMaterial:
    """Load the material of a job. Raises HnfError if the data set does not have it."""
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
    """Run the complete evaluation of one material."""
    subject = make_subject(job)
    entries = [
        entry for entry in select_entries(job.keys) if entry.max_materials is None or job.index < entry.max_materials
    ]
    result = evaluate_material(subject, entries, job.sizes, job.budget, job.seed, watch)
    sensors = _score_by_sensor(job, result) if job.kind == "simulated" and "shared" in job.keys else {}
    directions = None
    if job.directions:
        watch(f"{job.name}: by direction")
        fitted = {key: result.fitted[key] for key in DIRECTION_METHODS if key in result.fitted}
        directions = measure_directions(
            subject.process, subject.limits, fitted, job.sizes.seconds, max(2, job.sizes.realisations // 4), job.seed
        )
    return JobResult(job, replace(result, fitted={}), sensors, directions)


def run_jobs(jobs: Sequence[EvaluationJob], workers: int, watch: Callable[[str], None]) -> Iterator[JobResult]:
    """Yield the results of the jobs in order, from worker processes if there are several."""
    if workers <= 1 or len(jobs) <= 1:
        for job in jobs:
            yield run_job(job, watch)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(run_job, job) for job in jobs]
        for job, future in zip(jobs, futures, strict=True):
            watch(f"{job.name}")
            yield future.result()


def _score_by_sensor(job: EvaluationJob, result: MaterialResult) -> dict[str, list[Cell]]:
    """Score the shared field with tokens of one height map: of each sensor's image, of a look, and bridged ones."""
    material = get_material(job.name)
    references = result.references["window"]
    shared = select_entries(["shared"])[0].build(job.budget)
    assert isinstance(shared, SharedField)
    cells = {}
    tokens = describe_sensor_tokens(job.name) | {PREDICTED_MAP: describe_look_token(job.name, job.seed)}
    if job.space is not None:
        tokens[BRIDGED] = describe_bridged_token(job.name, load_space(job.space))
    for sensor, token in tokens.items():
        fitted = shared.fit(MaterialRecordings(material.name, (), token, material.mechanics), job.seed)
        cells[sensor] = score_method(shared, fitted, references, job.sizes.renders, job.seed)
    return cells


LOOK_VIEWS = 8
"""Number of views of a photograph at the finest scale that D_φ predicts touch for."""
PREDICTED_MAP, BRIDGED = "predicted map", "bridged"
"""Token sources beside the sensors."""
PITCH_M = TILE_SIZE_M / TILE_PIXELS


def _make_height(name: str) -> NDArray[np.float32]:
    material = get_material(name)
    return height_map(SurfaceRecipe.from_dict(material.recipe), material.seed)


def describe_sensor_tokens(name: str) -> dict[str, NDArray[np.float32]]:
    """Return the token that E computes from each sensor's image of one height map of a library material."""
    height = _make_height(name)
    return {
        sensor: describe(tactile_map_from_height(height, None, PITCH_M, 2.0 * PITCH_M, sensor)).values
        for sensor in SENSORS
    }


def describe_bridged_token(name: str, space: SharedSpace) -> NDArray[np.float32]:
    """Return the mean token of the GelSight tuples that the DIGIT's image of the height map finds."""
    return find_touch(
        space, tactile_map_from_height(_make_height(name), None, PITCH_M, 2.0 * PITCH_M, "digit")
    ).token.values


def describe_look_token(name: str, seed: int) -> NDArray[np.float32]:
    """Return E's token of the tactile maps that D_φ predicts from a lit photograph of the height map."""
    recipe, rng = SurfaceRecipe.from_dict(get_material(name).recipe), np.random.default_rng([6, seed])
    appearance = sample_appearance(CLASS_ENTRIES[name].appearance, get_category(name), rng)
    spectrum = np.fft.rfft2(_make_height(name))
    cavity_m = compute_cavity_depth(spectrum, TILE_PIXELS, TILE_SIZE_M, appearance.reach_m)
    photograph = shade_surface(
        render_albedo(recipe, spectrum, appearance, TILE_SIZE_M, rng),
        *compute_slopes(spectrum, TILE_PIXELS, PITCH_M, 0.0), sample_light(rng), roughness=appearance.roughness,
        metallic=appearance.metallic, occlusion=compute_ambient_occlusion(cavity_m, appearance.reach_m),
    )  # fmt: skip
    views = cut_views(np.clip(photograph, 0.0, 1.0), None, None, PITCH_M, 2.0 * PITCH_M, fine_count=LOOK_VIEWS)
    maps = predict_tactile_maps(load_map_weights(), views, "gelsight", seed=range(seed, seed + len(views)))
    return describe_views(get_default_encoder(Route.PREDICTED, ENCODER_NAMES), maps).values
