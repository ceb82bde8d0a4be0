"""Classes of surfaces, each with as many instances as there are seeds: table.py's constants with physical scatter.

A class is one row of the table ("denim"); an instance is one piece of it, drawn by a seed: another weaver, another
board. Levels are constants of the surface (RMS height), never a gain on the output.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from hashlib import blake2b
from math import gcd

import numpy as np

from ..errors import MaterialError
from ..material.mechanics import Mechanics
from .surface import Lattice, SurfaceRecipe
from .table import MATERIAL_TABLE, MaterialEntry, build_recipe

CLASS_ENTRIES = {entry.name: entry for entry in MATERIAL_TABLE}


@dataclass(frozen=True)
class Scatter:
    """Piece-to-piece scatter within a class, the same for all classes: standard deviations, cut at two of them; of the
    natural logarithm where not said otherwise.

    level: RMS height of the whole; makers hold Ra to about a third (ISO 1302 classes are a factor of two apart).
    balance: height of one part against the others. slope: of the spectrum, in absolute terms. length: roll-off, cut-off
    and grain size. pitch: threads and grooves per length. cover: of grains. stiffness, damping, friction: as data
    sheets and tribometers scatter within one material.
    """

    level: float = 0.2
    balance: float = 0.15
    slope: float = 0.06
    length: float = 0.12
    pitch: float = 0.08
    cover: float = 0.2
    stiffness: float = 0.15
    damping: float = 0.1
    friction: float = 0.1


DEFAULT_SCATTER = Scatter()


def list_classes() -> tuple[str, ...]:
    """Names of all classes."""
    return tuple(CLASS_ENTRIES)


def get_category(class_name: str) -> str:
    """wood, metal, stone, fabric, paper, plastic, foam, carpet, tile, leather, rubber or glass."""
    return _get_entry(class_name).category


def get_recorded_category(class_name: str) -> str:
    """The HaTT category that the class is held against, "" where it recorded none."""
    return _get_entry(class_name).hatt


def sample_instance(class_name: str, seed: int, scatter: Scatter = DEFAULT_SCATTER) -> tuple[SurfaceRecipe, Mechanics]:
    """One piece of a class; the same name and seed give the same piece. Its heights: height_map(recipe, seed).

    Raises MaterialError for a class that does not exist.
    """
    entry = _get_entry(class_name)
    rng = np.random.default_rng([derive_seed(class_name), seed])

    def factor(deviation: float) -> float:
        return float(np.exp(entry.scatter * deviation * np.clip(rng.standard_normal(), -2.0, 2.0)))

    level = factor(scatter.level)
    noise = tuple(
        replace(
            part,
            rms_m=part.rms_m * factor(scatter.balance),
            slope=part.slope + np.log(factor(scatter.slope)),
            rolloff_m=part.rolloff_m * factor(scatter.length),
            cutoff_m=part.cutoff_m * factor(scatter.length),
            stretch=1.0 + (part.stretch - 1.0) * factor(scatter.length),
        )
        for part in entry.parts.noise
    )
    lattices = tuple(
        replace(
            _scale_pitch(part, factor(scatter.pitch), factor(scatter.pitch)),
            rms_m=part.rms_m * factor(scatter.balance),
            irregularity=part.irregularity * factor(scatter.length),
        )
        for part in entry.parts.lattices
    )
    grains = tuple(
        replace(
            part,
            rms_m=part.rms_m * factor(scatter.balance),
            diameter_m=part.diameter_m * factor(scatter.length),
            cover=part.cover * factor(scatter.cover),
            stretch=1.0 + (part.stretch - 1.0) * factor(scatter.length),
        )
        for part in entry.parts.grains
    )
    piece = replace(entry, parts=SurfaceRecipe(noise, lattices, grains), roughness_um=entry.roughness_um * level)
    mean = entry.mechanics
    assert mean.stiffness_n_m is not None
    assert mean.damping_ratio is not None
    assert mean.friction is not None
    mechanics = Mechanics(
        mean.stiffness_n_m * factor(scatter.stiffness),
        mean.damping_ratio * factor(scatter.damping),
        mean.friction * factor(scatter.friction),
    )
    return build_recipe(piece), mechanics


def derive_seed(name: str) -> int:
    """A seed that belongs to a name, the same on every machine."""
    return int.from_bytes(blake2b(name.encode(), digest_size=4).digest(), "little")


def _get_entry(class_name: str) -> MaterialEntry:
    if class_name not in CLASS_ENTRIES:
        raise MaterialError(
            f"no class of surfaces is called {class_name!r}.", remedy="simulation.classes.classes() lists them."
        )
    return CLASS_ENTRIES[class_name]


def _scale_pitch(lattice: Lattice, x: float, y: float) -> Lattice:
    """The lattice with its pitch divided by x and y, to the nearest whole number of repeats on the tile."""
    repeats = [gcd(*(wave[0] for wave in lattice.waves)), gcd(*(wave[1] for wave in lattice.waves))]
    if repeats[0] == repeats[1]:
        y = x  # a square lattice stays one
    finer = [max(1, round(n * by)) / n if n else 1.0 for n, by in zip(repeats, (x, y), strict=True)]
    waves = tuple((round(px * finer[0]), round(py * finer[1]), a, phase) for px, py, a, phase in lattice.waves)
    return replace(lattice, waves=waves)
