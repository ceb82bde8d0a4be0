"""The paper's second table: GACM, HNF and HNF+ by touch sensor, with the limits of the data and this project beside.

Everything is learned from 20 s of circles on a simulated library material (the paper's 200 windows), HNF+ from the
eight primitives in addition, and scored against one recording of each test stroke, as published. The token is that of
each sensor's image of one height map. The first material has the published settings; the others, and the rows of raw
actions, may have fewer units and epochs, which stand in the row.

A raw action is what the load cell of a pen would record: the pressing force and TIP_KG times the vibration. The signal
to be predicted is thus in the input, in training and in the test, as it is in a recorded force.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.datasets.recording import ActionRange, Recording
from hnf_core.datasets.time_series import RAW_BANDWIDTH_HZ, smooth_series
from hnf_core.errors import pluralize
from hnf_core.field.field import FieldConfig
from hnf_core.material.contact_model import Mechanics
from hnf_core.metrics.similarity import st_sim_tum
from hnf_core.metrics.spectra import average_spectrum_distance_db, welch, window_magnitudes
from hnf_core.tactile.optics import SENSORS
from hnf_core.training.published_form import make_added_strokes

from ..baselines.interface import FittedMaterial, MaterialRecordings
from .materials import EvaluationJob, EvaluationSizes, describe_sensor_tokens, make_subject, record_training_strokes
from .methods import Budget, SharedField, select_entries
from .metrics import lsd_log10_magnitude, st_sim_cosine
from .report import BEST_NAME, ORACLE_NAME, format_table
from .run import SENSOR_LABELS
from .scoring import FREQUENCY_HZ, RATE_HZ, Reference, make_references, make_training_actions, make_trials

Float = NDArray[np.float64]

TRAINING_S = 20.0
"""Duration of the circles learned from [s]: 200 windows of 0.1 s."""
TIP_KG = 0.01
"""Mass between the load cell and the tip of the simulated pen [kg]."""
METRICS = {
    "st_sim_tum": ("ST-SIM ↑", ".2f"),
    "st_sim_cosine": ("ST-SIM cosine ↑", ".2f"),
    "lsd_log10": ("LSD ↓", ".2f"),
    "mse": ("MSE ↓", ".4g"),
    "mse_oracle": ("MSE / oracle ↓", ".2f"),
}
"""Metric → column and format. ST-SIM is `vibromaf`'s, MSE is against the recording."""


@dataclass(frozen=True)
class Settings:
    """Units and epochs of a trained HNF."""

    hidden: int = 1024
    epochs: int = 100

    def format_label(self) -> str:
        is_published = (self.hidden, self.epochs) == (1024, 100)
        return f"H = {self.hidden}, {pluralize(self.epochs, 'epoch')}{', as published' if is_published else ''}"


@dataclass(frozen=True)
class TableOptions:
    """Options of the table.

    Attributes
    ----------
    materials
        Library materials; the first is trained with `first`, the others with `others`.
    raw
        Settings of rows of raw actions; None leaves them out.
    gacm_steps
        Training steps of GACM.
    seconds
        Duration of each test stroke [s].
    realisations
        Realisations of the true process behind the limits.
    """

    materials: tuple[str, ...] = ("sandstone", "denim", "brushed-metal")
    first: Settings = Settings()
    others: Settings = Settings(256, 30)
    raw: Settings | None = Settings(128, 10)
    gacm_steps: int = 4000
    seconds: float = 4.0
    realisations: int = 16
    seed: int = 0
    workers: int = 2


@dataclass(frozen=True)
class TableRow:
    """Scores of one method with one sensor's token on one material, means over the test strokes."""

    method: str
    settings: str
    sensor: str
    scores: dict[str, float]
    seconds: float = 0.0


@dataclass(frozen=True)
class MaterialTable:
    """Rows of one material."""

    material: str
    rows: tuple[TableRow, ...] = field(default=())


def record_by_load_cell(recording: Recording) -> Action:
    """Return the action of a recording as a pen's load cell behind its tip records it, at the rate of the samples."""
    action, time_s = recording.action, np.arange(len(recording.samples) + 1) / recording.sample_rate
    vibration = np.append(recording.samples, recording.samples[-1])
    force = np.interp(time_s, action.time, action.force) + TIP_KG * vibration
    direction = np.stack([np.interp(time_s, action.time, axis) for axis in action.direction.T], axis=1)
    return replace(
        action, rate=recording.sample_rate, direction=direction / np.linalg.norm(direction, axis=1, keepdims=True),
        speed=np.interp(time_s, action.time, action.speed), position=np.interp(time_s, action.time, action.position),
        force=np.maximum(smooth_series(force, recording.sample_rate, RAW_BANDWIDTH_HZ), 0.0),
        contact=np.interp(time_s, action.time, action.contact) > 0.0,
    )  # fmt: skip


def with_raw_action(recording: Recording) -> Recording:
    return replace(recording, measure_raw_action=partial(record_by_load_cell, recording))


def make_table(options: TableOptions, watch: Callable[[str], None] = lambda _: None) -> Iterator[list[MaterialTable]]:
    """Train and score every cell, a material and sensor in each worker process; yield all tables after each of them."""
    jobs = [(options, index, sensor) for index in range(len(options.materials)) for sensor in SENSORS]
    rows: dict[str, tuple[TableRow, ...]] = {}

    def add(index: int, more: tuple[TableRow, ...]) -> list[MaterialTable]:
        name = options.materials[index]
        known = rows.get(name, ())
        rows[name] = known + tuple(row for row in more if row.sensor or not known)
        return [MaterialTable(*item) for item in rows.items()]

    if options.workers <= 1:
        yield from (add(job[1], _measure_cells(*job, watch)) for job in jobs)
        return
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(_measure_cells, *job): job for job in jobs}
        for future in as_completed(futures):
            _, index, sensor = futures[future]
            watch(f"{options.materials[index]}, {sensor}")
            yield add(index, future.result())


def _measure_cells(
    options: TableOptions, index: int, sensor: str, watch: Callable[[str], None] = lambda _: None
) -> tuple[TableRow, ...]:
    """Measure the limits of a material, and every method with one sensor's token."""
    name, seed = options.materials[index], options.seed + 10 * index
    watch(f"{name}: the true process")
    strokes = _record_material(options, index)
    references = strokes.references
    rows = [
        TableRow(ORACLE_NAME, "", "", _score_signals([item.oracle[0] for item in references], references)),
        TableRow(BEST_NAME, "", "", _score_best(references)),
    ]
    tests = {
        False: [item.action for item in references],
        True: [record_by_load_cell(Recording(item.action, item.recording, RATE_HZ, name, name)) for item in references],
    }
    settings = options.others if index else options.first
    token = describe_sensor_tokens(name)[sensor]
    specimen = MaterialRecordings(name, strokes.recordings, token, strokes.mechanics, strokes.category)
    for label, told, raw, fit in _list_methods(options, settings, strokes.added):
        watch(f"{name}: {label}, {sensor}")
        start = time.monotonic()
        signals = fit(specimen, seed).render(tests[raw], seed + 1)
        scores = _score_signals(signals, references)
        rows.append(TableRow(label, told, SENSOR_LABELS[sensor], scores, time.monotonic() - start))
    return tuple(rows)


@dataclass(frozen=True)
class MaterialStrokes:
    """Test strokes of one material, the circles that everything learns, and what HNF+ learns in addition."""

    references: Sequence[Reference]
    recordings: tuple[Recording, ...]
    added: tuple[Recording, ...]
    mechanics: Mechanics
    category: str


@lru_cache(maxsize=1)
def _record_material(options: TableOptions, index: int) -> MaterialStrokes:
    """Simulate a material's strokes: once for both sensors where one process measures them in turn."""
    name, seed = options.materials[index], options.seed + 10 * index
    subject = make_subject(EvaluationJob("simulated", name, None, index, (), EvaluationSizes(), Budget(), seed))
    references = make_references(
        subject.process, _make_strokes(subject.limits, options.seconds, seed), 77 + seed, options.realisations, 1
    )
    recordings = tuple(map(with_raw_action, record_training_strokes(subject, "circular", TRAINING_S, seed)))
    added = tuple(map(with_raw_action, make_added_strokes(subject.process, recordings, seed)))
    return MaterialStrokes(references, recordings, added, subject.mechanics, subject.category)


def _list_methods(
    options: TableOptions, settings: Settings, added: tuple[Recording, ...]
) -> Iterable[tuple[str, str, bool, Callable[[MaterialRecordings, int], FittedMaterial]]]:
    """Yield name, settings in words, whether actions are raw, and the function that fits it."""
    from ..baselines.gacm import Gacm
    from ..baselines.published_hnf import PublishedHnf

    def fit_gacm(specimen: MaterialRecordings, seed: int) -> FittedMaterial:
        assert specimen.token is not None
        return Gacm(steps=options.gacm_steps).fit([specimen], seed).for_material(specimen.token, specimen.mechanics)

    yield "GACM (reconstruction)", f"{options.gacm_steps} steps", False, fit_gacm
    for raw, chosen in ((False, settings), (True, options.raw)):
        if chosen is None:
            continue
        config = FieldConfig.published(chosen.hidden)
        for label, more in (("HNF", ()), ("HNF+", added)):
            method = PublishedHnf(config, chosen.epochs, TRAINING_S, raw, more)
            yield label, f"{chosen.format_label()}{'; raw actions' if raw else ''}", raw, method.fit
    shared = select_entries(["shared"])[0].build(Budget())
    assert isinstance(shared, SharedField)
    yield "this project's shared field", "not trained on it", False, shared.fit


def _make_strokes(limits: ActionRange, seconds: float, seed: int) -> list[tuple[str, Action]]:
    """Return two new circles, and the steady stroke and sweep that nobody learns from."""
    circles = make_training_actions("circular", limits, 2.0 * seconds, 5000 + seed)[:2]
    trials = [trial for trial in make_trials(limits, seconds, seed) if trial.kind == "unseen"]
    count = len(trials[0].action.speed)
    cut = [_cut_action(action, count) for action in circles]
    return [*((f"circle {number}", action) for number, action in enumerate(cut, 1)),
            *((trial.name, trial.action) for trial in trials)]  # fmt: skip


def _cut_action(action: Action, count: int) -> Action:
    names = ("direction", "speed", "force", "position", "contact")
    return replace(action, **{name: getattr(action, name)[:count] for name in names})


def _score_signals(signals: Sequence[Float], references: Sequence[Reference]) -> dict[str, float]:
    rows = []
    for signal, reference in zip(signals, references, strict=True):
        recording, magnitude = reference.recording, window_magnitudes(signal)
        mse = float(np.mean(np.square(magnitude - window_magnitudes(recording))))
        density = welch(signal, RATE_HZ)[1]
        rows.append({
            "st_sim_cosine": st_sim_cosine(signal, recording).combined,
            "st_sim_tum": st_sim_tum(signal, recording, RATE_HZ),
            "lsd_log10": lsd_log10_magnitude(magnitude, window_magnitudes(recording)),
            "mse": mse,
            "mse_oracle": mse / reference.limits[0].oracle,
            "distance_db": average_spectrum_distance_db(density, reference.density, FREQUENCY_HZ),
        })  # fmt: skip
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def _score_best(references: Sequence[Reference]) -> dict[str, float]:
    """Score the process's own mean magnitude, which is no signal and so has no waveform to compare."""
    rows = []
    for reference in references:
        recorded, mean = window_magnitudes(reference.recording), reference.limits[0].mean_magnitude
        mse = float(np.mean(np.square(mean - recorded)))
        rows.append((lsd_log10_magnitude(mean, recorded), mse, mse / reference.limits[0].oracle))
    return dict(zip(("lsd_log10", "mse", "mse_oracle"), np.mean(rows, axis=0).tolist(), strict=True))


def format_tables(tables: Sequence[MaterialTable]) -> str:
    """Format the tables as Markdown, one per material, in the paper's columns."""
    sensors = tuple(SENSOR_LABELS[sensor] for sensor in SENSORS)
    header = ("method", "settings", *(f"{sensor} {label}" for sensor in sensors for label, _ in METRICS.values()))
    lines = ["# The paper's second table", ""]
    for table in tables:
        cells = {(row.method, row.settings, row.sensor): row for row in table.rows}
        body = []
        for method, settings in dict.fromkeys((row.method, row.settings) for row in table.rows):
            found = [cells.get((method, settings, sensor)) or cells.get((method, settings, "")) for sensor in sensors]
            body.append((
                method, settings or "–",
                *(format(row.scores[name], form) if row and name in row.scores else "–"
                  for row in found for name, (_, form) in METRICS.items()),
            ))  # fmt: skip
        lines += [f"## {table.material}", "", *format_table(header, body), ""]
    return "\n".join(lines)


def to_json(tables: Sequence[MaterialTable], options: TableOptions) -> dict[str, object]:
    """Return options and rows as JSON-serialisable values."""
    return {"options": asdict(options), "tables": [asdict(table) for table in tables]}
