"""Ready-made surfaces: lattices by their everyday names, and random recipes to train on."""

from __future__ import annotations

import numpy as np

from .surface import TILE_SIZE_M, Grains, Lattice, Noise, SurfaceRecipe


def _round_periods(pitch_m: float, multiple: int = 1) -> int:
    """Whole number of periods nearest to pitch_m on the tile, a multiple of `multiple`, at least one of them."""
    return multiple * max(1, round(TILE_SIZE_M / pitch_m / multiple))


def grating(rms_m: float, pitch_m: float, *, harmonic: float = 0.3, irregularity: float = 0.0) -> Lattice:
    """Grooves along y, so that a stroke along x crosses them; harmonic: amplitude of the second harmonic."""
    n = _round_periods(pitch_m)
    return Lattice(rms_m, ((n, 0, 1.0, 0.0), (2 * n, 0, harmonic, 0.0)), irregularity)


def plain_weave(rms_m: float, thread_m: float, *, weft_m: float | None = None, irregularity: float = 0.05) -> Lattice:
    """Threads one over, one under: a checkerboard of crests of twice the thread pitch, and the threads themselves."""
    x, y = _round_periods(thread_m, 2), _round_periods(weft_m or thread_m, 2)
    waves = ((x // 2, y // 2, 1.0, 0.0), (x // 2, -y // 2, 1.0, 0.0), (x, 0, 0.5, 0.0), (0, y, 0.4, 0.0))
    return Lattice(rms_m, waves, irregularity)


def twill(rms_m: float, thread_m: float, *, repeat: int = 3, irregularity: float = 0.05) -> Lattice:
    """Diagonal ribs every `repeat` threads (denim: 3; carbon-fibre 2/2 twill: 4), and the threads themselves."""
    n = _round_periods(thread_m, repeat)
    waves = ((n // repeat, n // repeat, 1.0, 0.0), (n, 0, 0.5, 0.0), (0, n, 0.35, 0.0), (n, n, 0.2, 0.0))
    return Lattice(rms_m, waves, irregularity)


def knurl(rms_m: float, pitch_m: float, *, irregularity: float = 0.0) -> Lattice:
    """Crossed grooves under ±45°, with the second harmonic of cut pyramids."""
    n = max(1, round(_round_periods(pitch_m) / np.sqrt(2.0)))
    waves = ((n, n, 1.0, 0.0), (n, -n, 1.0, 0.0), (2 * n, 2 * n, 0.25, 0.0), (2 * n, -2 * n, 0.25, 0.0))
    return Lattice(rms_m, waves, irregularity)


EXAMPLE_RECIPES = {
    "rough": SurfaceRecipe(noise=(Noise(6e-6),)),
    "grained": SurfaceRecipe(noise=(Noise(4e-6, stretch=8.0),)),
    "woven": SurfaceRecipe(noise=(Noise(3e-6),), lattices=(plain_weave(12e-6, 0.4e-3),)),
    "grating": SurfaceRecipe(noise=(Noise(1e-6),), lattices=(grating(8e-6, 0.5e-3),)),
    "pitted": SurfaceRecipe(noise=(Noise(3e-6),), grains=(Grains(6e-6, 0.4e-3, sign=-1),)),
}


def random_recipe(rng: np.random.Generator) -> SurfaceRecipe:
    """A surface drawn from the whole range of everyday materials: always noise, often grain, lattices, pits."""
    rms = 10.0 ** rng.uniform(-6.2, -4.6)
    angle = rng.uniform(0.0, np.pi)
    stretch = 1.0 if rng.random() < 0.5 else float(np.exp(rng.uniform(0.3, 3.0)))
    noise = Noise(
        rms_m=rms,
        slope=rng.uniform(1.6, 3.4),
        rolloff_m=float(np.exp(rng.uniform(np.log(0.3e-3), np.log(6e-3)))),
        cutoff_m=rng.uniform(30e-6, 150e-6),
        stretch=stretch,
        angle_rad=angle,
    )
    lattices: tuple[Lattice, ...] = ()
    if rng.random() < 0.45:
        level = rms * float(np.exp(rng.uniform(-0.7, 1.5)))
        pitch = float(np.exp(rng.uniform(np.log(0.25e-3), np.log(2.5e-3))))
        irregularity = rng.uniform(0.0, 0.12)
        kind = rng.integers(0, 4)
        part = (
            grating(level, pitch, harmonic=rng.uniform(0.0, 0.6), irregularity=irregularity)
            if kind == 0
            else plain_weave(level, pitch, weft_m=pitch * rng.uniform(0.7, 1.4), irregularity=irregularity)
            if kind == 1
            else twill(level, pitch, repeat=int(rng.integers(3, 5)), irregularity=irregularity)
            if kind == 2
            else knurl(level, pitch, irregularity=irregularity)
        )
        lattices = (_rotate_90(part) if rng.random() < 0.5 else part,)
    grains: tuple[Grains, ...] = ()
    if rng.random() < 0.35:
        diameter = float(np.exp(rng.uniform(np.log(0.15e-3), np.log(1.5e-3))))
        grains = (
            Grains(
                rms_m=rms * float(np.exp(rng.uniform(-0.7, 1.0))),
                diameter_m=diameter,
                cover=rng.uniform(0.05, 0.8),
                sign=-1 if rng.random() < 0.5 else 1,
                stretch=stretch,
                angle_rad=angle,
            ),
        )
    return SurfaceRecipe((noise,), lattices, grains)


def _rotate_90(lattice: Lattice) -> Lattice:
    """The lattice turned by 90°: the only turn that keeps whole periods and pitch."""
    return Lattice(
        lattice.rms_m,
        tuple((-y, x, a, p) for x, y, a, p in lattice.waves),
        lattice.irregularity,
        lattice.irregularity_m,
    )
