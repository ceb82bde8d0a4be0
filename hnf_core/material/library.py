"""The material library: entries read from library.json (built by tools/build_library.py), and look-up by name.

In the tangent frame of an entry, wood and brushed metal have x along the grain; corduroy and other ribs run along y, so
that a stroke along x crosses them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError, close_matches
from .contact_model import Mechanics
from .token import ENCODER_ID, TOKEN_DIM


@dataclass(frozen=True)
class Appearance:
    """Physically based shading values, 0 to 1, None = unknown; `base_color` is linear RGB."""

    base_color: tuple[float, float, float] | None = None
    roughness: float | None = None
    metallic: float | None = None
    sheen: float | None = None
    transmission: float | None = None


@dataclass(frozen=True)
class LibraryMaterial:
    """One entry of the material library.

    Attributes
    ----------
    name : str
        Unique name in kebab-case ("oak-wood").
    category : str
        One of wood, metal, stone, fabric, paper, plastic, foam, carpet, tile, leather, rubber, glass.
    words : tuple of str
        Lower-case names and synonyms that artists use.
    appearance : Appearance
        Typical shading values (Principled BSDF).
    mechanics : Mechanics
        Stiffness, damping and friction.
    token : ndarray of float32, shape (TOKEN_DIM,)
        Token (feature vector) of its micro-geometry, x along the grain.
    recipe : mapping
        Parameters that generate that micro-geometry, for `simulation.surface_recipe.SurfaceRecipe.from_dict`.
    seed : int
        Seed of that micro-geometry, for `simulation.surface_recipe.height_map`.
    """

    name: str
    category: str
    words: tuple[str, ...]
    appearance: Appearance
    mechanics: Mechanics
    token: NDArray[np.float32]
    recipe: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0


LIBRARY_PATH = Path(__file__).resolve().parents[1] / "data" / "library.json"
LIBRARY_SCHEMA = 1
_REBUILD_REMEDY = "Reinstall the package, or run tools/build_library.py."


@lru_cache(maxsize=1)
def load_library() -> tuple[LibraryMaterial, ...]:
    """Load all materials of the shipped library in order, read once; raise MaterialError if the file cannot be used."""
    return read_library(LIBRARY_PATH)


def read_library(path: Path) -> tuple[LibraryMaterial, ...]:
    """Read a library file; raise MaterialError if it is missing, damaged, or made with another encoder."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["schema"] != LIBRARY_SCHEMA or record["encoder"] != ENCODER_ID:
            raise MaterialError(
                f"was built for schema {record['schema']} and encoder {record['encoder']}, "
                f"not for {LIBRARY_SCHEMA} and {ENCODER_ID}.",
                where=str(path),
                remedy=_REBUILD_REMEDY,
            )
        return tuple(_parse_material(entry) for entry in record["materials"])
    except OSError as error:
        raise MaterialError(
            f"the material library cannot be read ({error.strerror}).", where=str(path), remedy=_REBUILD_REMEDY
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise MaterialError(
            f"the material library is damaged ({error}).", where=str(path), remedy=_REBUILD_REMEDY
        ) from error


def get_material(name: str) -> LibraryMaterial:
    """Return the material of a name; case and separators do not count ("Oak wood" is oak-wood).

    Raises MaterialError with close matches for an unknown name.
    """
    wanted = "-".join(name.lower().replace("_", " ").replace("-", " ").split())
    library = load_library()
    for material in library:
        if material.name == wanted:
            return material
    word_matches = [material.name for material in library if wanted in material.words]
    close = list(dict.fromkeys(close_matches(wanted, [entry.name for entry in library]) + word_matches))[:5]
    remedy = f"Did you mean {', '.join(close)}?" if close else "List them all with: hnf materials"
    raise MaterialError(f"no library material is called {name!r}.", remedy=remedy)


def _parse_material(entry: Mapping[str, Any]) -> LibraryMaterial:
    token = np.asarray(entry["token"], dtype=np.float32)
    if token.shape != (TOKEN_DIM,) or not np.isfinite(token).all():
        raise ValueError(f"{entry['name']}: a token must be {TOKEN_DIM} finite numbers")
    token.setflags(write=False)
    shading = dict(entry["appearance"])
    if shading["base_color"] is not None:
        red, green, blue = shading["base_color"]
        shading["base_color"] = (float(red), float(green), float(blue))
    return LibraryMaterial(
        name=str(entry["name"]),
        category=str(entry["category"]),
        words=tuple(entry["words"]),
        appearance=Appearance(**shading),
        mechanics=Mechanics(**entry["mechanics"]),
        token=token,
        recipe=entry["recipe"],
        seed=int(entry["seed"]),
    )
