"""Heights of the library beside measured ones: RMS along a line per octave of wavelength, and its slope.

Usage: python -m hnf_lab.experiments.heights FOLDER ...

A folder holds height profiles NAME.npy [m], 1.394 µm a sample (ThreeDWorld, PyImpact's scrape surfaces, BSD-2-Clause),
or height maps NAME.tmd (TrueMap and GelSight), whose metres are their own. Profiles are scan rows laid end to end and
smooth below some 0.5 mm, so that three octaves can be compared; of a map, those that it resolves and holds twice. No
height of the library is fitted to them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend

from hnf_core.field.carriers import Carriers
from hnf_core.field.linear_contact import compute_surface_spectrum, project_spectrum
from hnf_core.material.library import get_material

Float = NDArray[np.float64]

SAMPLE_M = 1.394068e-6
TMD_HEADER = 32
"""Bytes of a TrueMap file before its comment."""
OCTAVES_M = (2e-3, 1e-3, 0.5e-3)
"""Wavelengths about which an octave of a profile is compared [m]."""
MAP_OCTAVES_M = (*OCTAVES_M, 0.25e-3, 0.125e-3)
"""Wavelengths about which an octave of a map is compared [m]; the library's relief ends at 0.08 mm."""
LEAST_PIXELS, LEAST_WAVES = 4.0, 2.0
"""Least pixels a wave, and waves a line, of an octave that a map holds."""
COUNTERPARTS = {
    "acrylic": "smooth-plastic",
    "bass_wood": "pine-wood",
    "ceramic": "floor-tile",
    "plywood": "pine-wood",
    "polycarbonate": "smooth-plastic",
    "polyethylene": "smooth-plastic",
    "poplar_wood": "oak-wood",
    "pvc": "textured-plastic",
    "rough_wood": "rough-sawn-wood",
    "sandpaper": "sandpaper",
    "vinyl": "synthetic-leather",
}
"""Material of the library for each profile; sanded acrylic is left out, whose metres are wrong by its own README."""
MAP_COUNTERPARTS = {"paper": "copy-paper", "money": "copy-paper"}
"""Material of the library for each map; coins and a calibration groove are of no surface that it has."""
DIRECTIONS = 12


def read_tmd(path: Path) -> tuple[Float, tuple[float, float]]:
    """Read a TrueMap file: heights (h, w) [m], NaN where nothing was measured, and metres a pixel along x and y."""
    raw = path.read_bytes()
    start = raw.find(b"\0", TMD_HEADER) + 1
    if not raw[:TMD_HEADER].lower().startswith(b"binary truemap data file") or len(raw) < start + 24:
        raise ValueError(f"{path} is no TrueMap file. Choose a .tmd of version 2.")
    width, height = (int(each) for each in np.frombuffer(raw, "<i4", 2, start))
    length = np.frombuffer(raw, "<f4", 2, start + 8).astype(np.float64)
    if min(width, height) < 2 or not (length > 0.0).all() or len(raw) != start + 24 + 4 * width * height:
        raise ValueError(f"{path} is damaged: {width} × {height} heights were announced. Copy it again.")
    z = np.frombuffer(raw, "<f4", width * height, start + 24).astype(np.float64).reshape(height, width)
    return np.where(np.abs(z) < 1e3, 1e-3 * z, np.nan), (1e-3 * length[0] / width, 1e-3 * length[1] / height)


def measure_octaves(height: Float, sample_m: float = SAMPLE_M, octaves_m: Sequence[float] = OCTAVES_M) -> Float:
    """Return the RMS height (octaves,) of lines (..., n), each less its straight trend, about wavelengths [m]."""
    lines = detrend(np.atleast_2d(height), axis=-1)
    window = np.hanning(lines.shape[-1])
    power = np.square(np.abs(np.fft.rfft(lines * window, axis=-1))).mean(axis=0)
    power *= 2.0 / (lines.shape[-1] * np.square(window).sum())
    wavenumber = np.fft.rfftfreq(lines.shape[-1], sample_m)
    return np.array([
        np.sqrt(power[(wavenumber >= 2.0**-0.5 / each) & (wavenumber < 2.0**0.5 / each)].sum()) for each in octaves_m
    ])  # fmt: skip


def measure_map(height: Float, pixel_m: tuple[float, float]) -> Float:
    """Return the RMS height about MAP_OCTAVES_M along rows and columns alike; NaN for octaves that are not held."""
    power = np.zeros(len(MAP_OCTAVES_M))
    for lines, pixel in ((height, pixel_m[0]), (height.T, pixel_m[1])):
        whole = lines[np.isfinite(lines).all(axis=1)]
        if not len(whole):
            return np.full(len(MAP_OCTAVES_M), np.nan)
        held = [
            LEAST_PIXELS * pixel <= wave / 2.0**0.5 and LEAST_WAVES * wave <= lines.shape[1] * pixel
            for wave in MAP_OCTAVES_M
        ]
        power += np.where(held, 0.5 * np.square(measure_octaves(whole, pixel, MAP_OCTAVES_M)), np.nan)
    return np.sqrt(power)


def compute_library_octaves(token: NDArray[np.float32], octaves_m: Sequence[float] = OCTAVES_M) -> Float:
    """Return the RMS height (octaves,) along a line over a material about wavelengths, averaged over directions."""
    carriers = Carriers()
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    spectrum = compute_surface_spectrum(np.repeat(token[None], DIRECTIONS, axis=0), direction, carriers)
    power = project_spectrum(spectrum, np.ones_like(spectrum.noise), carriers).mean(axis=0)
    kappa = carriers.arc_centres()
    return np.array([
        np.sqrt(power[(kappa >= 2.0**-0.5 / each) & (kappa < 2.0**0.5 / each)].sum()) for each in octaves_m
    ])  # fmt: skip


def fit_slope(heights: Float, octaves_m: Sequence[float]) -> float:
    """Return the exponent H of height ∝ wavelength^H, fitted over octaves; NaN for fewer than two."""
    known = np.isfinite(heights) & (heights > 0.0)
    if known.sum() < 2:
        return float("nan")
    return float(np.polyfit(np.log(np.asarray(octaves_m)[known]), np.log(heights[known]), 1)[0])


def compare(octaves_m: Sequence[float], pairs: Sequence[tuple[str, str, Float]]) -> list[str]:
    """Return a Markdown table of measured and library heights per octave [µm], their distance [dB], and slopes.

    pairs: name, material of the library, measured RMS heights (octaves,) [m].
    """
    waves = " | ".join(f"{1e3 * each:g} mm" for each in octaves_m)
    rows = [f"| measured | library | {waves} | slope |", "| --- | --- |" + " ---: |" * (len(octaves_m) + 1)]
    for name, material, measured in pairs:
        ours = compute_library_octaves(get_material(material).token, octaves_m)
        cells = [
            f"{1e6 * a:.2f} / {1e6 * b:.2f} ({20.0 * np.log10(b / a):+.0f})" if np.isfinite(a) else "–"
            for a, b in zip(measured, ours, strict=True)
        ]
        slopes = [fit_slope(np.where(np.isfinite(measured), each, np.nan), octaves_m) for each in (measured, ours)]
        cells.append(f"{slopes[0]:.1f} / {slopes[1]:.1f}" if np.isfinite(slopes).all() else "–")
        rows.append(f"| {name.replace('_', ' ')} | {material} | {' | '.join(cells)} |")
    return rows


def read_profiles(folder: Path) -> list[tuple[str, str, Float]]:
    """Return name, counterpart and measured octaves of the profiles in a folder."""
    paths = [(name, material, folder / f"{name}.npy") for name, material in COUNTERPARTS.items()]
    return [
        (name, material, measure_octaves(np.load(path, allow_pickle=False).astype(np.float64)))
        for name, material, path in paths
        if path.is_file()
    ]


def read_maps(folder: Path) -> list[tuple[str, str, Float]]:
    """Return name, counterpart and measured octaves of the maps in a folder."""
    paths = [(name, material, folder / f"{name}.tmd") for name, material in MAP_COUNTERPARTS.items()]
    return [(name, material, measure_map(*read_tmd(path))) for name, material, path in paths if path.is_file()]


def main(words: Sequence[str] | None = None) -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(description="Heights of the library beside measured ones.")
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    folders = parser.parse_args(words).folders
    try:
        profiles = [each for folder in folders for each in read_profiles(folder)]
        maps = [each for folder in folders for each in read_maps(folder)]
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if not profiles and not maps:
        print(
            "Nothing measured is there. Name folders with acrylic.npy or paper.tmd and its siblings.", file=sys.stderr
        )
        return 2
    tables = [compare(OCTAVES_M, profiles)] if profiles else []
    tables += [compare(MAP_OCTAVES_M, maps)] if maps else []
    print("\n\n".join("\n".join(each) for each in tables))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
