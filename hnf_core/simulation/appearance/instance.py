"""Random appearance of one simulated surface: base color, gloss and the strength of its color patterns.

Values scatter around those of the material class. A pattern multiplies the base color by exp(strength · field · tint),
where its field is an image (H, W) of order one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ...material.library import Appearance

Colour = tuple[float, float, float]
Range = tuple[float, float]


@dataclass(frozen=True)
class Mark:
    """A color pattern: strength (log of its factor on the base color where its field is 1) and tint per channel."""

    strength: float
    tint: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class SurfaceAppearance:
    """Appearance of one surface of a material class: base color, gloss and color patterns.

    Attributes
    ----------
    base_color : tuple of 3 floats
        Linear RGB.
    roughness, metallic : float
        Shading values.
    dirt, wear : Mark
        Dark matter in pits, and lighter crests.
    depth_m : float
        Depth at which dirt and wear saturate [m]; absolute, so that the color of a pit tells its depth.
    reach_m : float
        Standard deviation of the Gaussian mean of height from which that depth is measured [m].
    yarns : Mark
        Contrast of raised to low parts of a lattice (warp and weft).
    streak : Mark
        Streaks along the grain of anisotropic noise, as in wood.
    streak_relief_share : float
        Fraction of the streaks' power that follows the relief; the rest is independent.
    speckle : Mark
        Spots independent of height.
    speckle_m : float
        Size of the spots [m].
    speckle_sharp : float
        Sharpness of the spots, 0 cloudy to 1 sharp-edged.
    prints : Mark
        Printed pattern, independent of height.
    print_kind : str
        One of `PRINT_KINDS`.
    print_m : float
        Size of the printed pattern [m].
    """

    base_color: Colour
    roughness: float
    metallic: float
    dirt: Mark
    wear: Mark
    depth_m: float
    reach_m: float
    yarns: Mark
    streak: Mark
    streak_relief_share: float
    speckle: Mark
    speckle_m: float
    speckle_sharp: float
    prints: Mark
    print_kind: str
    print_m: float


PRINT_KINDS = ("stripes", "dots", "clouds")


@dataclass(frozen=True)
class AppearanceRanges:
    """Ranges of pattern strengths in a material category; `dyed` and `printed` are fractions of its surfaces."""

    dyed: float
    dirt: Range = (0.0, 0.9)
    wear: Range = (0.0, 0.25)
    yarns: Range = (0.0, 0.0)
    streak: Range = (0.0, 0.15)
    speckle: Range = (0.0, 0.1)
    printed: float = 0.15


CATEGORY_RANGES: Mapping[str, AppearanceRanges] = MappingProxyType(
    {
        "wood": AppearanceRanges(0.15, streak=(0.05, 0.45)),
        "metal": AppearanceRanges(0.05, streak=(0.0, 0.12), printed=0.1),
        "stone": AppearanceRanges(0.1, streak=(0.0, 0.2), speckle=(0.04, 0.5), printed=0.05),
        "fabric": AppearanceRanges(0.7, dirt=(0.0, 0.7), yarns=(0.0, 0.7), speckle=(0.0, 0.2), printed=0.35),
        "paper": AppearanceRanges(0.4, speckle=(0.0, 0.15), printed=0.5),
        "plastic": AppearanceRanges(0.7, yarns=(0.0, 0.25), printed=0.25),
        "foam": AppearanceRanges(0.6),
        "carpet": AppearanceRanges(0.7, yarns=(0.0, 0.6), speckle=(0.0, 0.4), printed=0.3),
        "tile": AppearanceRanges(0.5, speckle=(0.0, 0.25), printed=0.25),
        "leather": AppearanceRanges(0.5, dirt=(0.1, 1.0)),
        "rubber": AppearanceRanges(0.3),
        "glass": AppearanceRanges(0.2, dirt=(0.0, 0.5)),
    }
)
"""Ranges of pattern strengths by material category."""
DEFAULT_RANGES = AppearanceRanges(0.9, (0.0, 1.0), (0.0, 0.3), (0.0, 0.7), (0.0, 0.45), (0.0, 0.5), 0.3)
"""Ranges of pattern strengths of a surface without category."""


def sample_appearance(appearance: Appearance | None, category: str, rng: np.random.Generator) -> SurfaceAppearance:
    """Sample the appearance of a surface around its class; the same generator state gives the same appearance.

    Parameters
    ----------
    appearance : Appearance or None
        Typical shading values of the class; None for any appearance.
    category : str
        Material category (wood, metal …), which sets the ranges; "" for none.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    SurfaceAppearance
        The appearance.
    """
    ranges = CATEGORY_RANGES.get(category, DEFAULT_RANGES)
    typical = appearance or Appearance()
    dyed = rng.random() < ranges.dyed or typical.base_color is None
    colour = _sample_colour(rng) if dyed else _perturb_colour(typical.base_color or (0.5, 0.5, 0.5), rng)
    gloss = rng.uniform(0.1, 1.0) if typical.roughness is None else typical.roughness + 0.08 * rng.standard_normal()
    metallic = float(rng.random() < 0.15) if typical.metallic is None else typical.metallic
    return SurfaceAppearance(
        base_color=colour,
        roughness=float(np.clip(gloss, 0.05, 1.0)),
        metallic=float(metallic),
        dirt=Mark(-_sample_strength(ranges.dirt, rng), _sample_tint(rng, 0.15)),
        wear=Mark(_sample_strength(ranges.wear, rng), _sample_tint(rng, 0.1)),
        depth_m=_sample_log_uniform(rng, 0.2e-6, 6e-6),
        reach_m=_sample_log_uniform(rng, 0.15e-3, 0.7e-3),
        yarns=Mark(_sample_strength(ranges.yarns, rng) * _sample_sign(rng), _sample_tint(rng, 0.5)),
        streak=Mark(_sample_strength(ranges.streak, rng) * _sample_sign(rng), _sample_tint(rng, 0.2)),
        streak_relief_share=float(rng.uniform(0.0, 0.7)),
        speckle=Mark(_sample_strength(ranges.speckle, rng), _sample_tint(rng, 0.2)),
        speckle_m=_sample_log_uniform(rng, 0.1e-3, 1.5e-3),
        speckle_sharp=float(rng.uniform(0.0, 1.0)),
        prints=Mark(float(rng.uniform(0.05, 0.4)) * (rng.random() < ranges.printed), _sample_tint(rng, 0.8)),
        print_kind=PRINT_KINDS[int(rng.integers(len(PRINT_KINDS)))],
        print_m=_sample_log_uniform(rng, 0.4e-3, 10e-3),
    )


def _sample_strength(limits: Range, rng: np.random.Generator) -> float:
    # Faint marks are more common, so the draw is squared: half of them lie in the lowest quarter of the range.
    return float(limits[0] + (limits[1] - limits[0]) * rng.random() ** 2)


def _sample_log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sample_sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _sample_tint(rng: np.random.Generator, spread: float) -> Colour:
    red, green, blue = 1.0 + spread * rng.uniform(-1.0, 1.0, 3)
    return float(red), float(green), float(blue)


def _perturb_colour(colour: Colour, rng: np.random.Generator) -> Colour:
    factors = np.exp(0.25 * rng.standard_normal() + 0.08 * rng.standard_normal(3))
    red, green, blue = np.clip(np.asarray(colour) * factors, 0.01, 0.92)
    return float(red), float(green), float(blue)


def _sample_colour(rng: np.random.Generator) -> Colour:
    """Draw a colour of any hue, from grey to saturated, uniform in lightness from near black to near white."""
    hue = 2.0 * np.pi * (rng.random() + np.arange(3) / 3.0)
    value = rng.uniform(0.15, 0.93) ** 2.2
    chroma = rng.random() ** 1.5
    red, green, blue = np.clip(value * (1.0 + chroma * np.cos(hue)) / (1.0 + 0.5 * chroma), 0.01, 0.92)
    return float(red), float(green), float(blue)
