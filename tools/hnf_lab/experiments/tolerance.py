"""Measure the error of the fast synthesis paths against the literal model, over the complete library.

  Usage: python -m hnf_lab.experiments.tolerance [PRIMITIVE …]    all eight: some twenty minutes on one core

Prints the table of docs/benchmarks.md: with every state evaluated, as scenes do, and within each tolerance. The literal
model (tests/reference/literal_synthesis.py) evaluates F_Θ and every carrier at each sample in float64. Its carriers are
equal for all materials under one stroke, so they are computed once. Errors are those of the complete signal, in dB of
its power.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import PRIMITIVES
from hnf_core.field.field import Field, evaluate
from hnf_core.field.prepare import make_line_course, prepare_stroke
from hnf_core.field.render import render_block, render_contact
from hnf_core.field.render_weights import render_weights
from hnf_core.field.stroke import (
    SAMPLES_PER_STATE,
    StrokeInput,
    interpolate_condition,
    interpolate_cubic,
    resample_action,
    sample_count,
    uniform_stroke,
)
from hnf_core.field.synthesis import tolerance_warning
from hnf_core.field.weights import load_field
from hnf_core.material.library import load_library
from reference.every_state import prepare_every_state
from reference.literal_synthesis import carriers_at, tones_at

Float = NDArray[np.float64]

SEED = 0
SAMPLES_PER_BATCH = 500
TOLERANCES_DB = (-30.0, -35.0, -40.0, -45.0)
FAST_PRIMITIVE = "rub-fast"
"""Primitive that circles twice a second, so that tones cross an octave of bands within some states."""


@dataclass(frozen=True)
class ErrorResult:
    """Error on one stroke.

    Attributes
    ----------
    error_db
        Error of the signal [dB].
    warned
        True if synthesis warned that the tolerance is exceeded.
    knots
        Number of states at which F_Θ was evaluated.
    """

    primitive: str
    tolerance_db: float | None
    error_db: float
    warned: bool
    knots: int


def compute_literal_texture(field: Field, stroke: StrokeInput, waves: Float) -> Float:
    """Compute the texture term of a stroke by the literal model, tones included. waves: its carriers, (count, K)."""
    action, token_index = resample_action(stroke)
    config, lag = field.config, field.config.stride * SAMPLES_PER_STATE
    lines = make_line_course(field, stroke, action, token_index, SEED)
    token_lines = None if lines is None else lines.lines
    sample = np.arange(-lag * config.states, len(waves))
    emissions = [
        evaluate(field, interpolate_condition(stroke, action, token_index, at, None, token_lines))
        for at in split_samples(sample)
    ]
    alpha = np.concatenate([emission.alpha[:, 0] for emission in emissions])
    sigma_dt = np.concatenate([emission.sigma_dt for emission in emissions])
    alpha[sample < 0] = 0.0
    past = lag * config.states + np.arange(len(waves))[:, None] - lag * np.arange(config.states)
    weights = render_weights(sigma_dt[past, np.arange(config.states)])
    total = np.zeros((len(waves), alpha.shape[1]))
    for state in range(config.states):
        total += weights[:, state, None] * alpha[past[:, state]]
    texture = np.einsum("nk,nk->n", total[:, : config.carriers.count], waves)
    if lines is not None:
        texture += tones_at(lines, action, total[:, config.carriers.count :], np.arange(len(waves)))
    return np.asarray(texture)


def split_samples(sample: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    return np.split(sample, range(SAMPLES_PER_BATCH, len(sample), SAMPLES_PER_BATCH))


def measure_primitive(primitive: str, field: Field) -> Iterator[ErrorResult]:
    """Yield the errors on each material of the library under one stroke, for each tolerance."""
    action = make_primitive_action(PRIMITIVES[primitive], seed=SEED)
    waves: Float | None = None
    for material in load_library():
        stroke = uniform_stroke(action, material.token, material.mechanics)
        at_states, _ = resample_action(stroke)
        if waves is None:
            sample = np.arange(sample_count(at_states))
            waves = np.concatenate([
                carriers_at(field.config.carriers, SEED, at, interpolate_cubic(at_states.position,
                at / SAMPLES_PER_STATE))
                for at in split_samples(sample)
            ])  # fmt: skip
        all_states = prepare_every_state(field, stroke, seed=SEED)
        count = all_states.count
        exact = all_states.audible * (
            compute_literal_texture(field, stroke, waves[:count]) + render_contact(all_states, 0, count)
        )
        for tolerance_db in (None, *TOLERANCES_DB):
            tolerance = None if tolerance_db is None else 10.0 ** (tolerance_db / 20.0)
            prepared = (
                all_states if tolerance is None else prepare_stroke(field, stroke, seed=SEED, tolerance=tolerance)
            )
            error = render_block(prepared, 0, count) - exact
            error_db = 10.0 * np.log10(np.mean(np.square(error)) / np.mean(np.square(exact)))
            warned = bool(tolerance_warning(prepared.residual_power, tolerance))
            yield ErrorResult(primitive, tolerance_db, float(error_db), warned, len(prepared.knots))


def format_table(found: list[ErrorResult]) -> str:
    lines = [
        "| strokes | F_Θ | median error | 90 % within | worst | kept | said not to be | missed, and not said |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for strokes, group in (
        ("the seven others", [result for result in found if result.primitive != FAST_PRIMITIVE]),
        (FAST_PRIMITIVE, [result for result in found if result.primitive == FAST_PRIMITIVE]),
    ):
        for tolerance_db in (None, *TOLERANCES_DB):
            rows = [result for result in group if result.tolerance_db == tolerance_db]
            if not rows:
                continue
            error = np.array([result.error_db for result in rows])
            cells = [
                f"{value:.1f} dB".replace("-", "−") for value in (*np.percentile(error, (50.0, 90.0)), error.max())
            ]
            if tolerance_db is None:
                cells += ["", "", ""]
            else:
                within, warned = error <= tolerance_db, np.array([result.warned for result in rows])
                cells += [f"{within.sum()} of {len(rows)}", str(warned.sum()), str((~within & ~warned).sum())]
            label = "every state" if tolerance_db is None else f"within −{-tolerance_db:.0f} dB"
            lines.append(f"| {strokes} | {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> int:
    names, field, results = sys.argv[1:] or list(PRIMITIVES), load_field(), []
    for name in names:
        for result in measure_primitive(name, field):
            results.append(result)
        print(f"{name}: {len(results)} renders judged", file=sys.stderr)
    print(format_table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
