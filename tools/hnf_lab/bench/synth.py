"""What another model's way of synthesis costs on the same stroke: HaTT's piecewise autoregression, sample by sample.

The model is made up, as large as HaTT's own: time does not follow its numbers, and no file of theirs is needed.

Synthesis with F_Θ's layers in bfloat16: measured here, and no way of the product.

Synthesis with F_Θ at each of the 10,000 samples a second, in float32: how the model is written down, and where every
faster way begins. Measured here, and no way of the product.

One material's F_Θ, tabulated over direction, speed and force: what the network answers, while what linear contact
expects is worked out at each state, since that is what has tones and edges. Measured here, and used nowhere: at the
H = 256 that is shipped the network is a quarter of a state's time, and the table costs more states than a stroke has.

Answers lie on a grid, linear in the direction's angle, log v and log F between its points. A direction is one of many
only where the material is the same in no two of them.

One stroke of ten seconds, synthesised in every way there is: how fast, how much memory, and how far from the model
taken literally (F_Θ and every carrier at each of 10,000 samples a second, in float64).

Methods are timed in turn, round by round, so that a machine whose pace changes is as fast for each of them.
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
from hnf_core.datasets.hatt_models import TextureModel
from hnf_core.datasets.hatt_synthesis import HattProcess
from hnf_core.errors import UsageError
from hnf_core.field.adaptive_sampling import BATCH_SAMPLES, EvaluateAt, SampledEmission, interpolate_rows
from hnf_core.field.carrier_rendering import render_carriers_full_rate
from hnf_core.field.carriers import MODEL_RATE_HZ
from hnf_core.field.field import Emission, Field, evaluate, get_network
from hnf_core.field.linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition
from hnf_core.field.noise_cache import prefetch_noise
from hnf_core.field.prepare import make_evaluate_at, prepare_sampled, prepare_stroke
from hnf_core.field.render import render_contact, render_samples
from hnf_core.field.stroke import StrokeInput, resample_action, sample_count
from hnf_core.field.synthesis import render_stroke
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import load_kernel, without_kernel
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import BAND_FEATURES, BAND_WAVELENGTHS_M
from reference.literal_synthesis import synthesise_reference

from .harness import BenchOptions, Row, Times, measure_peak_mb

Float = NDArray[np.float64]
Index = NDArray[np.int64]

AR_ORDER = 19
AR_SPEEDS, AR_FORCES = 7, 5
"""Medians of twenty of HaTT's models: order 19, 34 places, 43 triangles. Here 35 and 48."""
MAX_SPEED_M_S, MAX_FORCE_N = 0.22, 4.2
AR_VARIANCE = 0.01
_LSF_STRAY, _LSF_SHIFT_RAD = 0.3, 0.7
"""Of the gap between even LSFs, at most: how far they stray, so that no place sounds like its neighbour. Radians from a
place to the next."""


def synthesise_autoregressive(action: Action, seed: int) -> Float:
    """a(t) at 10 kHz of a made-up texture, by HaTT's rule (datasets.autoregressive)."""
    return HattProcess(make_texture_model()).record([action], seed)[0].samples


def make_texture_model() -> TextureModel:
    """Places on a grid of speed and force; those on the axes are silent, as HaTT's are."""
    speed, force = (
        each.ravel()
        for each in np.meshgrid(
            np.linspace(0.0, MAX_SPEED_M_S, AR_SPEEDS), np.linspace(0.0, MAX_FORCE_N, AR_FORCES), indexing="ij"
        )
    )
    even = np.pi * np.arange(1, AR_ORDER + 1) / (AR_ORDER + 1)
    stray = np.sin(2.0 * np.arange(AR_ORDER) + _LSF_SHIFT_RAD * np.arange(len(speed))[:, None])
    return TextureModel(
        material="made up", source="hnf bench", sample_rate=10_000.0, speeds=speed, forces=force,
        triangles=_make_triangles(), ar_lsf=even + _LSF_STRAY * np.pi / (AR_ORDER + 1) * stray,
        ma_lsf=np.zeros((len(speed), 0)),
        variances=AR_VARIANCE * (speed * force > 0.0), gains=np.ones(len(speed)), friction=None,
        max_speed=MAX_SPEED_M_S, max_force=MAX_FORCE_N,
    )  # fmt: skip


def _make_triangles() -> Index:
    """Two in each cell of the grid."""
    place = np.arange(AR_SPEEDS * AR_FORCES).reshape(AR_SPEEDS, AR_FORCES)
    a, b, c, d = (each.ravel() for each in (place[:-1, :-1], place[1:, :-1], place[:-1, 1:], place[1:, 1:]))
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])


def has_bfloat16() -> bool:
    """Is there a torch to compute in it?"""
    return importlib.util.find_spec("torch") is not None


def evaluate_in_bfloat16(model: Field, condition: Condition) -> Emission:
    """evaluate(), with every number of F_Θ's layers and heads in bfloat16."""
    from .bfloat16 import evaluate_heads_bfloat16

    return evaluate(model, condition, partial(evaluate_heads_bfloat16, model.parameters, model.config.layers))


def synthesise_every_sample(field: Field, stroke: StrokeInput, seed: int) -> Float:
    """(count,) m/s², of what adapts(). Past states are samples that were evaluated already; carriers are those of every
    other way, and drawn as early."""
    action, token_index = resample_action(stroke)
    with prefetch_noise(field.config, seed, action):
        evaluate_at = make_evaluate_at(field, stroke, action, token_index)
        sampled = _sample_every(evaluate_at, sample_count(action))
        prepared = prepare_sampled(field, stroke, seed, action, token_index, sampled)
    return render_samples(prepared)


def _sample_every(evaluate_at: EvaluateAt, count: int) -> SampledEmission:
    """Sample the emissions at each of 0 … count, for sample_adaptively, which leaves out most."""
    at, alpha, sigma_dt = np.arange(count + 1), [], []
    for start in range(0, len(at), BATCH_SAMPLES):
        emission = evaluate_at(at[start : start + BATCH_SAMPLES])
        alpha.append(emission.alpha[:, 0].astype(np.float32))
        sigma_dt.append(emission.sigma_dt)
    return SampledEmission(at, np.concatenate(alpha), np.concatenate(sigma_dt), 0.0)


Float32 = NDArray[np.float32]
Integers = NDArray[np.int64]

SPEEDS_M_S = (SPEED_FLOOR_M_S, 1.024)
FORCES_N = (FORCE_FLOOR_N, 5.12)
"""Beyond them the nearest is read."""
TABLE_BATCH = 512
_ISOTROPY_TOLERANCE = 1e-6


@dataclass(frozen=True)
class TableGrid:
    """Points of a table: directions over the half turn (those of an isotropic material are one), speeds and forces per
    octave."""

    directions: int = 8
    per_octave_speed: int = 64
    per_octave_force: int = 4


@dataclass(frozen=True)
class FieldTable:
    """values: (D, V, F, outputs) float32, what the α head answers and then the σ head. angle_step: radians between
    directions, whose first is 0; the table repeats after the last. speed, force: log of the first point and step of the
    log. outputs: of the α head."""

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
    """Ask the network all over the grid. Raises UsageError for a field whose α is not an exponential of one head."""
    config = model.config
    if config.emission != "log" or config.alpha_heads != 1:
        raise UsageError("a table needs one head that gives log amplitudes.", remedy="Evaluate the field instead.")
    turn = np.pi if config.stroke_frame or not config.directed else 2.0 * np.pi
    count = 1 if _is_isotropic(token) else grid.directions * round(turn / np.pi)
    speed, force = _make_axis(SPEEDS_M_S, grid.per_octave_speed), _make_axis(FORCES_N, grid.per_octave_force)
    angles = np.arange(count) * turn / count
    d, v, f = (each.ravel() for each in np.meshgrid(angles, speed, force, indexing="ij"))
    asked = get_network(model)
    rows = np.empty((len(d), config.alpha_outputs + config.states), dtype=np.float32)
    for low in range(0, len(d), TABLE_BATCH):
        part = slice(low, low + TABLE_BATCH)

        def noted(x: Float32, part: slice = part) -> tuple[Float32, Float32]:
            answers = asked(x)
            rows[part] = np.concatenate(answers, axis=1)
            return answers

        evaluate(model, _make_conditions(token, mechanics, probe, d[part], v[part], f[part]), noted)
    return FieldTable(
        rows.reshape(count, len(speed), len(force), -1),
        turn / count,
        (float(np.log(speed[0])), float(np.log(speed[1] / speed[0]))),
        (float(np.log(force[0])), float(np.log(force[1] / force[0]))),
        config.alpha_outputs,
    )


def evaluate_table(table: FieldTable, model: Field, condition: Condition) -> Emission:
    """What F_Θ emits at each of n states on the table's material, answered by the table."""
    rows = interpolate_table(table, condition)
    return evaluate(model, condition, (rows[:, : table.outputs], rows[:, table.outputs :]))


def interpolate_table(table: FieldTable, condition: Condition) -> Float32:
    """(n, outputs) what both heads would answer at each of n states."""
    directions, speeds, forces, width = table.values.shape
    rows: list[tuple[Integers, Float]] = [
        (np.zeros(len(condition.speed), dtype=np.int64), np.ones(len(condition.speed)))
    ]
    if directions > 1:
        angle = np.arctan2(condition.direction[:, 1], condition.direction[:, 0]) / table.angle_step
        low = np.floor(angle).astype(np.int64)
        rows = [(low % directions, 1.0 - (angle - low)), ((low + 1) % directions, angle - low)]
    (speed, faster), (force, harder) = (
        _locate(np.log(np.maximum(of, floor)), count, *axis)
        for count, of, floor, axis in (
            (speeds, condition.speed, SPEED_FLOOR_M_S, table.speed),
            (forces, condition.force, FORCE_FLOOR_N, table.force),
        )
    )
    both = ((speed, 1.0 - faster), (speed + 1, faster))
    corners = [((d * speeds + v) * forces + force, of_d * of_v) for d, of_d in rows for v, of_v in both]
    row, factor = (np.stack(each, axis=1) for each in zip(*corners, strict=True))
    return interpolate_rows(
        table.values.reshape(-1, width), row, np.repeat(harder[:, None], len(corners), axis=1), factor
    )


def _locate(log: Float, count: int, start: float, step: float) -> tuple[Integers, Float]:
    """The point of an axis before each number (n,), and how far it is on the way to the next."""
    place = np.clip((log - start) / step, 0.0, count - 1)
    low = np.minimum(place.astype(np.int64), count - 2)
    return low, place - low


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
    """Whether no moment of direction and no tone tells one direction from another."""
    bands = np.asarray(token)[: len(BAND_WAVELENGTHS_M) * len(BAND_FEATURES)].reshape(-1, len(BAND_FEATURES))
    moments = [BAND_FEATURES.index(name) for name in ("cos2", "sin2", "cos4", "sin4", "peak")]
    return bool(np.all(np.abs(bands[:, moments]) < _ISOTROPY_TOLERANCE))


SYNTH_NAME = "synth"
MATERIAL_NAME = "leather"
STROKE_S, QUICK_STROKE_S = 10.0, 0.3
WIDE_HIDDEN = 1024
WINDOWS, WINDOW = 5, 500
"""Stretches all over the stroke in which the literal model's pace is measured, and their samples."""
TOLERANCES_DB = (-30.0, -35.0, -40.0, -50.0)
CACHED_DB = (-35.0, -40.0)
TABLE_TOLERANCE = 10.0 ** (-32.5 / 20.0)
"""What states may leave out, so that all of it is −40 dB off."""
SEED = 11
EVERY_STATE = "every state"
"""What the others' times are told in."""


@dataclass(frozen=True)
class SynthMethod:
    """name: in the table. render: whole signal (count,) m/s². cold: with carriers that nobody has met before.
    ours: it is meant to be the reference's signal, so that it has an error. share: of the signal that render makes,
    where all of it would take too long; times are told of all of it."""

    name: str
    render: Callable[[Field, StrokeInput, int], Float]
    is_cold: bool = True
    note: str = ""
    has_error: bool = True
    share: float = 1.0


def measure_synth(options: BenchOptions) -> list[Row]:
    """Each method on the field that is shipped, with every unit in four equal parts: H = 1024, the same function."""
    shipped, stroke = load_field(), make_keyed_stroke(QUICK_STROKE_S if options.quick else STROKE_S)
    field = shipped if options.quick else widen_field(shipped, WIDE_HIDDEN)
    options.watch(f"{SYNTH_NAME}: the reference, a minute")
    # The same function with a quarter of the units. All of the stroke: most of what is missed is where a hand stops.
    wanted = synthesise_reference(_to_float64(shipped), stroke, seed=SEED, count=sample_count(stroke.action))
    methods, errors = [_make_literal_method(field, stroke), *_make_methods(field, stroke)], []
    for method in methods:  # first, so that libraries have their plans before anything is timed
        options.watch(f"{SYNTH_NAME}: {method.name}, error")
        errors.append(_compute_error_db(method.render(field, stroke, SEED), wanted) if method.has_error else None)
    times = _time_in_turn(methods, field, stroke, options)
    return [_make_row(*each, times, field, stroke) for each in zip(methods, errors, strict=True)]


def _make_literal_method(field: Field, stroke: StrokeInput) -> SynthMethod:
    """The reference at its own size. Each round takes another stretch of the stroke."""
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
    """Times of each method by its name, one of each in every round; of all threads, since F_Θ has some of its own."""
    times = {method.name: Times(time.process_time) for method in methods}
    for number in range(1, options.repeats + 1):
        options.watch(f"{SYNTH_NAME}: round {number} of {options.repeats}")
        for method in methods:
            _prepare_caches(method, field, stroke)
            times[method.name].measure(partial(method.render, field, stroke, SEED + number * method.is_cold))
    return {method.name: times[method.name].scale(1.0 / method.share) for method in methods}


def _prepare_caches(method: SynthMethod, field: Field, stroke: StrokeInput) -> None:
    """Of what methods before it kept, nothing is left; what it keeps itself is there."""
    clear_carrier_caches()
    if not method.is_cold:
        method.render(field, stroke, SEED)


def _make_row(
    method: SynthMethod, error: float | None, times: dict[str, Times], field: Field, stroke: StrokeInput
) -> Row:
    taken, seconds = times[method.name], (len(stroke.action.speed) - 1) / ACTION_RATE_HZ
    _prepare_caches(method, field, stroke)
    row = Row(
        SYNTH_NAME, method.name, taken.seconds, taken.cpu, error=error, error_unit="dB", note=method.note,
        peak_mb=measure_peak_mb(partial(method.render, field, stroke, SEED)),
        realtime_factor=seconds / taken.seconds.median,
    )  # fmt: skip
    if method.name == EVERY_STATE:
        return row
    return replace(row, ratio=taken.compute_ratio(times[EVERY_STATE]), ratio_to=EVERY_STATE)


def _make_methods(field: Field, stroke: StrokeInput) -> list[SynthMethod]:
    def plain(field: Field, stroke: StrokeInput, seed: int) -> Float:
        prepared = prepare_stroke(field, stroke, seed=seed)
        texture = render_carriers_full_rate(
            prepared.amplitude, prepared.carriers, seed, prepared.action, 0, prepared.count
        )
        return np.asarray(prepared.audible * (texture + render_contact(prepared, 0, prepared.count)))

    def within(tolerance_db: float | None, field: Field, stroke: StrokeInput, seed: int) -> Float:
        tolerance = None if tolerance_db is None else 10.0 ** (tolerance_db / 20.0)
        return render_stroke(field, stroke, seed, tolerance)[1]

    material = stroke.tokens[0], stroke.mechanics[0], stroke.action.probe
    table = tabulate_field(field, *material, TableGrid() if len(stroke.action.speed) > 1000 else TableGrid(4, 1, 1))

    def tabled(field: Field, stroke: StrokeInput, seed: int) -> Float:
        read = partial(evaluate_table, table)
        return render_stroke(field, stroke, seed, TABLE_TOLERANCE, read)[1]

    def narrow(field: Field, stroke: StrokeInput, seed: int) -> Float:
        return render_stroke(field, stroke, seed, evaluator=evaluate_in_bfloat16)[1]

    bfloat16 = SynthMethod("every state, bfloat16", narrow, note="F_Θ's layers, by torch; the rest as it is")

    def rival(_: Field, stroke: StrokeInput, seed: int) -> Float:
        return synthesise_autoregressive(stroke.action, seed)

    def numpy_alone(tolerance_db: float | None, field: Field, stroke: StrokeInput, seed: int) -> Float:
        with without_kernel():
            return within(tolerance_db, field, stroke, seed)

    followed = [
        SynthMethod(f"within {db:g} dB", partial(within, db), note="F_Θ where the action asks") for db in TOLERANCES_DB
    ]
    kept = [
        SynthMethod(
            f"within {db:g} dB, carriers kept", partial(within, db), is_cold=False, note="the same stroke once more"
        )
        for db in CACHED_DB
    ]
    alone = [
        SynthMethod(f"numpy: {EVERY_STATE}", partial(numpy_alone, None), note="as on a Mac, without the kernel"),
        *(
            SynthMethod(f"numpy: {db:g} dB, kept", partial(numpy_alone, db), is_cold=False, note="without the kernel")
            for db in CACHED_DB
        ),
    ]
    return [
        SynthMethod(
            "every sample, float32",
            synthesise_every_sample,
            note="F_Θ 10,000 times a second, as the model is written down",
        ),
        SynthMethod("every 0.5 ms", partial(within, float("-inf")), note="F_Θ 2000 times a second"),
        SynthMethod("every state, plain carriers", plain, note="200 times a second, carriers band by band in float64"),
        SynthMethod(EVERY_STATE, partial(within, None), note="200 times a second; what scenes and previews use"),
        *([bfloat16] if has_bfloat16() else []),
        *followed,
        *kept,
        SynthMethod(
            "from a table, carriers kept", tabled, is_cold=False, note=f"{table.megabytes:.0f} MB for one material"
        ),
        *(alone if load_kernel() is not None else []),
        SynthMethod("piecewise AR (HaTT), a loop in numpy", rival, note="another model: time only", has_error=False),
    ]


def widen_field(field: Field, hidden: int) -> Field:
    """The same function from a network of `hidden` units: each unit in equal parts. hidden: a multiple of H."""
    parts, parameters = hidden // field.config.hidden, dict(field.parameters)
    for layer in range(field.config.layers):
        weight = np.repeat(parameters[f"layer{layer}.weight"], parts, axis=0)
        parameters[f"layer{layer}.weight"] = np.repeat(weight, parts, axis=1) / parts if layer else weight
        parameters[f"layer{layer}.bias"] = np.repeat(parameters[f"layer{layer}.bias"], parts)
    for head in ("alpha", "sigma"):
        parameters[f"{head}.weight"] = np.repeat(parameters[f"{head}.weight"], parts, axis=1) / parts
    single = {name: value.astype(np.float32) for name, value in parameters.items()}
    return replace(field, config=replace(field.config, hidden=hidden), parameters=single)
