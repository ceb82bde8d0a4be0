"""Measure how close `hnf train field` comes to published textures, on your own copy. Prints a Markdown table.

  Usage: python -m hnf_lab.experiments.textures DIR [--seconds 20 120 480] [--seeds N] [--workers N] [MATERIAL …]

Per texture a field is trained from the given seconds of strokes. Then 8 s of signal at nine conditions (50, 100, 150
mm/s × 0.5, 1, 2 N, limited to the model's range) and a few seeds are compared with the model's exact spectrum, as is
the true process with other seeds (oracle).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.datasets.registry import (
    get_training_recordings,
    open_dataset,
)
from hnf_core.field.stroke import uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import read_trained_material
from hnf_core.metrics.spectra import (
    WINDOW_SAMPLES,
    average_spectrum_distance_db,
    hann_window,
    welch,
    window_magnitudes,
)
from hnf_core.training.from_recordings import TrainingOverrides, train_from_recordings

from ..baselines.piecewise_ar import compute_power_spectrum
from ..evaluation.bounds import (
    compute_bounds,
    measure_repetition,
)

SPEEDS_M_S, FORCES_N = (0.05, 0.1, 0.15), (0.5, 1.0, 2.0)
RANGE_SHARE = 0.99
STROKE_S = 8.0
REALISATIONS = 24
"""Realisations of the true process at each condition, for the metric bounds."""
RATE = 10_000.0
"""Sample rate [Hz]."""


@dataclass(frozen=True)
class Row:
    """Means over conditions and seeds. cpu_s: processor time for making the strokes and training [s]."""

    material: str
    seconds: float
    distance_db: float
    oracle_db: float
    bias_db: float
    mse_over_oracle: float
    repetition: float
    oracle_repetition: float
    cpu_s: float


def evaluate_texture(job: tuple[Path, str, float, int]) -> Row:
    folder, material, seconds, seeds = job
    data = open_dataset("hatt", folder)
    process = data.process(material)
    assert process is not None
    start = time.process_time()
    trained, _ = train_from_recordings(
        get_training_recordings(data, material, seconds, 0), "hatt", "", 0, TrainingOverrides()
    )
    cpu_s = time.process_time() - start
    trained_material, limits_of_action = read_trained_material(trained.field, material), data.action_range(material)
    metrics: list[tuple[float, ...]] = []
    for speed in SPEEDS_M_S:
        for force in FORCES_N:
            condition = (
                min(speed, RANGE_SHARE * limits_of_action.speed_m_s[1]),
                min(force, RANGE_SHARE * limits_of_action.force_n[1]),
            )
            action = make_steady_action(STROKE_S, *condition)
            exact, power = smooth_by_window(process.model, *condition)
            truth = [recording.samples for recording in process.record([action] * REALISATIONS, 1000)]
            limits = compute_bounds([window_magnitudes(recording) for recording in truth])
            for seed in range(seeds):
                stroke = uniform_stroke(action, trained_material.token, trained_material.mechanics)
                rendered = synthesise(trained.field, stroke, seed=seed).signal.samples.astype(np.float64)
                metrics.append(_compute_metrics(rendered, truth[seed % REALISATIONS], limits, exact, power))
    return Row(material, seconds, *np.mean(metrics, axis=0), cpu_s)  # type: ignore[arg-type]


def _compute_metrics(ours, oracle, limits, exact, power) -> tuple[float, ...]:  # type: ignore[no-untyped-def]
    frequency, density = welch(ours, RATE)
    return (
        average_spectrum_distance_db(density, exact, frequency),
        average_spectrum_distance_db(welch(oracle, RATE)[1], exact, frequency),
        10.0 * np.log10(np.mean(np.square(ours)) / power),
        limits.expected_mse(window_magnitudes(ours)) / limits.oracle,
        measure_repetition(ours, RATE),
        measure_repetition(oracle, RATE),
    )


def smooth_by_window(model, speed: float, force: float) -> tuple[np.ndarray, float]:  # type: ignore[no-untyped-def]
    """Return the (501,) exact density as a Hann window of 1000 samples shows it, and the total power."""
    fine = 20
    count = WINDOW_SAMPLES * fine // 2
    frequency = np.arange(count + 1) * (RATE / (WINDOW_SAMPLES * fine))
    density = compute_power_spectrum(model, speed, force, frequency)
    both = np.concatenate([density, density[-2:0:-1]])
    kernel = np.square(np.abs(np.fft.fft(hann_window(WINDOW_SAMPLES), WINDOW_SAMPLES * fine)))
    blurred = np.fft.ifft(np.fft.fft(both) * np.fft.fft(kernel / kernel.sum())).real
    return blurred[: count + 1 : fine], float(np.sum(density) * (RATE / (WINDOW_SAMPLES * fine)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("materials", nargs="*", metavar="MATERIAL")
    parser.add_argument("--seconds", type=float, nargs="+", default=[480.0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    materials = arguments.materials or list(open_dataset("hatt", arguments.folder).materials)
    jobs = [(arguments.folder, name, seconds, arguments.seeds) for seconds in arguments.seconds for name in materials]
    print(
        "| texture | trained from | distance dB | oracle dB | power dB | MSE / oracle | repetition (oracle) | CPU s |"
    )
    print("|---|---|---|---|---|---|---|---|")
    rows: list[Row] = []
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        for row in pool.map(evaluate_texture, jobs):
            rows.append(row)
            print(
                f"| {row.material} | {row.seconds:g} s | {row.distance_db:.2f} | {row.oracle_db:.2f} | "
                f"{row.bias_db:+.2f} | {row.mse_over_oracle:.3f} | "
                f"{row.repetition:.2f} ({row.oracle_repetition:.2f}) | {row.cpu_s:.0f} |",
                flush=True,
            )
    for seconds in arguments.seconds:
        selected = [row for row in rows if row.seconds == seconds]
        distance, bias, ratio = (
            np.array([getattr(row, key) for row in selected]) for key in ("distance_db", "bias_db", "mse_over_oracle")
        )
        print(
            f"| **median (worst)** | {seconds:g} s | {np.median(distance):.2f} ({distance.max():.2f}) | | "
            f"{np.median(bias):+.2f} ({bias[np.argmax(np.abs(bias))]:+.2f}) | "
            f"{np.median(ratio):.3f} ({ratio[np.argmax(np.abs(ratio - 1.0))]:.3f}) | | |"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
