"""One method on one reference, by every metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from ..metrics.average_spectrum import average_spectrum_distance_db, nine_band_error_db, power_bias_db
from ..metrics.log_spectral_distance import lsd_log10_magnitude, lsd_power_db
from ..metrics.magnitudes import gfc, window_magnitudes
from ..metrics.repetition import measure_repetition
from ..metrics.spectra import welch
from ..metrics.spqi import spqi
from ..metrics.st_sim_cosine import st_sim_cosine
from ..metrics.st_sim_tum import st_sim_tum
from .reference import FREQUENCY_HZ, RATE_HZ, WINDOW_OFFSETS, Reference

Float = NDArray[np.float64]


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
