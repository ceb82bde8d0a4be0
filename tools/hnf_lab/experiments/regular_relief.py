"""Regular surfaces beside the simulator: level over seeds, and spectrograms of a sweep from 50 to 200 mm/s.

    python -m hnf_lab.experiments.regular_relief [--picture FILE.png]

Gratings are measured reliefs under the path (height profiles); lattices are the library's, known by their tokens alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.field.field import Field
from hnf_core.field.stroke import HeightProfile, StrokeInput
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import get_material
from hnf_core.signal import dft321
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.simulate import SAMPLE_RATE_HZ, Stroke, simulate
from hnf_core.simulation.surface_recipe import TILE_SIZE_M, SurfaceRecipe, height_map

Float = NDArray[np.float64]

GRATINGS_M = ((0.5e-3, 5e-6), (1e-3, 10e-6), (2e-3, 25e-6), (4e-3, 50e-6))
"""Pitch and amplitude of the measured gratings [m]."""
LATTICES = ("ribbed-plastic", "corduroy", "knurled-metal", "cotton-canvas")
GRATING_MATERIAL = "smooth-plastic"
SECONDS, SEEDS = 2.0, 16
PROFILE_LENGTH_M = 0.8
PLACES = 6
"""Places of a lattice at which the simulator strokes it; between them its level varies by up to 3 dB."""
EDGE_S = 0.1
"""Beginning and end of a stroke that are not counted: the touch and the lift [s]."""


@dataclass(frozen=True)
class RegularSurface:
    """A surface to stroke along x: its map for the simulator, its token and its relief for the field."""

    name: str
    maps: SmoothedMaps
    token: NDArray[np.float32]
    mechanics: Mechanics
    profile: HeightProfile | None


def make_grating(pitch_m: float, amplitude_m: float) -> RegularSurface:
    """Make a grating of sine ridges across x, measured; the map holds a whole number of its waves."""
    from hnf_lab.shared_field.simulated_strokes import make_surface

    wave = amplitude_m * np.sin(2.0 * np.pi * np.arange(512) * (TILE_SIZE_M / 512) / pitch_m)
    surface = make_surface("grating", np.broadcast_to(wave, (512, 512)).astype(np.float32).copy())
    step = min(pitch_m / 16.0, 1e-4)
    place = np.arange(round(PROFILE_LENGTH_M / step)) * step - 0.1
    profile = HeightProfile(step, -0.1, amplitude_m * np.sin(2.0 * np.pi * place / pitch_m), 2.0 * step)
    name = f"grating of {1e3 * pitch_m:g} mm, measured"
    return RegularSurface(name, surface.maps, surface.token, get_material(GRATING_MATERIAL).mechanics, profile)


def make_lattice(name: str) -> RegularSurface:
    """Make a lattice of the library, which the field knows by its token."""
    material = get_material(name)
    maps = SmoothedMaps(height_map(SurfaceRecipe.from_dict(material.recipe), material.seed))
    return RegularSurface(name, maps, material.token, material.mechanics, None)


def make_sweep(slowest: float, fastest: float, seconds: float = SECONDS) -> Action:
    """Make a stroke along x at 1 N whose speed rises evenly between two speeds [m/s]."""
    time = np.arange(round(seconds * ACTION_RATE_HZ) + 1) / ACTION_RATE_HZ
    rise = (fastest - slowest) / seconds
    place, count = slowest * time + 0.5 * rise * time**2, len(time)
    return Action(
        ACTION_RATE_HZ, np.tile([1.0, 0.0], (count, 1)), slowest + rise * time, np.ones(count), place,
        np.ones(count, bool),
    )  # fmt: skip


def simulate_sweep(surface: RegularSurface, action: Action, start_m: tuple[float, float] = (1e-3, 1e-3)) -> Float:
    """Simulate a sweep over a surface from a place on and fuse its axes [m/s²]."""
    count = round(action.duration_s * SAMPLE_RATE_HZ)
    time = np.arange(count) / SAMPLE_RATE_HZ
    rise = (action.speed[-1] - action.speed[0]) / action.duration_s
    place = start_m[0] + action.speed[0] * time + 0.5 * rise * time**2
    stroke = Stroke(np.stack([place, np.full(count, start_m[1])], axis=1), np.ones(count))
    acceleration = simulate(surface.maps, stroke, surface.mechanics)
    return _cut_edges(dft321(acceleration - acceleration.mean(axis=0)))


def synthesise_sweep(field: Field, surface: RegularSurface, action: Action, seed: int) -> Float:
    """Synthesise a sweep over a surface [m/s²]."""
    index = np.zeros(len(action.speed), np.int32)
    token = surface.token[None].astype(np.float32)
    stroke = StrokeInput(action, token, (surface.mechanics,), index, surface.profile)
    return _cut_edges(np.asarray(synthesise(field, stroke, seed=seed).signal.samples, dtype=np.float64))


def _cut_edges(samples: Float) -> Float:
    edge = round(EDGE_S * SAMPLE_RATE_HZ)
    return samples[edge:-edge]


def compute_rms(samples: Float) -> float:
    """Return the RMS of a signal."""
    return float(np.sqrt(np.mean(np.square(samples))))


def measure_levels(
    field: Field, surfaces: Sequence[RegularSurface], speeds: Sequence[float], seeds: int = SEEDS
) -> list[str]:
    """Measure each surface at steady speeds [m/s] against the simulator; return the rows of a Markdown table."""
    rows = [
        "| surface | m/s | simulator m/s² | field − simulator, dB | over seeds, dB |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for surface in surfaces:
        for speed in speeds:
            action = make_sweep(speed, speed)
            starts = np.random.default_rng(0).uniform(0.0, TILE_SIZE_M, (PLACES if surface.profile is None else 1, 2))
            powers = [compute_rms(simulate_sweep(surface, action, (x, y))) ** 2 for x, y in starts.tolist()]
            simulated = float(np.sqrt(np.mean(powers)))
            found = [compute_rms(synthesise_sweep(field, surface, action, seed)) for seed in range(seeds)]
            levels = 20.0 * np.log10(np.array(found) / simulated)
            mean = float(levels.mean())
            spread = f"{levels.min() - mean:+.2f} … {levels.max() - mean:+.2f}"
            rows.append(f"| {surface.name} | {speed:g} | {simulated:.2f} | {mean:+.2f} | {spread} |")
    return rows


def draw_spectrograms(field: Field, surfaces: Sequence[RegularSurface], path: Path) -> None:
    """Draw spectrograms of a sweep from 50 to 200 mm/s, the simulator's above the field's."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    action = make_sweep(0.05, 0.2)
    figure, axes = plt.subplots(
        2, len(surfaces), figsize=(13.0, 4.6), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for column, surface in enumerate(surfaces):
        signals = simulate_sweep(surface, action), synthesise_sweep(field, surface, action, 0)
        for row, (samples, made_by) in enumerate(zip(signals, ("simulator", "field"), strict=True)):
            axis = axes[row, column]
            axis.specgram(samples, NFFT=1024, Fs=SAMPLE_RATE_HZ, noverlap=896, vmin=-70, vmax=0, cmap="magma")
            axis.set_ylim(0.0, 1000.0)
            title = f"{made_by} {compute_rms(samples):.2f} m/s²"
            axis.set_title(f"{surface.name}\n{title}" if row == 0 else title, fontsize=8)
        axes[1, column].set_xlabel("s")
    axes[0, 0].set_ylabel("Hz")
    axes[1, 0].set_ylabel("Hz")
    figure.savefig(path, dpi=80)
    plt.close(figure)


def main(words: Sequence[str] | None = None) -> int:
    """Print the table, and draw the picture if it is asked for."""
    parser = argparse.ArgumentParser(description="Regular surfaces beside the simulator.")
    parser.add_argument("--picture", type=Path, help="also draw spectrograms of six surfaces")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    arguments = parser.parse_args(words)
    field = load_field()
    gratings, lattices = [make_grating(*each) for each in GRATINGS_M], [make_lattice(name) for name in LATTICES]
    print("\n".join(measure_levels(field, [*gratings, *lattices], (0.1, 0.2), arguments.seeds)))
    if arguments.picture is not None:
        draw_spectrograms(field, [gratings[1], gratings[3], *lattices], arguments.picture)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
