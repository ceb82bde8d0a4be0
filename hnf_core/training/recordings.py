"""Simulated strokes → window powers: what the likelihood is fitted to."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from ..material.probe import PROBES
from ..metrics.spectra import WINDOW_SAMPLES, window_power
from ..simulation.dft321 import dft321
from ..simulation.simulate import SAMPLE_RATE_HZ, Stroke, simulate_batch, straight_stroke
from .conditions import SteadyStroke, make_speed_grid
from .surfaces import Surface

Float = NDArray[np.float64]

FINE_BINS = 100
"""Bins 1–100 of a 1000-sample window: 10–1000 Hz, DC left out."""
COARSE_EDGES_HZ = 1000.0 * 5.0 ** (np.arange(8) / 7.0)
"""Above, seven bands to 5 kHz, so that the total power is right too."""
SETTLE_S = 0.06
STROKES_PER_BATCH = 512


def pool_bins(power: Float) -> Float:
    """Window powers (…, 501) → (…, 107): fine bins, then the mean density of each coarse band."""
    frequency = np.fft.rfftfreq(WINDOW_SAMPLES, 1.0 / SAMPLE_RATE_HZ)
    fine = power[..., 1 : FINE_BINS + 1]
    coarse = [
        power[..., (frequency > low) & (frequency <= high)].mean(axis=-1) for low, high in pairwise(COARSE_EDGES_HZ)
    ]
    return np.concatenate([fine, np.stack(coarse, axis=-1)], axis=-1)


def compute_bin_widths() -> Float:
    """(107,) Hz that each observation stands for: density times width sums to power."""
    return np.concatenate([np.full(FINE_BINS, SAMPLE_RATE_HZ / WINDOW_SAMPLES), np.diff(COARSE_EDGES_HZ)])


def record_strokes(
    surfaces: Sequence[Surface], strokes: Sequence[SteadyStroke], seconds: float, workers: int = 2
) -> Float:
    """Mean observed power (n, 107) of `seconds` of each steady stroke, DFT321 over the whole of it.

    The result does not depend on the number of workers.
    """
    jobs: list[list[int]] = []
    for probe in PROBES:
        rows = sorted((row for row, stroke in enumerate(strokes) if stroke.probe == probe),
                      key=lambda row: (strokes[row].surface, strokes[row].force))  # fmt: skip
        jobs += [rows[low : low + STROKES_PER_BATCH] for low in range(0, len(rows), STROKES_PER_BATCH)]
    out = np.zeros((len(strokes), FINE_BINS + len(COARSE_EDGES_HZ) - 1))
    calls = [_make_job(surfaces, [strokes[row] for row in rows], seconds) for rows in jobs]
    with ProcessPoolExecutor(workers, mp_context=get_context("fork")) as pool:
        for done, (rows, power) in enumerate(zip(jobs, pool.map(_record_batch, calls), strict=True)):
            out[rows] = power
            print(f"\rsimulated {done + 1}/{len(jobs)} batches", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return out


RecordingJob = tuple[list[Surface], list[SteadyStroke], float]


def _make_job(surfaces: Sequence[Surface], strokes: list[SteadyStroke], seconds: float) -> RecordingJob:
    """Only the surfaces that a batch needs travel to its process."""
    used = sorted({stroke.surface for stroke in strokes})
    place = {surface: index for index, surface in enumerate(used)}
    local = [SteadyStroke(place[s.surface], s.mechanics, s.probe, s.speed, s.angle, s.force, s.start) for s in strokes]
    return [surfaces[index] for index in used], local, seconds


def _record_batch(job: RecordingJob) -> Float:
    surfaces, strokes, seconds = job
    speeds = make_speed_grid()
    acceleration = simulate_batch(
        [surfaces[stroke.surface].maps for stroke in strokes],
        [_make_path(stroke, float(speeds[stroke.speed]), seconds + SETTLE_S) for stroke in strokes],
        [stroke.mechanics for stroke in strokes],
        PROBES[strokes[0].probe],
    )
    kept = acceleration[:, round(SETTLE_S * SAMPLE_RATE_HZ) :]
    fused = dft321(kept - kept.mean(axis=1, keepdims=True))
    return np.stack([pool_bins(window_power(signal, SAMPLE_RATE_HZ)).mean(axis=0) for signal in fused])


def _make_path(stroke: SteadyStroke, speed: float, seconds: float) -> Stroke:
    return straight_stroke(speed, stroke.force, seconds, angle_rad=stroke.angle, start_m=stroke.start)
