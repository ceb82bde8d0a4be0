"""What is stroked: to learn from, and to be judged on.

What a method is held against: one recording, the long-run spectrum, and the limits of the process.

One method on one reference, by every metric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import PRIMITIVE_NAMES
from hnf_core.action.synthetic_actions import make_circular_action, make_random_smooth_action, make_steady_action
from hnf_core.datasets.recording import ActionRange, TextureProcess
from hnf_core.metrics.similarity import spqi, st_sim_cosine, st_sim_tum
from hnf_core.metrics.spectra import (
    WINDOW_SAMPLES,
    average_spectrum_distance_db,
    gfc,
    lsd_log10_magnitude,
    lsd_power_db,
    nine_band_error_db,
    power_bias_db,
    welch,
    window_magnitudes,
)

from .bounds import REALISATION_COUNT, MetricBounds, compute_bounds, measure_repetition

TrainingStrokes = Literal["wandering", "circular", "circular and primitives"]
"""What a method learns from. wandering: speed, force and direction walk through their ranges. circular: as the paper's
recordings. circular and primitives: HNF+, the eight synthetic classes of action added."""

STROKE_S = 5.0
CIRCLE_RADIUS_M = 0.02
CIRCLE_S = 5.0


@dataclass(frozen=True)
class Trial:
    """kind: "window" (new, but of the kind most methods learn from) or "unseen" (of a kind in no diet). name: words."""

    kind: Literal["window", "unseen"]
    name: str
    action: Action


def make_training_actions(
    training_strokes: TrainingStrokes, limits: ActionRange, seconds: float, seed: int
) -> list[Action]:
    """Some `seconds` of strokes within the limits; at least one. Deterministic with a seed."""
    if training_strokes == "wandering":
        count = max(1, round(seconds / STROKE_S))
        return [_make_wandering(limits, min(seconds, STROKE_S), 10_000 + 100 * seed + index) for index in range(count)]
    circles = seconds if training_strokes == "circular" else 0.5 * seconds
    actions = _make_circles(limits, circles, seed)
    if training_strokes == "circular and primitives":
        kinds = [make_primitive_action(name, seed=seed) for name in PRIMITIVE_NAMES]
        repeats = max(1, round((seconds - circles) / sum(each.duration_s for each in kinds)))
        actions += [
            make_primitive_action(name, seed=1000 * seed + again)
            for again in range(repeats)
            for name in PRIMITIVE_NAMES
        ]
    return actions


def make_trials(limits: ActionRange, seconds: float, seed: int) -> list[Trial]:
    """Two new wandering strokes; a steady stroke; and a speed sweep at constant force: the last two are in no diet."""
    speed, force = _compute_middle(limits.speed_m_s), _compute_middle(limits.force_n)
    low, high = limits.speed_m_s
    angle = float(np.random.default_rng(seed).uniform(*limits.angle_rad))
    return [
        Trial("window", "wandering 1", _make_wandering(limits, seconds, 1000 + seed)),
        Trial("window", "wandering 2", _make_wandering(limits, seconds, 2000 + seed)),
        Trial(
            "unseen",
            f"steady {1e3 * speed:.0f} mm/s, {force:.2g} N, {np.degrees(angle):.0f}°",
            make_steady_action(seconds, speed, force, angle),
        ),
        Trial(
            "unseen",
            f"sweep {1e3 * low:.0f}–{1e3 * high:.0f} mm/s, {force:.2g} N",
            make_sweep_action(seconds, limits.speed_m_s, force, angle),
        ),
    ]


def make_sweep_action(duration_s: float, speed_m_s: tuple[float, float], force_n: float, angle_rad: float) -> Action:
    """Speed rises evenly from one limit to the other; direction and force stay."""
    count = round(duration_s * ACTION_RATE_HZ) + 1
    speed = np.linspace(*speed_m_s, count)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / ACTION_RATE_HZ
    direction = np.tile([np.cos(angle_rad), np.sin(angle_rad)], (count, 1))
    return Action(ACTION_RATE_HZ, direction, speed, np.full(count, force_n), position, np.ones(count, dtype=bool))


def _make_circles(limits: ActionRange, seconds: float, seed: int) -> list[Action]:
    """Circles of constant speed and force, a grid of both gone through in turn."""
    rng = np.random.default_rng(seed)
    length = min(CIRCLE_S, seconds)
    count = max(1, round(seconds / length))
    actions = []
    for index in range(count):
        speed = _interpolate_log(limits.speed_m_s, (index + 0.5) / count)
        force = _interpolate_log(limits.force_n, (0.618034 * index + rng.uniform()) % 1.0)
        actions.append(make_circular_action(length, speed, force, CIRCLE_RADIUS_M, rng.uniform(0.0, 2.0 * np.pi)))
    return actions


def _make_wandering(limits: ActionRange, seconds: float, seed: int) -> Action:
    return make_random_smooth_action(
        seconds, seed, speed_m_s=limits.speed_m_s, force_n=limits.force_n, angle_rad=limits.angle_rad
    )


def _compute_middle(limits: tuple[float, float]) -> float:
    return _interpolate_log(limits, 0.5)


def _interpolate_log(limits: tuple[float, float], share: float) -> float:
    return float(limits[0] * (limits[1] / limits[0]) ** share)


Float = NDArray[np.float64]

RATE_HZ = 10_000.0
FREQUENCY_HZ = np.fft.rfftfreq(WINDOW_SAMPLES, 1.0 / RATE_HZ)
WINDOW_OFFSETS = (0, 250, 500, 750)
"""Window offsets at which expected-magnitude forms are tried: a natural form does not care."""


@dataclass(frozen=True)
class Reference:
    """One stroke on one material.

    draws: (R, n) realisations of the true process; the first stands for *the* recording. oracle: further ones, from
    another seed, that no figure of the reference was taken from.
    """

    material: str
    stroke: str
    action: Action
    draws: Float
    oracle: tuple[Float, ...]

    @property
    def recording(self) -> Float:
        return np.asarray(self.draws[0])

    @cached_property
    def density(self) -> Float:
        """(501,) Welch average over all draws: the long-run spectrum."""
        return np.asarray(np.mean([welch(each, RATE_HZ)[1] for each in self.draws], axis=0))

    @cached_property
    def limits(self) -> tuple[MetricBounds, ...]:
        """One for each window offset of OFFSETS."""
        return tuple(
            compute_bounds([window_magnitudes(each[offset:]) for each in self.draws]) for offset in WINDOW_OFFSETS
        )


def make_references(
    process: TextureProcess, strokes: Sequence[tuple[str, Action]], seed: int, realisations: int, renders: int
) -> list[Reference]:
    """One Reference per named stroke, all equally long. Two seeds for the draws (one for few), another for the oracle:
    none stands on a single piece of surface."""
    actions = [action for _, action in strokes]
    half = -(-realisations // 2) if realisations >= REALISATION_COUNT else realisations
    drawn = [
        _record_draws(process, actions, 3 * seed + part, count) for part, count in ((0, half), (1, realisations - half))
    ]
    oracle = _record_draws(process, actions, 3 * seed + 2, renders)
    return [
        Reference(
            process.name,
            name,
            action,
            np.concatenate([part[index] for part in drawn if len(part[index])]),
            tuple(oracle[index]),
        )
        for index, (name, action) in enumerate(strokes)
    ]


def _record_draws(process: TextureProcess, actions: Sequence[Action], seed: int, times: int) -> list[Float]:
    """(times, n) per action, all in one call: the simulator's cost is by the call."""
    if times == 0:
        return [np.zeros((0, 0))] * len(actions)
    recordings = process.record([action for action in actions for _ in range(times)], seed)
    samples = np.stack([recording.samples for recording in recordings])
    return [samples[index * times : (index + 1) * times] for index in range(len(actions))]


@dataclass(frozen=True)
class Score:
    """None where a metric says nothing of such a signal.

    distance_db, power_bias_db, nine_band_db: average spectra, against the long run. mse: spectral MSE averaged over all
    recordings the process could give, (m/s²)² of an unscaled DFT; mse_oracle, mse_best: over the limits. lsd_db,
    lsd_log10, gfc, st_sim_*, spqi: against one recording. repetition: largest autocorrelation beyond 0.1 s.
    """

    distance_db: float | None = None
    power_bias_db: float | None = None
    nine_band_db: float | None = None
    mse: float | None = None
    mse_oracle: float | None = None
    mse_best: float | None = None
    lsd_db: float | None = None
    lsd_log10: float | None = None
    gfc: float | None = None
    st_sim_tum: float | None = None
    st_sim_cosine: float | None = None
    st_sim_cosine_spectral: float | None = None
    spqi: float | None = None
    repetition: float | None = None

    def values(self) -> dict[str, float | None]:
        return asdict(self)


METRIC_NAMES = tuple(Score.__dataclass_fields__)


def score_density(density: Float, reference: Reference) -> Score:
    """What an average spectrum (501,) alone can be judged by."""
    return Score(
        distance_db=average_spectrum_distance_db(density, reference.density, FREQUENCY_HZ),
        power_bias_db=power_bias_db(density, reference.density, FREQUENCY_HZ),
        nine_band_db=nine_band_error_db(density, reference.density, FREQUENCY_HZ),
    )


def score_natural(signals: Sequence[Float], reference: Reference) -> Score:
    """Signals to feel: renderings of the reference's action. Average spectra are taken over all of them (the bars speak
    of 8 s of signal), every other metric is the mean over them."""
    signals = [_check_rendering(each, reference) for each in signals]
    density = np.mean([welch(each, RATE_HZ)[1] for each in signals], axis=0)
    errors = [reference.limits[0].expected_mse(window_magnitudes(each)) for each in signals]
    shown = _score_waveforms(signals, reference)
    spectral = score_density(density, reference)
    return Score(
        **{
            **{name: value for name, value in spectral.values().items() if value is not None},
            **shown,
            **_compute_mse_ratios(float(np.mean(errors)), reference, 0),
            "repetition": float(np.mean([measure_repetition(each, RATE_HZ) for each in signals])),
        }
    )


def score_expected_magnitude(signals: Sequence[Float], reference: Reference) -> Score:
    """Forms whose windows show E|X_k|: the worst window offset of each, and no metric of a natural signal's power."""
    signals = [_check_rendering(each, reference) for each in signals]
    worst: dict[str, float] = {}
    for each in signals:
        for index, offset in enumerate(WINDOW_OFFSETS):
            error = reference.limits[index].expected_mse(window_magnitudes(each[offset:]))
            found = _compute_mse_ratios(error, reference, index)
            if found["mse_best"] > worst.get("mse_best", 0.0):
                worst = found
    return Score(**{**_score_waveforms(signals, reference), **worst})


def score_best(reference: Reference) -> Score:
    """The best that any prediction of |X_k| can score: the process's own mean over realisations."""
    limits, recorded = reference.limits[0], window_magnitudes(reference.recording)
    return Score(
        **_compute_mse_ratios(limits.best, reference, 0),
        lsd_db=lsd_power_db(limits.mean_magnitude, recorded),
        lsd_log10=lsd_log10_magnitude(limits.mean_magnitude, recorded),
        gfc=gfc(limits.mean_magnitude, recorded),
    )


def _compute_mse_ratios(mse: float, reference: Reference, offset: int) -> dict[str, float]:
    limits = reference.limits[offset]
    return {"mse": mse, "mse_oracle": mse / limits.oracle, "mse_best": mse / limits.best}


def _score_waveforms(signals: Sequence[Float], reference: Reference) -> dict[str, float]:
    recording, recorded = reference.recording, window_magnitudes(reference.recording)
    rows = []
    for each in signals:
        magnitude = window_magnitudes(each)
        cosine = st_sim_cosine(each, recording)
        rows.append(
            {
                "lsd_db": lsd_power_db(magnitude, recorded),
                "lsd_log10": lsd_log10_magnitude(magnitude, recorded),
                "gfc": gfc(magnitude, recorded),
                "st_sim_tum": st_sim_tum(each, recording, RATE_HZ),
                "st_sim_cosine": cosine.combined,
                "st_sim_cosine_spectral": cosine.spectral,
                "spqi": spqi(each, recording, RATE_HZ),
            }
        )
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def _check_rendering(signal: Float, reference: Reference) -> Float:
    """Raises ValueError where a method returned another length than the stroke's, or something that is no number."""
    samples = np.asarray(signal, dtype=np.float64)
    if samples.shape != reference.recording.shape or not np.isfinite(samples).all():
        raise ValueError(f"a rendering of {samples.shape} for a stroke of {reference.recording.shape}, or not finite.")
    return samples
