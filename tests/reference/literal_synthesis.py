"""Reference synthesis of the model, sample by sample in float64, against which the fast path is tested.

u(t) is read at every 10 kHz sample, F_Θ evaluated there and at the N past samples, and every carrier summed from its
Fourier coefficients at the exact t or s(t). No tables, no interpolation of amplitudes, no spatial grid.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import Action
from hnf_core.errors import UsageError
from hnf_core.field.carriers import ARC_BLOCK, TIME_BLOCK, Carriers
from hnf_core.field.contact.lattice_lines import HARMONICS
from hnf_core.field.field import Field, evaluate
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.render import render_contact
from hnf_core.field.render_weights import render_weights
from hnf_core.field.stroke import (
    SAMPLES_PER_STATE,
    StrokeInput,
    find_peak_speed,
    interpolate_condition,
    interpolate_cubic,
    resample_action,
    sample_count,
)
from hnf_core.field.tones import LineCourse, compute_tone_offsets, follow_lines

Float = NDArray[np.float64]


def synthesise_reference(field: Field, stroke: StrokeInput, *, seed: int, start: int = 0, count: int = 2000) -> Float:
    """Synthesise count samples at the model rate from sample start on [m/s²], (count,) float64.

    The texture term is evaluated without approximation; pressing is the shared linear filter, which is exact already.
    Raises UsageError for a stroke with a height profile, whose part of the power is defined at the action rate.
    """
    if stroke.profile is not None:
        raise UsageError("the reference does not take a height profile.", remedy="Compare without it.")
    action, token_index = resample_action(stroke)
    count = min(count, sample_count(action) - start)
    prepared = prepare_stroke(field, stroke, seed=seed)
    texture = texture_reference(field, stroke, action, token_index, seed, start, count)
    out = prepared.audible[start : start + count] * (texture + render_contact(prepared, start, count))
    return np.asarray(out)


def texture_reference(
    field: Field,
    stroke: StrokeInput,
    action: Action,
    token_index: NDArray[np.int32],
    seed: int,
    start: int,
    count: int,
) -> Float:
    """Evaluate Σ_n w_n Σ_k A_k c_k without approximation; returns (count,)."""
    config, carriers = field.config, field.config.carriers
    lag = config.stride * SAMPLES_PER_STATE
    lines = follow_lines(stroke.tokens, stroke.mechanics, action, token_index, seed) if config.line_gains else None
    token_lines = None if lines is None else lines.lines
    out = np.zeros(count)
    for offset in range(0, count, 500):
        sample = start + offset + np.arange(min(500, count - offset))
        emissions = []
        for n in range(config.states if config.accumulation == "past" else 1):
            past = sample - n * lag
            emission = evaluate(field, interpolate_condition(stroke, action, token_index, past, None, token_lines))
            emissions.append((np.where(past[:, None, None] < 0, 0.0, emission.alpha), emission.sigma_dt))
        if config.accumulation == "past":
            sigma = np.stack([emission[1][:, n] for n, emission in enumerate(emissions)], axis=1)
            weights = render_weights(sigma)
            terms = [(0, sum(weights[:, n, None] * emission[0][:, 0] for n, emission in enumerate(emissions)))]
        else:
            alpha, sigma = emissions[0]
            weights = render_weights(sigma)
            terms = [(n, weights[:, n, None] * alpha[:, n]) for n in range(config.states)]
        total = np.zeros(len(sample))
        if lines is not None:
            total += tones_at(lines, action, terms[0][1][:, carriers.count :], sample)
        for delay, amplitude in terms:
            position = interpolate_cubic(action.position, (sample - delay) / SAMPLES_PER_STATE)
            total += np.einsum(
                "ik,ik->i", amplitude[:, : carriers.count], carriers_at(carriers, seed, sample - delay, position)
            )
        out[offset : offset + len(sample)] = total
    return out


def tones_at(lines: LineCourse, action: Action, amplitude: Float, sample: NDArray[np.intp]) -> Float:
    """Evaluate the tones of amplitudes (count, tones) at every sample."""
    amplitude, out = amplitude.copy(), np.zeros(len(sample))
    lines.silence_others(amplitude, sample, find_peak_speed(action))
    state = np.minimum(sample // SAMPLES_PER_STATE, len(action.speed) - 2)
    position = interpolate_cubic(action.position, sample / SAMPLES_PER_STATE)
    way, offsets = position - action.position[state], compute_tone_offsets(lines.lines)
    displacement = np.zeros((2, len(sample))) if lines.displacement is None else lines.displacement.evaluate(position)
    for line in range(lines.turns.shape[1]):
        between = 0.5 * (lines.wavenumber[state, line] + lines.wavenumber[state + 1, line])
        turns = lines.turns[state, line] + between * way + (lines.scatter[state, :, line].T * displacement).sum(axis=0)
        for order, harmonic in enumerate(HARMONICS):
            number = line * len(HARMONICS) + order
            phase = 2.0 * np.pi * (harmonic * turns + offsets[number])
            out += np.sqrt(2.0) * amplitude[:, number] * np.sin(phase)
    return out


def carriers_at(carriers: Carriers, seed: int, sample: NDArray[np.intp], place: Float) -> Float:
    """Evaluate all carriers by Fourier sums at samples of the model rate and arc lengths s [m]; returns (count, K)."""
    columns = [np.ones((len(sample), int(carriers.constant)))]
    if carriers.time_count:
        columns.append(_fourier(lambda b: carriers.time_block_spectra(seed, b), TIME_BLOCK, sample.astype(np.float64)))
    for octave in range(carriers.arc_octaves):
        columns.append(
            _fourier(
                lambda b, octave=octave: carriers.arc_block_spectra(seed, octave, b),
                ARC_BLOCK,
                place / carriers.arc_step_m(octave),
            )
        )
    return np.concatenate(columns, axis=1)


def _fourier(spectra, size: int, at: Float) -> Float:  # type: ignore[no-untyped-def]
    """Sum faded blocks at fractional positions, where the window is evaluated too."""
    hop = size // 2
    block = np.floor(at / hop).astype(int)
    total = None
    for index in range(int(block.min()) - 1, int(block.max()) + 1):
        inside = np.flatnonzero((at >= index * hop) & (at < index * hop + size))
        coefficients = spectra(index)
        if total is None:
            total = np.zeros((len(at), len(coefficients)))
        used = np.flatnonzero(np.any(coefficients != 0.0, axis=0))
        local = at[inside] - index * hop
        waves = np.exp(2j * np.pi * local[:, None] * used[None, :] / size)
        fade = np.sin(0.5 * np.pi * np.sin(np.pi * (local + 0.5) / size) ** 2)
        total[inside] += 2.0 / size * np.real(waves @ coefficients[:, used].T) * fade[:, None]
    assert total is not None
    return np.asarray(total)
