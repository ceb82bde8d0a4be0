"""The complete evaluation: columns by kind of data, extra tables, plots, and notes on what was omitted.

`run_evaluation` is the entry point. It evaluates materials in worker processes, adds the tables on held-out classes,
sensors and directions, and writes eval.md, eval.json and plots.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from dataclasses import field as default
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from hnf_core.action.synthetic_actions import make_random_smooth_action
from hnf_core.datasets.recording import DataSet
from hnf_core.datasets.registry import open_dataset
from hnf_core.datasets.simulated import SimulatedLibrary
from hnf_core.field.field import Field
from hnf_core.field.weights import HELD_OUT_WEIGHTS, load_field
from hnf_core.files import write_text

from .held_out import find_held_out_names, make_held_out_table, measure_known_material
from .materials import BRIDGED, DirectionSpectra, EvaluationJob, EvaluationSizes, JobResult, make_column, run_jobs
from .methods import Budget, select_entries
from .plots import plot_directions, plot_spectra
from .report import Cell, Column, ExtraTable, Report, format_report, summarise

SENSOR_LABELS = {"gelsight": "GelSight", "digit": "DIGIT"}
SENSOR_METRICS = {
    "st_sim_tum": "ST-SIM TUM ↑",
    "st_sim_cosine": "ST-SIM cosine ↑",
    "lsd_log10": "LSD log10 ↓",
    "mse": "MSE ↓",
    "mse_oracle": "MSE / oracle ↓",
    "distance_db": "average spectrum [dB] ↓",
}
"""Metric → column header of the sensor table."""


def make_sensor_table(results: Sequence[JobResult]) -> ExtraTable:
    """Build the paper's table: the shared field with tokens of each sensor.

    Without a shared space, the row of bridged tokens says so.
    """
    cells: dict[str, list[Cell]] = {}
    for result in results:
        for sensor, sensor_cells in result.sensors.items():
            cells.setdefault(sensor, []).extend(sensor_cells)
    figures = {sensor: summarise(sensor_cells) for sensor, sensor_cells in cells.items()}
    rows = [
        (SENSOR_LABELS.get(sensor, sensor), *(f"{summary[name]['median']:.3g}" for name in SENSOR_METRICS))
        for sensor, summary in figures.items()
    ]
    if BRIDGED not in figures:
        rows.append((BRIDGED, "needs --space FILE", *["–"] * (len(SENSOR_METRICS) - 1)))
    return ExtraTable(
        "token_source",
        "Token source (shared field, held-out windows)",
        "The paper's columns. Token = E of each sensor's image, by its optics model, of one and the same height map. "
        "Neither sensor is noisy, and E undoes the optics: they can differ only where the gels do. Predicted map: "
        "of D_φ, from a lit photograph of the same heights. Bridged: of GelSight tuples that the DIGIT's image finds.",
        ("token from", *SENSOR_METRICS.values()),
        tuple(rows),
        figures,
    )


def make_direction_table(measured: DirectionSpectra, names: Mapping[str, str]) -> ExtraTable:
    """Build the table of level-ratio errors by direction. names: method key → label."""
    errors = {key: measured.compute_ratio_error_db(key) for key in measured.methods}
    return ExtraTable(
        "direction",
        f"By direction: {measured.material}",
        f"Eight directions over half a circle, steady; {measured.compute_anisotropy_db():.1f} dB of anisotropy. RMS "
        f"error of "
        "the level ratio of each direction's spectrum to the first one's.",
        ("method", "ratio error [dB]"),
        tuple((names.get(key, key), f"{value:.2f}") for key, value in errors.items()),
        {"material": measured.material, "anisotropy_db": measured.compute_anisotropy_db(), "ratio_error_db": errors},
    )


SIMULATED_MATERIALS = ("sandstone", "denim", "brushed-metal")
"""One rough, one woven, and one material whose spectra by direction are plotted."""
HATT_MATERIALS = ("ABS Plastic", "Brick 1", "Cork")
"""HaTT materials that are evaluated first."""
QUICK_SIZES = EvaluationSizes(2.0, 8, 1, 20.0, 1, 1, 3, 6)
HELD_OUT_DRAWS, KNOWN_DRAWS = 12, 2
"""Realisations behind a long-run spectrum in table (c): 48 s for a held-out class, 8 s for a known one."""


@dataclass(frozen=True)
class EvaluationOptions:
    """Options of an evaluation.

    Attributes
    ----------
    keys
        Keys of the methods; None = all.
    hatt
        Folder of the user's HaTT copy, or None.
    budget
        Training budget and weights of the shared field; without weights the shipped ones are used.
    workers
        Number of worker processes.
    space
        File of a shared space for bridged tokens, or None.
    """

    out: Path
    sizes: EvaluationSizes = default(default_factory=EvaluationSizes)
    budget: Budget = default(default_factory=Budget)
    keys: tuple[str, ...] | None = None
    hatt: Path | None = None
    seed: int = 0
    workers: int = 2
    space: Path | None = None
    simulated: tuple[str, ...] = SIMULATED_MATERIALS


def run_evaluation(options: EvaluationOptions, watch: Callable[[str], None] = lambda _: None) -> Report:
    """Evaluate, and write eval.md, eval.json and plots to options.out.

    Parameters
    ----------
    options
        Data, methods, sizes and output folder.
    watch
        Progress callback; receives the name of the current step.

    Returns
    -------
    Report
        All results.

    Raises
    ------
    HnfError
        For errors that the user can correct: unknown methods, a folder without textures, unreadable weights.
    """
    entries = select_entries(options.keys)
    hatt = None if options.hatt is None else open_dataset("hatt", options.hatt)
    field = load_field(options.budget.weights)
    timings: dict[str, float] = {}
    with _Timer(timings, "materials"):
        results = list(run_jobs(_make_jobs(options, hatt), options.workers, watch))
    simulated = [result for result in results if result.job.kind == "simulated"]
    recorded = [result for result in results if result.job.kind == "hatt"]
    notes = [note for result in results for note in result.result.notes]
    columns = _make_columns(options, simulated, recorded)
    extras = [make_sensor_table(simulated)] if any(result.sensors for result in simulated) else []
    extras += [
        make_direction_table(result.directions, _collect_names(columns))
        for result in simulated
        if result.directions is not None
    ]
    with _Timer(timings, "held-out classes"):
        watch("held-out classes")
        held_out_table = _make_held_out_table(options, None if options.budget.weights is None else field)
        notes += [held_out_table] if isinstance(held_out_table, str) else []
        extras += [held_out_table] if isinstance(held_out_table, ExtraTable) else []
    if hatt is None:
        notes.append("(d) HaTT: no folder was given (--hatt DIR).")
    settings = {**asdict(options.sizes), "seed": options.seed, "field": field.identity,
                "methods": " ".join(entry.key for entry in entries)}  # fmt: skip
    report = Report(settings, tuple(columns), tuple(extras), tuple(notes), timings)
    _write_report(report, results, options.out)
    return report


class _Timer:
    def __init__(self, timings: dict[str, float], name: str) -> None:
        self._timings, self._name, self._began = timings, name, time.monotonic()

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None:
        self._timings[self._name] = time.monotonic() - self._began


def _make_jobs(options: EvaluationOptions, hatt: DataSet | None) -> list[EvaluationJob]:
    keys = tuple(entry.key for entry in select_entries(options.keys))

    def job(kind: str, name: str, index: int, directions: bool = False) -> EvaluationJob:
        return EvaluationJob(
            kind,
            name,
            options.hatt,
            index,
            keys,
            options.sizes,
            options.budget,
            options.seed + 10 * index,
            directions,
            options.space,
        )

    names = options.simulated[-options.sizes.simulated :]
    jobs = [job("simulated", name, index, name == names[-1]) for index, name in enumerate(names)]
    if hatt is not None:
        known = [name for name in HATT_MATERIALS if name in hatt.materials]
        rest = [name for name in hatt.materials if name not in known]
        jobs += [
            job("hatt", name, len(jobs) + index) for index, name in enumerate([*known, *rest][: options.sizes.hatt])
        ]
    return jobs


def _make_columns(
    options: EvaluationOptions, simulated: Sequence[JobResult], recorded: Sequence[JobResult]
) -> list[Column]:
    keys = tuple(entry.key for entry in select_entries(options.keys))

    def build(key: str, title: str, description: str, kinds: Sequence[str], results: Sequence[JobResult]) -> Column:
        names = ", ".join(result.job.name for result in results)
        note = f"{names}. {description} Methods learned from {options.sizes.training_s:g} s of each material."
        return make_column(
            key, title, note, kinds, [result.result for result in results], select_entries(keys), options.budget
        )

    columns = []
    if simulated:
        columns += [
            build("windows", "(a) Simulated, held-out windows", "New stretches of wandering strokes.", ["window"],
                 simulated),
            build("unseen", "(b) Simulated, unseen kinds of stroke", "A steady stroke and a speed sweep, kinds that no "
                 "method learned from.", ["unseen"], simulated),
        ]  # fmt: skip
    if recorded:
        columns.append(
            build("hatt", "(d) HaTT texture models", "Wandering, steady and sweeping strokes. AR is the true model "
                 "class here, and direction does not exist.", ["window", "unseen"], recorded)
        )  # fmt: skip
    return columns


def _make_held_out_table(options: EvaluationOptions, field: Field | None) -> ExtraTable | str:
    """Build table (c) for the user's own weights, or for the shipped held-out weights if `field` is None."""
    if field is None:
        if not HELD_OUT_WEIGHTS.is_file():
            return f"(c) Held-out classes: {HELD_OUT_WEIGHTS.name} is not part of the Blender extension."
        field = load_field(HELD_OUT_WEIGHTS)
    library = SimulatedLibrary()
    names = find_held_out_names(field, library.materials)[: options.sizes.held_out]
    if len(names) < 2:
        return (
            "(c) Held-out classes: the weights name no classes that were kept from training "
            '(metadata "held_out", a JSON list). Without --weights, the field that was trained so is asked.'
        )
    all_held_out = set(find_held_out_names(field, library.materials))
    limits = library.action_range(names[0])
    action = make_random_smooth_action(
        options.sizes.seconds, 4242 + options.seed, speed_m_s=limits.speed_m_s, force_n=limits.force_n
    )
    sizes = options.sizes
    others = [name for name in library.materials if name not in all_held_out][: sizes.known]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        held_out_futures = [
            pool.submit(
                measure_known_material,
                name,
                action,
                min(sizes.realisations, HELD_OUT_DRAWS),
                sizes.renders,
                options.seed,
            )
            for name in names
        ]
        known_futures = [
            pool.submit(measure_known_material, name, action, KNOWN_DRAWS, 0, options.seed) for name in others
        ]
        return make_held_out_table(
            field,
            action,
            [future.result() for future in held_out_futures],
            [future.result() for future in known_futures],
            options.seed,
        )


def _collect_names(columns: Sequence[Column]) -> dict[str, str]:
    return {row.key: row.name for column in columns for row in column.rows if row.form == "natural"}


def _write_report(report: Report, done: Sequence[JobResult], out: Path) -> None:
    names = _collect_names(report.columns)
    names.pop("oracle", None)
    lines = [format_report(report), "## Pictures", ""]
    for kind, key, title in (
        ("window", "simulated", "Simulated, held-out windows"),
        ("unseen", "simulated", "Simulated, unseen kinds of stroke"),
        ("unseen", "hatt", "HaTT, unseen kinds of stroke"),
    ):
        material_results = [result.result for result in done if result.job.kind == key]
        if material_results:
            plot_path = out / f"spectra-{key}-{kind}.png"
            plot_spectra(plot_path, material_results, kind, names, title)
            lines += [f"![{title}]({plot_path.name})", ""]
    for result in done:
        if result.directions is not None:
            plot_path = out / f"directions-{result.job.name}.png"
            plot_directions(plot_path, result.directions, names)
            lines += [f"![By direction]({plot_path.name})", ""]
    write_text(out / "eval.json", json.dumps(report.to_json(), indent=1, default=_to_json_value) + "\n")
    write_text(out / "eval.md", "\n".join(lines))


def _to_json_value(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    return str(value)
