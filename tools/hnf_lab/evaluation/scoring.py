"""Trials, references and scores: test strokes, recordings of the true process, and all metrics of one method.

A `Trial` is a stroke to evaluate on. A `Reference` holds realisations of the true process for one stroke with its
long-run spectrum and metric bounds. `score_natural` and `score_expected_magnitude` turn a method's signals into a
`Score`.
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
from hnf_core.metrics.similarity import spqi, st_sim_tum
from hnf_core.metrics.spectra import (
    WINDOW_SAMPLES,
    average_spectrum_distance_db,
    lsd_power_db,
    welch,
    window_magnitudes,
)

from .bounds import REALISATION_COUNT, MetricBounds, compute_bounds, measure_repetition
from .metrics import gfc, lsd_log10_magnitude, nine_band_error_db, power_bias_db, st_sim_cosine

TrainingStrokes = Literal["wandering", "circular", "circular and primitives"]
"""Kinds of training strokes.

wandering: speed, force and direction vary within their ranges. circular: as in the paper's recordings. circular and
primitives: HNF+, with the eight synthetic classes of action added.
"""

STROKE_S = 5.0
"""Duration of a wandering training stroke [s]."""
CIRCLE_RADIUS_M = 0.02
"""Radius of circular strokes [m]."""
CIRCLE_S = 5.0
"""Duration of a circular stroke [s]."""


@dataclass(frozen=True)
class Trial:
    """A stroke on which methods are evaluated.

    Attributes
    ----------
    kind
        "window": new, but of the kind most methods train on. "unseen": of a kind in no training set.
    name
        Text for the report.
    """

    kind: Literal["window", "unseen"]
    name: str
    action: Action


def make_training_actions(
    training_strokes: TrainingStrokes, limits: ActionRange, seconds: float, seed: int
) -> list[Action]:
    """Make about `seconds` of training strokes within the limits, at least one; HNF+ adds primitives of half as long.

    Deterministic for a seed.
    """
    if training_strokes == "wandering":
        count = max(1, round(seconds / STROKE_S))
        return [_make_wandering(limits, min(seconds, STROKE_S), 10_000 + 100 * seed + index) for index in range(count)]
    actions = _make_circles(limits, seconds, seed)
    if training_strokes == "circular and primitives":
        primitive_actions = [make_primitive_action(name, seed=seed) for name in PRIMITIVE_NAMES]
        repeats = max(1, round(0.5 * seconds / sum(action.duration_s for action in primitive_actions)))
        actions += [
            make_primitive_action(name, seed=1000 * seed + repeat)
            for repeat in range(repeats)
            for name in PRIMITIVE_NAMES
        ]
    return actions


def make_trials(limits: ActionRange, seconds: float, seed: int) -> list[Trial]:
    """Make two new wandering strokes, a steady stroke and a speed sweep at constant force.

    The last two kinds are in no training set.
    """
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
    """Make a stroke of constant direction and force whose speed rises linearly between the limits."""
    count = round(duration_s * ACTION_RATE_HZ) + 1
    speed = np.linspace(*speed_m_s, count)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / ACTION_RATE_HZ
    direction = np.tile([np.cos(angle_rad), np.sin(angle_rad)], (count, 1))
    return Action(ACTION_RATE_HZ, direction, speed, np.full(count, force_n), position, np.ones(count, dtype=bool))


def _make_circles(limits: ActionRange, seconds: float, seed: int) -> list[Action]:
    """Make circles of constant speed and force that step through a grid of both."""
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
"""Sample rate of all signals [Hz]."""
FREQUENCY_HZ = np.fft.rfftfreq(WINDOW_SAMPLES, 1.0 / RATE_HZ)
"""(501,) frequencies of the Welch bins [Hz]."""
WINDOW_OFFSETS = (0, 250, 500, 750)
"""Window offsets [samples] at which expected-magnitude signals are tested; natural signals are insensitive."""


@dataclass(frozen=True)
class Reference:
    """Realisations of the true process for one stroke on one material.

    Attributes
    ----------
    draws
        (R, n) realisations; the first is *the* recording.
    oracle
        Further realisations from another seed, independent of all figures of the reference.
    """

    material: str
    stroke: str
    action: Action
    draws: Float
    oracle: tuple[Float, ...]

    @property
    def recording(self) -> Float:
        """First realisation, (n,) [m/s²]."""
        return np.asarray(self.draws[0])

    @cached_property
    def density(self) -> Float:
        """Long-run spectrum: (501,) Welch average over all draws."""
        return np.asarray(np.mean([welch(draw, RATE_HZ)[1] for draw in self.draws], axis=0))

    @cached_property
    def limits(self) -> tuple[MetricBounds, ...]:
        """Metric bounds for each window offset of WINDOW_OFFSETS."""
        return tuple(
            compute_bounds([window_magnitudes(draw[offset:]) for draw in self.draws]) for offset in WINDOW_OFFSETS
        )


def make_references(
    process: TextureProcess, strokes: Sequence[tuple[str, Action]], seed: int, realisations: int, renders: int
) -> list[Reference]:
    """Make one Reference per named stroke; all strokes are equally long.

    Draws use two seeds (one if there are few) and the oracle another, so no reference depends on a single surface.
    """
    actions = [action for _, action in strokes]
    half = -(-realisations // 2) if realisations >= REALISATION_COUNT else realisations
    drawn = [
        _record_draws(process, actions, 3 * seed + block, count)
        for block, count in ((0, half), (1, realisations - half))
    ]
    oracle = _record_draws(process, actions, 3 * seed + 2, renders)
    return [
        Reference(
            process.name,
            name,
            action,
            np.concatenate([block[index] for block in drawn if len(block[index])]),
            tuple(oracle[index]),
        )
        for index, (name, action) in enumerate(strokes)
    ]


def _record_draws(process: TextureProcess, actions: Sequence[Action], seed: int, times: int) -> list[Float]:
    """Return (times, n) per action from a single call, since the simulator's cost is mostly per call."""
    if times == 0:
        return [np.zeros((0, 0))] * len(actions)
    recordings = process.record([action for action in actions for _ in range(times)], seed)
    samples = np.stack([recording.samples for recording in recordings])
    return [samples[index * times : (index + 1) * times] for index in range(len(actions))]


@dataclass(frozen=True)
class Score:
    """Metrics of one method on one reference; None where a metric does not apply.

    Attributes
    ----------
    distance_db, power_bias_db, nine_band_db
        Average spectra against the long-run spectrum [dB].
    mse
        Spectral MSE averaged over all recordings the process could give, (m/s²)² of an unscaled DFT.
    mse_oracle, mse_best
        MSE divided by the bounds.
    lsd_db, lsd_log10, gfc, st_sim_tum, st_sim_cosine, st_sim_cosine_spectral, spqi
        Metrics against one recording.
    repetition
        Largest autocorrelation beyond 0.1 s.
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
    """Compute the metrics that need only an average spectrum (501,)."""
    return Score(
        distance_db=average_spectrum_distance_db(density, reference.density, FREQUENCY_HZ),
        power_bias_db=power_bias_db(density, reference.density, FREQUENCY_HZ),
        nine_band_db=nine_band_error_db(density, reference.density, FREQUENCY_HZ),
    )


def score_natural(signals: Sequence[Float], reference: Reference) -> Score:
    """Score natural signals: renderings of the reference's action.

    Average spectra are taken over all signals (the pass criteria refer to 8 s); other metrics are means over them.
    """
    signals = [_check_rendering(signal, reference) for signal in signals]
    density = np.mean([welch(signal, RATE_HZ)[1] for signal in signals], axis=0)
    errors = [reference.limits[0].expected_mse(window_magnitudes(signal)) for signal in signals]
    waveform_scores = _score_waveforms(signals, reference)
    density_score = score_density(density, reference)
    return Score(
        **{
            **{name: value for name, value in density_score.values().items() if value is not None},
            **waveform_scores,
            **_compute_mse_ratios(float(np.mean(errors)), reference, 0),
            "repetition": float(np.mean([measure_repetition(signal, RATE_HZ) for signal in signals])),
        }
    )


def score_expected_magnitude(signals: Sequence[Float], reference: Reference) -> Score:
    """Score signals whose windows have the expected magnitude E|X_k|.

    The worst window offset counts. Metrics of a natural signal's power are omitted.
    """
    signals = [_check_rendering(signal, reference) for signal in signals]
    worst: dict[str, float] = {}
    for signal in signals:
        for index, offset in enumerate(WINDOW_OFFSETS):
            error = reference.limits[index].expected_mse(window_magnitudes(signal[offset:]))
            ratios = _compute_mse_ratios(error, reference, index)
            if ratios["mse_best"] > worst.get("mse_best", 0.0):
                worst = ratios
    return Score(**{**_score_waveforms(signals, reference), **worst})


def score_best(reference: Reference) -> Score:
    """Score the best possible prediction of |X_k|: the process's own mean over realisations."""
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
    for signal in signals:
        magnitude = window_magnitudes(signal)
        cosine = st_sim_cosine(signal, recording)
        rows.append(
            {
                "lsd_db": lsd_power_db(magnitude, recorded),
                "lsd_log10": lsd_log10_magnitude(magnitude, recorded),
                "gfc": gfc(magnitude, recorded),
                "st_sim_tum": st_sim_tum(signal, recording, RATE_HZ),
                "st_sim_cosine": cosine.combined,
                "st_sim_cosine_spectral": cosine.spectral,
                "spqi": spqi(signal, recording, RATE_HZ),
            }
        )
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def _check_rendering(signal: Float, reference: Reference) -> Float:
    """Return the signal as float64. Raises ValueError for a wrong length or values that are not finite."""
    samples = np.asarray(signal, dtype=np.float64)
    if samples.shape != reference.recording.shape or not np.isfinite(samples).all():
        raise ValueError(f"a rendering of {samples.shape} for a stroke of {reference.recording.shape}, or not finite.")
    return samples
