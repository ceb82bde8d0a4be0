"""One stroke of ten seconds, synthesised in every way there is: how fast, how much memory, and how far from the model
taken literally (F_Θ and every carrier at each of 10,000 samples a second, in float64).

Methods are timed in turn, round by round, so that a machine whose pace changes is as fast for each of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..field import hops
from ..field.blocks import render_contact
from ..field.carriers import MODEL_RATE_HZ
from ..field.field import Field
from ..field.plain import render_carriers_full_rate
from ..field.prepared import prepare_stroke
from ..field.reference import synthesise_reference
from ..field.stroke import StrokeInput, uniform_stroke
from ..field.synthesis import render_stroke
from ..field.timeline import sample_count
from ..field.weights import load_field
from ..kernel.library import load_kernel, without_kernel
from ..material.library import get_material
from .frame import BenchOptions, Row, Times, measure_peak_mb
from .synth_ar import synthesise_autoregressive
from .synth_narrow import evaluate_in_bfloat16, has_bfloat16
from .synth_sampled import synthesise_every_sample
from .synth_table import TableGrid, evaluate_table, tabulate_field

Float = NDArray[np.float64]

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
        peak_mb=measure_peak_mb(partial(method.render, field, stroke, SEED)), realtime_factor=seconds / taken.seconds.median,
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


def clear_carrier_caches() -> None:
    """As in a process that has just begun."""
    for kept in (hops.get_time_hop, hops.get_arc_hop, hops._draw_time_block, hops._get_arc_block):
        kept.cache_clear()


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


def make_keyed_stroke(seconds: float) -> StrokeInput:
    """What an artist keys: a hand that lands, speeds up and down, presses more and less, wanders within ±25° and rests
    once on its way."""
    time: NDArray[np.float64] = np.arange(round(seconds * ACTION_RATE_HZ) + 1) / ACTION_RATE_HZ
    ends = np.clip(time / 0.15, 0.0, 1.0) * np.clip((seconds - time) / 0.15, 0.0, 1.0)
    speed = 0.09 + 0.05 * np.sin(0.8 * np.pi * time) + 0.02 * np.sin(2.2 * np.pi * time + 1.0)
    speed = speed * ends * (1.0 - np.exp(-np.square((time - 0.5 * seconds) / 0.1)))
    force = (1.0 + 0.6 * np.sin(0.6 * np.pi * time)) * np.minimum(3.0 * ends, 1.0)
    angle = np.radians(25.0 * np.sin(0.3 * np.pi * time))
    place = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / ACTION_RATE_HZ)])
    ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    material = get_material(MATERIAL_NAME)
    action = Action(ACTION_RATE_HZ, ahead, speed, force, place, force > 0.0)
    return uniform_stroke(action, material.token.astype(np.float32), material.mechanics)
