"""Procedural micro-geometry: from a recipe (parameters in physical units) and a seed to one period of a height map.

A height map is (pixels, pixels) float32 in metres, mean 0, periodic on its tile; column → +x, row → −y (the patch frame
of tactile maps), pixel (0, 0) at the origin. Angles are counted from +x towards +y. A recipe is a sum of self-affine
noise with a roll-off (B. N. J. Persson et al. 2005, J. Phys.: Condens. Matter 17 R1, "On the nature of surface
roughness"), lattices (weave, knurl, grating), and grains or pits, which give skewness (K. J. Stout & L. Blunt 2000,
Three-Dimensional Surface Topography).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError

TILE_SIZE_M = 20e-3
"""Side of a tile [m]."""
TILE_PIXELS = 512
"""Side of a tile [pixels]."""

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Self-affine Gaussian roughness.

    Attributes
    ----------
    rms_m : float
        RMS height [m].
    slope : float
        Exponent β of the profile's spectrum κ^−β (Hurst exponent (β − 1) / 2).
    rolloff_m : float
        Wavelength above which the spectrum is flat [m].
    cutoff_m : float
        Wavelength below which it falls off as a Gaussian [m].
    stretch : float
        Length of features along `angle_rad` (the grain) over that across it.
    angle_rad : float
        Direction of the grain [rad].
    """

    rms_m: float
    slope: float = 2.6
    rolloff_m: float = 2e-3
    cutoff_m: float = 60e-6
    stretch: float = 1.0
    angle_rad: float = 0.0


@dataclass(frozen=True)
class Lattice:
    """A sum of plane waves with a whole number of periods on the tile: weave, knurl, grating.

    Attributes
    ----------
    rms_m : float
        RMS height [m].
    waves : tuple of (int, int, float, float)
        Periods along x and y, relative amplitude, phase [rad].
    irregularity : float
        RMS displacement of the lattice over the shortest wave's pitch (threads are not straight).
    irregularity_m : float
        Correlation length of that displacement [m].
    """

    rms_m: float
    waves: tuple[tuple[int, int, float, float], ...]
    irregularity: float = 0.0
    irregularity_m: float = 3e-3


@dataclass(frozen=True)
class Grains:
    """Rounded grains (sign > 0) or pits (sign < 0) at random positions.

    Attributes
    ----------
    rms_m : float
        RMS height [m].
    diameter_m : float
        Median diameter [m].
    cover : float
        Summed area of all grains over the area of the tile.
    sign : int
        1 for grains, −1 for pits.
    spread : float
        Standard deviation of the logarithm of the diameter.
    stretch, angle_rad : float
        Elongation and its direction, as in `Noise` (pores of wood).
    """

    rms_m: float
    diameter_m: float
    cover: float = 0.3
    sign: int = 1
    spread: float = 0.3
    stretch: float = 1.0
    angle_rad: float = 0.0


@dataclass(frozen=True)
class SurfaceRecipe:
    """Parameters of a generated surface, the sum of its parts: noise, lattices, grains or pits."""

    noise: tuple[Noise, ...] = ()
    lattices: tuple[Lattice, ...] = ()
    grains: tuple[Grains, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Convert to a dict for JSON, which `from_dict` reads."""
        return asdict(self)

    @staticmethod
    def from_dict(record: Mapping[str, Any]) -> SurfaceRecipe:
        """Read a dict of `to_dict`; raise MaterialError if it is no recipe."""
        try:
            lattices = [dict(part) for part in record.get("lattices", ())]
            for part in lattices:
                part["waves"] = tuple((int(x), int(y), float(a), float(p)) for x, y, a, p in part["waves"])
            return SurfaceRecipe(
                noise=tuple(Noise(**part) for part in record.get("noise", ())),
                lattices=tuple(Lattice(**part) for part in lattices),
                grains=tuple(Grains(**part) for part in record.get("grains", ())),
            )
        except (TypeError, ValueError, KeyError) as error:
            raise MaterialError(
                f"not a surface recipe ({error}).", remedy="Expected noise, lattices and grains as SurfaceRecipe."
            ) from error

    def scale_heights(self, factor: float) -> SurfaceRecipe:
        """Return the recipe with all heights times `factor`."""
        record = self.to_dict()
        for parts in record.values():
            for part in parts:
                part["rms_m"] *= factor
        return SurfaceRecipe.from_dict(record)


def height_map(
    recipe: SurfaceRecipe, seed: int, *, pixels: int = TILE_PIXELS, size_m: float = TILE_SIZE_M
) -> NDArray[np.float32]:
    """Render one period of a surface as a height map.

    Parameters
    ----------
    recipe : SurfaceRecipe
        Parameters of the surface; each part's RMS height over the tile is exactly its rms_m.
    seed : int
        Seed; the same seed gives the same bytes.
    pixels : int
        Side of the map [pixels].
    size_m : float
        Side of the tile [m].

    Returns
    -------
    ndarray of float32, shape (pixels, pixels)
        Heights [m].

    Raises
    ------
    MaterialError
        For a lattice whose pitch is below two pixels.
    """
    rng = np.random.default_rng(seed)
    total = np.zeros((pixels, pixels))
    for noise in recipe.noise:
        amplitude = np.sqrt(noise_power(noise, pixels, size_m))
        total += _scale_to_rms(_filtered_noise(rng, amplitude, pixels), noise.rms_m)
    for lattice in recipe.lattices:
        total += _scale_to_rms(_render_lattice(lattice, rng, pixels, size_m), lattice.rms_m)
    for grains in recipe.grains:
        total += _scale_to_rms(_render_grains(grains, rng, pixels, size_m), grains.rms_m)
    return total.astype(np.float32)


def wavenumbers(pixels: int, size_m: float) -> tuple[Float, Float]:
    """Return κx (1, pixels//2 + 1) and κy (pixels, 1) of a map's rfft2 bins [cycles/m]; κy points up (−row)."""
    kx = np.fft.rfftfreq(pixels, size_m / pixels)[None, :]
    ky = -np.fft.fftfreq(pixels, size_m / pixels)[:, None]
    return kx, ky


def _scale_to_rms(height: Float, rms_m: float) -> Float:
    height = height - height.mean()
    spread = float(np.sqrt(np.mean(np.square(height))))
    return height * (rms_m / spread) if spread > 0.0 else height


def _filtered_noise(rng: np.random.Generator, gain: Float, pixels: int) -> Float:
    return np.fft.irfft2(np.fft.rfft2(rng.standard_normal((pixels, pixels))) * gain, (pixels, pixels))


def noise_power(noise: Noise, pixels: int, size_m: float) -> Float:
    """Return the relative power (pixels, pixels // 2 + 1) of a noise in the rfft2 bins of a map."""
    kx, ky = wavenumbers(pixels, size_m)
    along = kx * np.cos(noise.angle_rad) + ky * np.sin(noise.angle_rad)
    across = -kx * np.sin(noise.angle_rad) + ky * np.cos(noise.angle_rad)
    kappa2 = np.square(along * noise.stretch) + np.square(across)
    # A profile's κ^−β corresponds to a surface's κ^−(β+1) in power.
    power = (1.0 + kappa2 * noise.rolloff_m**2) ** (-(noise.slope + 1.0) / 2.0)
    return np.asarray(power * np.exp(-(np.square(kx) + np.square(ky)) * noise.cutoff_m**2))


def get_pitch(lattice: Lattice) -> float:
    """Return the wavelength [m] of a lattice's strongest wave."""
    x, y = max(lattice.waves, key=lambda wave: abs(wave[2]))[:2]
    return float(TILE_SIZE_M / np.hypot(x, y))


def get_pitch_scatter(lattice: Lattice) -> float:
    """Return the RMS displacement [m] of a lattice along each axis."""
    return float(lattice.irregularity * TILE_SIZE_M / max(np.hypot(x, y) for x, y, *_ in lattice.waves))


def _render_lattice(lattice: Lattice, rng: np.random.Generator, pixels: int, size_m: float) -> Float:
    finest = max((max(abs(x), abs(y)) for x, y, _, _ in lattice.waves), default=0)
    if 2 * finest >= pixels:
        raise MaterialError(
            f"a lattice with {finest} periods does not fit on {pixels} pixels.",
            remedy="Use fewer periods or a finer tile.",
        )
    grid = np.arange(pixels) * (size_m / pixels)
    x, y = np.broadcast_to(grid[None, :], (pixels, pixels)), np.broadcast_to(-grid[:, None], (pixels, pixels))
    if lattice.irregularity > 0.0:
        kx, ky = wavenumbers(pixels, size_m)
        smooth = np.exp(-0.5 * (np.square(kx) + np.square(ky)) * lattice.irregularity_m**2)
        shift = get_pitch_scatter(lattice) * (size_m / TILE_SIZE_M)
        x = x + _scale_to_rms(_filtered_noise(rng, smooth, pixels), shift)
        y = y + _scale_to_rms(_filtered_noise(rng, smooth, pixels), shift)
    height = np.zeros((pixels, pixels))
    for periods_x, periods_y, amplitude, phase in lattice.waves:
        height += amplitude * np.cos((2.0 * np.pi / size_m) * (periods_x * x + periods_y * y) + phase)
    return height


def _render_grains(grains: Grains, rng: np.random.Generator, pixels: int, size_m: float) -> Float:
    spectrum = np.zeros((pixels, pixels // 2 + 1), dtype=np.complex128)
    offset = (np.fft.fftfreq(pixels) * size_m)[None, :]
    along = offset * np.cos(grains.angle_rad) - offset.T * np.sin(grains.angle_rad)
    across = -offset * np.sin(grains.angle_rad) - offset.T * np.cos(grains.angle_rad)
    # Three sizes approximate the log-normal spread: nodes of its Gauss–Hermite quadrature, of equal area.
    for node in (-1.0, 0.0, 1.0):
        diameter = grains.diameter_m * float(np.exp(1.2247 * grains.spread * node))
        count = max(1, round(grains.cover / 3.0 * size_m**2 / (np.pi / 4.0 * diameter**2 * grains.stretch)))
        impulses = np.zeros(pixels * pixels)
        np.add.at(impulses, rng.integers(0, pixels * pixels, count), rng.uniform(0.5, 1.0, count))
        cap = np.maximum(
            1.0 - np.square(2.0 * along / (diameter * grains.stretch)) - np.square(2.0 * across / diameter), 0
        )
        spectrum += np.fft.rfft2(impulses.reshape(pixels, pixels)) * np.fft.rfft2(cap * diameter)
    return np.asarray(np.sign(grains.sign) * np.fft.irfft2(spectrum, (pixels, pixels)))


def _round_periods(pitch_m: float, multiple: int = 1) -> int:
    """Return the number of periods on the tile nearest to a pitch [m], a positive multiple of `multiple`."""
    return multiple * max(1, round(TILE_SIZE_M / pitch_m / multiple))


def grating(rms_m: float, pitch_m: float, *, harmonic: float = 0.3, irregularity: float = 0.0) -> Lattice:
    """Make grooves along y, so that a stroke along x crosses them; `harmonic` is the second harmonic's weight."""
    n = _round_periods(pitch_m)
    return Lattice(rms_m, ((n, 0, 1.0, 0.0), (2 * n, 0, harmonic, 0.0)), irregularity)


def plain_weave(rms_m: float, thread_m: float, *, weft_m: float | None = None, irregularity: float = 0.05) -> Lattice:
    """Make a plain weave of a thread pitch [m]: a checkerboard of crests at twice the pitch, and the threads."""
    x, y = _round_periods(thread_m, 2), _round_periods(weft_m or thread_m, 2)
    waves = ((x // 2, y // 2, 1.0, 0.0), (x // 2, -y // 2, 1.0, 0.0), (x, 0, 0.5, 0.0), (0, y, 0.4, 0.0))
    return Lattice(rms_m, waves, irregularity)


def twill(rms_m: float, thread_m: float, *, repeat: int = 3, irregularity: float = 0.05) -> Lattice:
    """Make diagonal ribs every `repeat` threads (denim: 3; carbon-fibre 2/2 twill: 4), and the threads themselves."""
    n = _round_periods(thread_m, repeat)
    waves = ((n // repeat, n // repeat, 1.0, 0.0), (n, 0, 0.5, 0.0), (0, n, 0.35, 0.0), (n, n, 0.2, 0.0))
    return Lattice(rms_m, waves, irregularity)


def knurl(rms_m: float, pitch_m: float, *, irregularity: float = 0.0) -> Lattice:
    """Make crossed grooves at ±45°, with the second harmonic of cut pyramids."""
    n = max(1, round(_round_periods(pitch_m) / np.sqrt(2.0)))
    waves = ((n, n, 1.0, 0.0), (n, -n, 1.0, 0.0), (2 * n, 2 * n, 0.25, 0.0), (2 * n, -2 * n, 0.25, 0.0))
    return Lattice(rms_m, waves, irregularity)


def random_recipe(rng: np.random.Generator) -> SurfaceRecipe:
    """Draw a recipe from the range of everyday materials: always noise, often anisotropic, with lattices or grains."""
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
        lattice = (
            grating(level, pitch, harmonic=rng.uniform(0.0, 0.6), irregularity=irregularity)
            if kind == 0
            else plain_weave(level, pitch, weft_m=pitch * rng.uniform(0.7, 1.4), irregularity=irregularity)
            if kind == 1
            else twill(level, pitch, repeat=int(rng.integers(3, 5)), irregularity=irregularity)
            if kind == 2
            else knurl(level, pitch, irregularity=irregularity)
        )
        lattices = (_rotate_90(lattice) if rng.random() < 0.5 else lattice,)
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
    """Rotate a lattice by 90°, the only rotation that preserves whole periods and pitch."""
    return Lattice(
        lattice.rms_m,
        tuple((-y, x, a, p) for x, y, a, p in lattice.waves),
        lattice.irregularity,
        lattice.irregularity_m,
    )
