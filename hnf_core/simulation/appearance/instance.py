"""One piece's looks: base colour, gloss, and how strongly each pattern marks it; drawn by a seed around its class.

Everything that colours a surface is a factor exp(strength · field · tint) on the base colour, fields of order one.
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
    """strength: natural logarithm of the factor where the field is 1. tint: by how much each channel takes part."""

    strength: float
    tint: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class SurfaceAppearance:
    """base_color: linear RGB. dirt: dark stuff in pits, wear: lighter crests; both fill up over depth_m (an absolute
    depth: what a pit holds says how deep it is) against the height's mean over reach_m. yarns: what stands up in a
    lattice against what lies low (warp and weft). streak: along the grain of stretched noise; streak_follows: share of
    its power that is the relief itself. speckle: spots of speckle_m that have nothing to do with height; speckle_sharp:
    0 cloudy … 1 cut. prints: a printed pattern of print_m, no geometry either; kind in PRINTS.
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
    """What pieces of a category do. dyed: share of any colour at all. The rest: ranges of strengths; printed: share."""

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
DEFAULT_RANGES = AppearanceRanges(0.9, (0.0, 1.0), (0.0, 0.3), (0.0, 0.7), (0.0, 0.45), (0.0, 0.5), 0.3)
"""Of a surface that belongs to no category."""


def sample_appearance(appearance: Appearance | None, category: str, rng: np.random.Generator) -> SurfaceAppearance:
    """One piece with the class's typical appearance, scattered as its category does; with neither, any looks.

    The same generator state gives the same piece.
    """
    habit = CATEGORY_RANGES.get(category, DEFAULT_RANGES)
    typical = appearance or Appearance()
    dyed = rng.random() < habit.dyed or typical.base_color is None
    own = _sample_colour(rng) if dyed else _perturb_colour(typical.base_color or (0.5, 0.5, 0.5), rng)
    gloss = rng.uniform(0.1, 1.0) if typical.roughness is None else typical.roughness + 0.08 * rng.standard_normal()
    metallic = float(rng.random() < 0.15) if typical.metallic is None else typical.metallic
    return SurfaceAppearance(
        base_color=own,
        roughness=float(np.clip(gloss, 0.05, 1.0)),
        metallic=float(metallic),
        dirt=Mark(-_sample_strength(habit.dirt, rng), _sample_tint(rng, 0.15)),
        wear=Mark(_sample_strength(habit.wear, rng), _sample_tint(rng, 0.1)),
        depth_m=_sample_log_uniform(rng, 0.2e-6, 6e-6),
        reach_m=_sample_log_uniform(rng, 0.15e-3, 0.7e-3),
        yarns=Mark(_sample_strength(habit.yarns, rng) * _sample_sign(rng), _sample_tint(rng, 0.5)),
        streak=Mark(_sample_strength(habit.streak, rng) * _sample_sign(rng), _sample_tint(rng, 0.2)),
        streak_relief_share=float(rng.uniform(0.0, 0.7)),
        speckle=Mark(_sample_strength(habit.speckle, rng), _sample_tint(rng, 0.2)),
        speckle_m=_sample_log_uniform(rng, 0.1e-3, 1.5e-3),
        speckle_sharp=float(rng.uniform(0.0, 1.0)),
        prints=Mark(float(rng.uniform(0.05, 0.4)) * (rng.random() < habit.printed), _sample_tint(rng, 0.8)),
        print_kind=PRINT_KINDS[int(rng.integers(len(PRINT_KINDS)))],
        print_m=_sample_log_uniform(rng, 0.4e-3, 10e-3),
    )


def _sample_strength(limits: Range, rng: np.random.Generator) -> float:
    # Faint marks are the rule: squared, half of the draws lie in the lowest quarter of the range.
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
    """Any hue, from grey to strong, from near black to near white in equal steps of lightness."""
    hue = 2.0 * np.pi * (rng.random() + np.arange(3) / 3.0)
    value = rng.uniform(0.15, 0.93) ** 2.2
    chroma = rng.random() ** 1.5
    red, green, blue = np.clip(value * (1.0 + chroma * np.cos(hue)) / (1.0 + 0.5 * chroma), 0.01, 0.92)
    return float(red), float(green), float(blue)
