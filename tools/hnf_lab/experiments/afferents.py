"""Hold the finger's levels against fingertip afferents: rank against firing rates, level against published thresholds.

Usage: python -m hnf_lab.experiments.afferents FOLDER [--force N]

FOLDER holds mean_rates.csv: texture, speed_mm_s, and rates SA_imp_s, RA_imp_s, PC_imp_s [impulses/s] (A. I. Weber et
al. 2013, PNAS 110). Every texture whose name means a library material is synthesised under the finger; textures of one
material are averaged. Vibration of 50 to 800 Hz drives PC fibres, so their rates should rank as its level does. No
constant of the finger or of a class is fitted to these rates.

The absolute level is held between two published bounds. Fibres that fire have passed their absolute threshold (A. W.
Freeman & K. O. Johnson 1982, J. Physiol. 323), and at their tuning threshold they fire once a cycle. Vibration that
masks what slip makes on a fine surface is no weaker than that (C. J. Dallmann, M. O. Ernst & A. Moscatelli 2015, J.
Neurophysiol. 114).
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.errors import MaterialError
from hnf_core.field.field import Field
from hnf_core.field.stroke import uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.library import LibraryMaterial
from hnf_core.material.ranking import find_material
from hnf_core.metrics.spectra import welch

Float = NDArray[np.float64]
Spectrum = tuple[Float, Float]

BAND_HZ = (50.0, 800.0)
"""Vibration that drives PC fibres [Hz]."""
SETTLE_S, SECONDS = 0.25, 2.0
"""Start of a stroke that is left out, and the rest [s]."""
SPEEDS_MM_S = (40, 80, 120)
PC_HZ = (9.9, 19.0, 39.0, 79.3, 161.0, 205.0)
PC_ABSOLUTE_UM = (55.4, 10.2, 5.84, 0.960, 0.544, 0.372)
PC_TUNING_UM = (98.9, 21.5, 9.42, 2.14, 2.29, 2.26)
"""Amplitudes of skin displacement at which Pacinian fibres of macaques begin to fire, and fire once a cycle.

Means of nine fibres by Freeman & Johnson 1982, as read from their figure for TouchSim (freq_response_FJdata.mat in
github.com/nbso13/bensmaia_gelsight_scripts). There are none above 205 Hz; the last amplitude is kept, since human units
fire about as often a cycle from 100 to 400 Hz (R. S. Johansson, U. Landström & R. Lundström 1982, Brain Res. 244). If
they mean peak to peak, thresholds are 6 dB lower.
"""
PC_BAND_HZ = (40.0, 800.0)
MASKERS_UM = {64: 65.0, 128: 10.0, 256: 1.0}
"""Frequency [Hz] → peak-to-peak displacement of vibration that masks slip on a fine surface (Dallmann et al. 2015)."""


@dataclass(frozen=True)
class AfferentTexture:
    """Texture with mean firing rates.

    Attributes
    ----------
    name
        Name in the table.
    rates
        Impulses/s by (fibre, speed in mm/s), for example ("PC", 80).
    """

    name: str
    rates: dict[tuple[str, int], float]


def read_rates(folder: Path) -> list[AfferentTexture]:
    """Read the table of firing rates."""
    with (folder / "mean_rates.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    textures = {row["texture"]: AfferentTexture(row["texture"], {}) for row in rows}
    for row in rows:
        for fibre in ("SA", "RA", "PC"):
            if row[f"{fibre}_imp_s"]:
                textures[row["texture"]].rates[fibre, round(float(row["speed_mm_s"]))] = float(row[f"{fibre}_imp_s"])
    return list(textures.values())


def compute_density(
    field: Field, material: LibraryMaterial, speed: float, force: float, probe: str = "finger"
) -> tuple[Float, Float]:
    """Return frequencies [Hz] and density [(m/s²)²/Hz] of what a probe feels at a speed [m/s] and force [N]."""
    count = round((SECONDS + SETTLE_S) * ACTION_RATE_HZ) + 1
    direction = np.tile([np.cos(0.3), np.sin(0.3)], (count, 1))
    position = speed * np.arange(count) / ACTION_RATE_HZ
    action = Action(
        ACTION_RATE_HZ,
        direction,
        np.full(count, speed),
        np.full(count, force),
        position,
        np.ones(count, dtype=bool),
        probe,
    )
    signal = synthesise(field, uniform_stroke(action, material.token, material.mechanics), seed=0).signal
    steady = signal.samples[round(SETTLE_S * signal.sample_rate) :].astype(np.float64)
    return welch(steady, signal.sample_rate, 2000)


def sum_band(frequency: Float, density: Float, low: float, high: float) -> float:
    """Return the level [dB] of a density between two frequencies."""
    inside = (frequency >= low) & (frequency <= high)
    return float(10.0 * np.log10(max(density[inside].sum() * (frequency[1] - frequency[0]), 1e-30)))


def compute_threshold(frequency: Float, amplitude_um: Sequence[float]) -> Float:
    """Return a threshold as RMS acceleration [m/s²] of a sine at frequencies [Hz]: a = (2πf)² A / √2."""
    amplitude = 1e-6 * np.exp(np.interp(np.log(frequency), np.log(PC_HZ), np.log(amplitude_um)))
    return np.asarray(np.square(2.0 * np.pi * frequency) * amplitude / np.sqrt(2.0))


def compute_level_over(frequency: Float, density: Float, amplitude_um: Sequence[float]) -> float:
    """Return the level [dB] of PC_BAND_HZ over a threshold, powers of all frequencies added."""
    threshold = compute_threshold(np.maximum(frequency, 1.0), amplitude_um)
    return sum_band(frequency, density / np.square(threshold), *PC_BAND_HZ)


def bootstrap_rank(levels: Sequence[float], rates: Sequence[float], seed: int = 0) -> tuple[float, float, float]:
    """Return Spearman's rank correlation and its 95 % interval, bootstrapped over classes."""
    x, y = np.asarray(levels), np.asarray(rates)
    rng = np.random.default_rng(seed)
    draws = []
    for _ in range(2000):
        rows = rng.integers(0, len(x), len(x))
        if len(set(rows)) > 2:
            draws.append(spearmanr(x[rows], y[rows]).statistic)
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    return float(spearmanr(x, y).statistic), float(low), float(high)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--force", type=float, default=0.25, help="normal force [N] (default 0.25)")
    arguments = parser.parse_args()
    field = load_field()
    classes: dict[str, list[AfferentTexture]] = {}
    materials: dict[str, LibraryMaterial] = {}
    for texture in read_rates(arguments.folder):
        try:
            material, _ = find_material(texture.name)
        except MaterialError:
            print(f"{texture.name}: no word matches, left out", file=sys.stderr)
            continue
        classes.setdefault(material.name, []).append(texture)
        materials[material.name] = material
    densities = {
        (name, speed): compute_density(field, materials[name], 1e-3 * speed, arguments.force)
        for name in classes
        for speed in SPEEDS_MM_S
    }
    print("\n".join([*compare_ranks(classes, densities), "", *compare_levels(classes, densities)]))
    return 0


def compare_ranks(classes: dict[str, list[AfferentTexture]], densities: dict[tuple[str, int], Spectrum]) -> list[str]:
    """Return a Markdown table of levels beside rates, and the rank correlations."""
    levels = {key: sum_band(*density, *BAND_HZ) for key, density in densities.items()}
    weighted = {key: compute_level_over(*density, PC_ABSOLUTE_UM) for key, density in densities.items()}
    lines = [
        "| material | textures | 40 mm/s | 80 mm/s | 120 mm/s | PC at 80 | RA at 80 |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name, group in sorted(classes.items(), key=lambda item: -levels[item[0], 80]):
        low, middle, high = (levels[name, speed] for speed in SPEEDS_MM_S)
        pc, ra = average_rate(group, ("PC", 80)), average_rate(group, ("RA", 80))
        textures = ", ".join(each.name for each in group)
        lines.append(f"| {name} | {textures} | {low:.1f} | {middle:.1f} | {high:.1f} | {pc:.0f} | {ra:.0f} |")
    lines.append("")
    for key in (("PC", 40), ("PC", 80), ("RA", 40), ("RA", 80)):
        rates = [average_rate(group, key) for group in classes.values()]
        plain = bootstrap_rank([levels[name, key[1]] for name in classes], rates)
        line = f"{key[0]} at {key[1]} mm/s: rank correlation {plain[0]:+.2f} (95 % {plain[1]:+.2f} to {plain[2]:+.2f})"
        if key[0] == "PC":
            other = bootstrap_rank([weighted[name, key[1]] for name in classes], rates)
            line += f", weighted by thresholds {other[0]:+.2f} ({other[1]:+.2f} to {other[2]:+.2f})"
        lines.append(line)
    rising = np.mean([levels[name, 80] > levels[name, 40] for name in classes])
    lines.append(f"level rises from 40 to 80 mm/s on {100.0 * rising:.0f} % of {len(classes)} classes")
    return lines


def compare_levels(classes: dict[str, list[AfferentTexture]], densities: dict[tuple[str, int], Spectrum]) -> list[str]:
    """Return Markdown tables of levels at 80 mm/s over published thresholds of PC fibres, and beside maskers."""
    lines = [
        "| material | RMS [m/s²] | over absolute threshold [dB] | over tuning threshold [dB] | PC at 80 |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    over = {name: compute_level_over(*densities[name, 80], PC_ABSOLUTE_UM) for name in classes}
    for name, group in sorted(classes.items(), key=lambda item: -over[item[0]]):
        rms = 10.0 ** (sum_band(*densities[name, 80], *BAND_HZ) / 20.0)
        tuned = compute_level_over(*densities[name, 80], PC_TUNING_UM)
        rate = average_rate(group, ("PC", 80))
        lines.append(f"| {name} | {rms:.2f} | {over[name]:+.1f} | {tuned:+.1f} | {rate:.0f} |")
    lines += [
        "",
        "| octave | masker [m/s²] | ours [m/s²]: median | 10 % | 90 % |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for frequency, amplitude in MASKERS_UM.items():
        octave = (frequency / np.sqrt(2.0), frequency * np.sqrt(2.0))
        ours = [10.0 ** (sum_band(*densities[name, 80], *octave) / 20.0) for name in classes]
        low, middle, high = np.percentile(ours, [10, 50, 90])
        masker = convert_masker(frequency, amplitude)
        lines.append(f"| {frequency} Hz | {masker:.2f} | {middle:.2f} | {low:.2f} | {high:.2f} |")
    return lines


def convert_masker(frequency_hz: float, peak_to_peak_um: float) -> float:
    """Return the RMS acceleration [m/s²] of a sine of a peak-to-peak displacement: a = (2πf)² d / √8."""
    return float(np.square(2.0 * np.pi * frequency_hz) * 1e-6 * peak_to_peak_um / np.sqrt(8.0))


def average_rate(group: Sequence[AfferentTexture], key: tuple[str, int]) -> float:
    """Return the mean rate [impulses/s] of textures under a fibre and speed."""
    return float(np.mean([each.rates[key] for each in group if key in each.rates]))


if __name__ == "__main__":
    sys.exit(main())
