"""What the library knows of a material, and what a shader says of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .mechanics import Mechanics


@dataclass(frozen=True)
class Appearance:
    """Physically based shading values, None = not known. base_color: linear RGB 0–1; the rest 0–1."""

    base_color: tuple[float, float, float] | None = None
    roughness: float | None = None
    metallic: float | None = None
    sheen: float | None = None
    transmission: float | None = None


@dataclass(frozen=True)
class LibraryMaterial:
    """One entry of the material library.

    name: unique, kebab-case ("oak-wood"). category: wood, metal, stone, fabric, paper, plastic, foam, carpet, tile,
    leather, rubber, glass. words: lower-case names and synonyms that artists give such a material.
    appearance: its typical shading values. token: (TOKEN_DIM,) float32, E on its own micro-geometry, x along the
    grain. recipe, seed: that micro-geometry, as simulation.surface reads it (SurfaceRecipe.from_dict, height_map).
    """

    name: str
    category: str
    words: tuple[str, ...]
    appearance: Appearance
    mechanics: Mechanics
    token: NDArray[np.float32]
    recipe: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
