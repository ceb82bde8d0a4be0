"""Bench of synthesis: one stroke of ten seconds by every method, with time, memory and error.

The reference is the literal model: F_Θ and every carrier at each of 10,000 samples per second, in float64. Methods run
in turn, round by round, so that changes of the machine's speed affect all alike. Some methods exist only here: F_Θ at
every sample in float32, F_Θ's layers in bfloat16, F_Θ from a table over direction, speed and force, and, as another
model, HaTT's piecewise autoregression with made-up parameters of the same size.

The table stores only the network's outputs, while linear contact is computed at each state, since it has tones and
edges. Values are interpolated linearly in the angle, log v and log F. At the shipped width H = 256 the network takes a
quarter of a state's time, and the table needs more evaluations than a stroke has states.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from data_tools.bench_strokes import clear_carrier_caches, make_keyed_stroke
from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.datasets.hatt_models import HattProcess, TextureModel
from hnf_core.errors import UsageError
from hnf_core.field.adaptive_sampling import (
    BATCH_SAMPLES,
    DEFAULT_TOLERANCE,
    EvaluateAt,
    SampledEmission,
    interpolate_rows,
)
from hnf_core.field.carrier_rendering import render_carriers_full_rate
from hnf_core.field.carriers import MODEL_RATE_HZ
from hnf_core.field.field import Emission, Evaluator, Field, evaluate, get_network
from hnf_core.field.linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition
from hnf_core.field.noise_cache import prefetch_noise
from hnf_core.field.prepare import follow_stroke, make_evaluate_at, prepare_sampled
from hnf_core.field.render import render_contact, render_samples
from hnf_core.field.stroke import StrokeInput, resample_action, sample_count
from hnf_core.field.synthesis import render_stroke
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import load_kernel, without_kernel
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import BAND_FEATURES, BAND_WAVELENGTHS_M
from reference.every_state import prepare_every_state
from reference.literal_synthesis import synthesise_reference

from .harness import BenchOptions, Row, Times, measure_peak_mb

Float = NDArray[np.float64]
Index = NDArray[np.int64]

AR_ORDER = 19
AR_SPEEDS, AR_FORCES = 7, 5
"""Grid of the made-up model, 35 vertices and 48 triangles; HaTT's medians are order 19, 34 and 43."""
MAX_SPEED_M_S, MAX_FORCE_N = 0.22, 4.2
AR_VARIANCE = 0.01
_LSF_STRAY, _LSF_SHIFT_RAD = 0.3, 0.7
"""Largest deviation of LSFs, relative to their even spacing, and phase [rad] from one vertex to the next."""


def synthesise_autoregressive(action: Action, seed: int) -> Float:
    """Return a(t) at 10 kHz of a made-up texture, by HaTT's rule (hatt_models)."""
    return HattProcess(make_texture_model()).record([action], seed)[0].samples


def make_texture_model() -> TextureModel:
    """Make a model on a grid of speed and force; vertices on the axes are silent, as in HaTT."""
    speed, force = (
        grid.ravel()
        for grid in np.meshgrid(
            np.linspace(0.0, MAX_SPEED_M_S, AR_SPEEDS), np.linspace(0.0, MAX_FORCE_N, AR_FORCES), indexing="ij"
        )
    )
    even = np.pi * np.arange(1, AR_ORDER + 1) / (AR_ORDER + 1)
    deviation = np.sin(2.0 * np.arange(AR_ORDER) + _LSF_SHIFT_RAD * np.arange(len(speed))[:, None])
    return TextureModel(
        material="made up", source="hnf bench", sample_rate=10_000.0, speeds=speed, forces=force,
        triangles=_make_triangles(), ar_lsf=even + _LSF_STRAY * np.pi / (AR_ORDER + 1) * deviation,
        ma_lsf=np.zeros((len(speed), 0)),
        variances=AR_VARIANCE * (speed * force > 0.0), gains=np.ones(len(speed)), friction=None,
        max_speed=MAX_SPEED_M_S, max_force=MAX_FORCE_N,
    )  # fmt: skip


def _make_triangles() -> Index:
    """Return two triangles in each cell of the grid."""
    index = np.arange(AR_SPEEDS * AR_FORCES).reshape(AR_SPEEDS, AR_FORCES)
    a, b, c, d = (corner.ravel() for corner in (index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]))
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])


def has_bfloat16() -> bool:
    """Return True if torch is installed."""
    return importlib.util.find_spec("torch") is not None


def evaluate_in_bfloat16(model: Field, condition: Condition) -> Emission:
    """Evaluate like evaluate(), with F_Θ's layers and heads in bfloat16."""
    from .bfloat16 import evaluate_heads_bfloat16

    return evaluate(model, condition, partial(evaluate_heads_bfloat16, model.parameters, model.config.layers))


def synthesise_every_sample(field: Field, stroke: StrokeInput, seed: int) -> Float:
    """Return (count,) [m/s²] with F_Θ evaluated at every sample.

    Past states are samples that were already evaluated; carriers are those of the other methods, prefetched alike.
    """
    action, token_index = resample_action(stroke)
    with prefetch_noise(field.config, seed, action):
        evaluate_at = make_evaluate_at(field, stroke, action, token_index)
        sampled = _sample_every(evaluate_at, sample_count(action))
        course = follow_stroke(field, stroke, action, token_index, seed)
        prepared = prepare_sampled(field, stroke, seed, action, token_index, sampled, course)
    return render_samples(prepared)


def _sample_every(evaluate_at: EvaluateAt, count: int) -> SampledEmission:
    """Sample the emissions at each of 0 … count, instead of sample_adaptively, which skips most."""
    positions, alpha, sigma_dt = np.arange(count + 1), [], []
    for start in range(0, len(positions), BATCH_SAMPLES):
        emission = evaluate_at(positions[start : start + BATCH_SAMPLES])
        alpha.append(emission.alpha[:, 0].astype(np.float32))
        sigma_dt.append(emission.sigma_dt)
    return SampledEmission(positions, np.concatenate(alpha), np.concatenate(sigma_dt), 0.0)


Float32 = NDArray[np.float32]
Integers = NDArray[np.int64]

SPEEDS_M_S = (SPEED_FLOOR_M_S, 1.024)
FORCES_N = (FORCE_FLOOR_N, 5.12)
"""Ranges of the table; values outside are clamped."""
TABLE_BATCH = 512
_ISOTROPY_TOLERANCE = 1e-6


@dataclass(frozen=True)
class TableGrid:
    """Size of a table: directions per half turn (one for an isotropic material), points per octave."""

    directions: int = 8
    per_octave_speed: int = 64
    per_octave_force: int = 4


@dataclass(frozen=True)
class FieldTable:
    """Tabulated outputs of F_Θ for one material.

    Attributes
    ----------
    values
        (D, V, F, outputs) float32, of the α head and then the σ head.
    angle_step
        Angle between directions, from 0 [rad]; the table is periodic.
    speed, force
        Log of the first point, and step of the log.
    outputs
        Number of outputs of the α head.
    """

    values: Float32
    angle_step: float
    speed: tuple[float, float]
    force: tuple[float, float]
    outputs: int

    @property
    def megabytes(self) -> float:
        return self.values.nbytes / 1e6


def tabulate_field(
    model: Field, token: Float32, mechanics: Mechanics, probe: str, grid: TableGrid = TableGrid()
) -> FieldTable:
    """Evaluate the network over the grid. Raises UsageError for a field without one log-amplitude head."""
    config = model.config
    if config.emission != "log" or config.alpha_heads != 1:
        raise UsageError("a table needs one head that gives log amplitudes.", remedy="Evaluate the field instead.")
    turn = np.pi if config.stroke_frame or not config.directed else 2.0 * np.pi
    count = 1 if _is_isotropic(token) else grid.directions * round(turn / np.pi)
    speed, force = _make_axis(SPEEDS_M_S, grid.per_octave_speed), _make_axis(FORCES_N, grid.per_octave_force)
    angles = np.arange(count) * turn / count
    d, v, f = (grid_points.ravel() for grid_points in np.meshgrid(angles, speed, force, indexing="ij"))
    network = get_network(model)
    rows = np.empty((len(d), config.alpha_outputs + config.states), dtype=np.float32)
    for low in range(0, len(d), TABLE_BATCH):
        rows_of_batch = slice(low, low + TABLE_BATCH)

        def record_outputs(x: Float32, rows_of_batch: slice = rows_of_batch) -> tuple[Float32, Float32]:
            outputs = network(x)
            rows[rows_of_batch] = np.concatenate(outputs, axis=1)
            return outputs

        evaluate(
            model,
            _make_conditions(token, mechanics, probe, d[rows_of_batch], v[rows_of_batch], f[rows_of_batch]),
            record_outputs,
        )
    return FieldTable(
        rows.reshape(count, len(speed), len(force), -1),
        turn / count,
        (float(np.log(speed[0])), float(np.log(speed[1] / speed[0]))),
        (float(np.log(force[0])), float(np.log(force[1] / force[0]))),
        config.alpha_outputs,
    )


def evaluate_table(table: FieldTable, model: Field, condition: Condition) -> Emission:
    """Evaluate F_Θ at n states of the table's material with the table instead of the network."""
    rows = interpolate_table(table, condition)
    return evaluate(model, condition, (rows[:, : table.outputs], rows[:, table.outputs :]))


def interpolate_table(table: FieldTable, condition: Condition) -> Float32:
    """Return the (n, outputs) interpolated outputs of both heads at n states."""
    directions, speeds, forces, width = table.values.shape
    rows: list[tuple[Integers, Float]] = [
        (np.zeros(len(condition.speed), dtype=np.int64), np.ones(len(condition.speed)))
    ]
    if directions > 1:
        angle = np.arctan2(condition.direction[:, 1], condition.direction[:, 0]) / table.angle_step
        low = np.floor(angle).astype(np.int64)
        rows = [(low % directions, 1.0 - (angle - low)), ((low + 1) % directions, angle - low)]
    (speed, speed_weight), (force, force_weight) = (
        _locate(np.log(np.maximum(values, floor)), count, *axis)
        for count, values, floor, axis in (
            (speeds, condition.speed, SPEED_FLOOR_M_S, table.speed),
            (forces, condition.force, FORCE_FLOOR_N, table.force),
        )
    )
    both = ((speed, 1.0 - speed_weight), (speed + 1, speed_weight))
    corners = [
        ((d * speeds + v) * forces + force, direction_weight * axis_weight)
        for d, direction_weight in rows
        for v, axis_weight in both
    ]
    row, factor = (np.stack(corner, axis=1) for corner in zip(*corners, strict=True))
    return interpolate_rows(
        table.values.reshape(-1, width), row, np.repeat(force_weight[:, None], len(corners), axis=1), factor
    )


def _locate(log: Float, count: int, start: float, step: float) -> tuple[Integers, Float]:
    """Return the point of an axis before each number (n,), and the fraction of the way to the next."""
    position = np.clip((log - start) / step, 0.0, count - 1)
    low = np.minimum(position.astype(np.int64), count - 2)
    return low, position - low


def _make_conditions(
    token: Float32, mechanics: Mechanics, probe: str, angle: Float, speed: Float, force: Float
) -> Condition:
    count = len(angle)
    return Condition(
        np.tile(np.asarray(token, dtype=np.float64), (count, 1)), (mechanics,), np.zeros(count, dtype=np.int32),
        np.stack([np.cos(angle), np.sin(angle)], axis=1), speed, force, np.ones(count, dtype=bool), probe,
    )  # fmt: skip


def _make_axis(ends: tuple[float, float], per_octave: int) -> Float:
    return np.geomspace(*ends, round(per_octave * np.log2(ends[1] / ends[0])) + 1)


def _is_isotropic(token: Float32) -> bool:
    """Return True if no directional moment and no tone distinguishes directions."""
    bands = np.asarray(token)[: len(BAND_WAVELENGTHS_M) * len(BAND_FEATURES)].reshape(-1, len(BAND_FEATURES))
    moments = [BAND_FEATURES.index(name) for name in ("cos2", "sin2", "cos4", "sin4", "peak")]
    return bool(np.all(np.abs(bands[:, moments]) < _ISOTROPY_TOLERANCE))


SYNTH_NAME = "synth"
MATERIAL_NAME = "leather"
STROKE_S, QUICK_STROKE_S = 10.0, 0.3
WIDE_HIDDEN = 1024
WINDOWS, WINDOW = 5, 500
"""Segments of the stroke in which the literal model is timed, and samples of each."""
TOLERANCES_DB = (-30.0, -35.0, -40.0, -50.0)
CACHED_DB = (-35.0, -40.0)
TABLE_TOLERANCE = 10.0 ** (-32.5 / 20.0)
"""Tolerance of adaptive sampling with which the total error is −40 dB."""
SEED = 11
EVERY_STATE = "every state"
"""Method to which the others' times are compared."""


@dataclass(frozen=True)
class SynthMethod:
    """A method of synthesis.

    Attributes
    ----------
    render
        Function that returns the complete signal (count,) [m/s²].
    is_cold
        True if carriers are not in the cache.
    has_error
        True if it should give the reference's signal.
    share
        Fraction of the signal that is rendered if all of it would take too long; times are scaled to all of it.
    """

    name: str
    render: Callable[[Field, StrokeInput, int], Float]
    is_cold: bool = True
    note: str = ""
    has_error: bool = True
    share: float = 1.0


def measure_synth(options: BenchOptions) -> list[Row]:
    """Measure each method on the shipped field widened to H = 1024, which is the same function."""
    shipped, stroke = load_field(), make_keyed_stroke(QUICK_STROKE_S if options.quick else STROKE_S)
    field = shipped if options.quick else widen_field(shipped, WIDE_HIDDEN)
    options.watch(f"{SYNTH_NAME}: the reference, a minute")
    # The same function with a quarter of the units. The complete stroke counts: most errors occur where a hand stops.
    reference = synthesise_reference(_to_float64(shipped), stroke, seed=SEED, count=sample_count(stroke.action))
    methods, errors = [_make_literal_method(field, stroke), *_make_methods(field, stroke)], []
    for method in methods:  # first, so that libraries are initialised before anything is timed
        options.watch(f"{SYNTH_NAME}: {method.name}, error")
        errors.append(_compute_error_db(method.render(field, stroke, SEED), reference) if method.has_error else None)
    times = _time_in_turn(methods, field, stroke, options)
    return [_make_row(*each, times, field, stroke) for each in zip(methods, errors, strict=True)]


def _make_literal_method(field: Field, stroke: StrokeInput) -> SynthMethod:
    """Return the literal method at full width. Each round uses another segment of the stroke."""
    exact, count = _to_float64(field), sample_count(stroke.action)
    starts = np.linspace(0, count - WINDOW, WINDOWS).astype(int).tolist()

    def render(_: Field, stroke: StrokeInput, seed: int) -> Float:
        start = starts[(seed - SEED) % WINDOWS]
        return synthesise_reference(exact, stroke, seed=SEED, start=start, count=WINDOW)

    note = f"the reference; 50 ms a round, its times told for all {count / MODEL_RATE_HZ:.3g} s"
    return SynthMethod("literal, float64", render, note=note, has_error=False, share=WINDOW / count)


def _compute_error_db(samples: Float, wanted: Float) -> float:
    return float(10.0 * np.log10(np.mean(np.square(samples - wanted)) / np.mean(np.square(wanted))))


def _to_float64(field: Field) -> Field:
    return replace(field, parameters={name: value.astype(np.float64) for name, value in field.parameters.items()})


def _time_in_turn(
    methods: list[SynthMethod], field: Field, stroke: StrokeInput, options: BenchOptions
) -> dict[str, Times]:
    """Return the times of each method, one per round, of all threads, since F_Θ has threads of its own."""
    times = {method.name: Times(time.process_time) for method in methods}
    for number in range(1, options.repeats + 1):
        options.watch(f"{SYNTH_NAME}: round {number} of {options.repeats}")
        for method in methods:
            _prepare_caches(method, field, stroke)
            times[method.name].measure(partial(method.render, field, stroke, SEED + number * method.is_cold))
    return {method.name: times[method.name].scale(1.0 / method.share) for method in methods}


def _prepare_caches(method: SynthMethod, field: Field, stroke: StrokeInput) -> None:
    """Clear the caches of other methods, and fill those of a method that is not cold."""
    clear_carrier_caches()
    if not method.is_cold:
        method.render(field, stroke, SEED)


def _make_row(
    method: SynthMethod, error: float | None, times: dict[str, Times], field: Field, stroke: StrokeInput
) -> Row:
    method_times, seconds = times[method.name], (len(stroke.action.speed) - 1) / ACTION_RATE_HZ
    _prepare_caches(method, field, stroke)
    row = Row(
        SYNTH_NAME, method.name, method_times.seconds, method_times.cpu, error=error, error_unit="dB", note=method.note,
        peak_mb=measure_peak_mb(partial(method.render, field, stroke, SEED)),
        realtime_factor=seconds / method_times.seconds.median,
    )  # fmt: skip
    if method.name == EVERY_STATE:
        return row
    return replace(row, ratio=method_times.compute_ratio(times[EVERY_STATE]), ratio_to=EVERY_STATE)


def _make_methods(field: Field, stroke: StrokeInput) -> list[SynthMethod]:
    def render_plain(field: Field, stroke: StrokeInput, seed: int) -> Float:
        prepared = prepare_every_state(field, stroke, seed=seed)
        texture = render_carriers_full_rate(
            prepared.amplitude, prepared.carriers, seed, prepared.action, 0, prepared.count
        )
        return np.asarray(prepared.audible * (texture + render_contact(prepared, 0, prepared.count)))

    def render_every_state(field: Field, stroke: StrokeInput, seed: int, evaluator: Evaluator = evaluate) -> Float:
        with prefetch_noise(field.config, seed, resample_action(stroke)[0]):
            prepared = prepare_every_state(field, stroke, seed=seed, evaluator=evaluator)
        return render_samples(prepared)

    def render_within(tolerance_db: float, field: Field, stroke: StrokeInput, seed: int) -> Float:
        return render_stroke(field, stroke, seed, 10.0 ** (tolerance_db / 20.0))[1]

    material = stroke.tokens[0], stroke.mechanics[0], stroke.action.probe
    table = tabulate_field(field, *material, TableGrid() if len(stroke.action.speed) > 1000 else TableGrid(4, 1, 1))

    def render_from_table(field: Field, stroke: StrokeInput, seed: int) -> Float:
        read_table = partial(evaluate_table, table)
        return render_stroke(field, stroke, seed, TABLE_TOLERANCE, read_table)[1]

    def render_bfloat16(field: Field, stroke: StrokeInput, seed: int) -> Float:
        return render_every_state(field, stroke, seed, evaluate_in_bfloat16)

    bfloat16 = SynthMethod("every state, bfloat16", render_bfloat16, note="F_Θ's layers, by torch; the rest as it is")

    def render_autoregressive(_: Field, stroke: StrokeInput, seed: int) -> Float:
        return synthesise_autoregressive(stroke.action, seed)

    def render_without_kernel(tolerance_db: float | None, field: Field, stroke: StrokeInput, seed: int) -> Float:
        with without_kernel():
            if tolerance_db is None:
                return render_every_state(field, stroke, seed)
            return render_within(tolerance_db, field, stroke, seed)

    default_db = round(20.0 * np.log10(DEFAULT_TOLERANCE))
    notes = {default_db: "what scenes and previews use"}
    adaptive = [
        SynthMethod(f"within {db:g} dB", partial(render_within, db), note=notes.get(db, "F_Θ where the action asks"))
        for db in TOLERANCES_DB
    ]
    cached = [
        SynthMethod(
            f"within {db:g} dB, carriers kept",
            partial(render_within, db),
            is_cold=False,
            note="the same stroke once more",
        )
        for db in CACHED_DB
    ]
    numpy_methods = [
        SynthMethod(
            f"numpy: {EVERY_STATE}", partial(render_without_kernel, None), note="as on a Mac, without the kernel"
        ),
        *(
            SynthMethod(
                f"numpy: {db:g} dB, kept", partial(render_without_kernel, db), is_cold=False, note="without the kernel"
            )
            for db in CACHED_DB
        ),
    ]
    return [
        SynthMethod(
            "every sample, float32",
            synthesise_every_sample,
            note="F_Θ 10,000 times a second, as the model is written down",
        ),
        SynthMethod("every 0.5 ms", partial(render_within, float("-inf")), note="F_Θ 2000 times a second"),
        SynthMethod(
            "every state, plain carriers", render_plain, note="200 times a second, carriers band by band in float64"
        ),
        SynthMethod(EVERY_STATE, render_every_state, note="200 times a second"),
        *([bfloat16] if has_bfloat16() else []),
        *adaptive,
        *cached,
        SynthMethod(
            "from a table, carriers kept",
            render_from_table,
            is_cold=False,
            note=f"{table.megabytes:.0f} MB for one material",
        ),
        *(numpy_methods if load_kernel() is not None else []),
        SynthMethod(
            "piecewise AR (HaTT), a loop in numpy",
            render_autoregressive,
            note="another model: time only",
            has_error=False,
        ),
    ]


def widen_field(field: Field, hidden: int) -> Field:
    """Return the same function as a network of `hidden` units, a multiple of H, by splitting each unit equally."""
    parts, parameters = hidden // field.config.hidden, dict(field.parameters)
    for layer in range(field.config.layers):
        weight = np.repeat(parameters[f"layer{layer}.weight"], parts, axis=0)
        parameters[f"layer{layer}.weight"] = np.repeat(weight, parts, axis=1) / parts if layer else weight
        parameters[f"layer{layer}.bias"] = np.repeat(parameters[f"layer{layer}.bias"], parts)
    for head in ("alpha", "sigma"):
        parameters[f"{head}.weight"] = np.repeat(parameters[f"{head}.weight"], parts, axis=1) / parts
    single = {name: value.astype(np.float32) for name, value in parameters.items()}
    return replace(field, config=replace(field.config, hidden=hidden), parameters=single)
