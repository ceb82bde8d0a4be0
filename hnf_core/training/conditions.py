"""Conditions to train on: who is stroked, with what, how fast, how hard, in which direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..material.mechanics import Mechanics
from .surfaces import Surface

Float = NDArray[np.float64]

SPEED_RANGE_M_S = (0.005, 0.4)
FORCE_RANGE_N = (0.1, 5.0)
SPEED_COUNT = 64
"""Steady strokes use a grid of speeds: the expectation of a window needs one matrix per speed."""
FORCE_COUNT = 24
"""And a grid of forces: a surface smoothed by one contact radius serves many strokes."""
STIFFNESS_RANGE_N_M = (8e2, 4e5)
DAMPING_RANGE = (0.05, 0.8)
FRICTION_RANGE = (0.1, 1.3)
MIDDLE_SPEED_M_S = (0.03, 0.25)
MIDDLE_FORCE_N = (0.3, 3.0)
"""Where strokes mostly are, and where a material's own feel is checked."""
MATERIAL_MECHANICS_SHARE = 0.6
WITHHELD_SHARE = 0.25
"""Chance of each mechanical value to be withheld from the network."""
SPEEDS_AND_FORCES = ((0.05, 1.0), (0.1, 0.5), (0.1, 1.0), (0.1, 2.0), (0.2, 1.0), (0.15, 0.7))
ANGLES_RAD = np.radians([10.0, 77.0, 33.0, 121.0, 154.0, 55.0])
"""Of middle_conditions."""


@dataclass(frozen=True)
class SteadyStroke:
    """One steady stroke. surface: index; speed: index into speed_grid(); angle: rad; force: N."""

    surface: int
    mechanics: Mechanics
    probe: str
    speed: int
    angle: float
    force: float
    start: tuple[float, float]


def make_speed_grid() -> Float:
    return np.geomspace(*SPEED_RANGE_M_S, SPEED_COUNT)


def make_force_grid() -> Float:
    return np.geomspace(*FORCE_RANGE_N, FORCE_COUNT)


def draw_steady_strokes(
    surfaces: Sequence[Surface], per_surface: int, seed: int, *, middle_share: float = 0.0
) -> list[SteadyStroke]:
    """per_surface conditions on each surface, log-uniform in speed and force, two thirds with the pen.

    middle_share of them keep to the middle ranges, to the pen and to the surface's own mechanics. Directions are
    uniform over the circle: any fixed one lies between those trained on.
    """
    rng = np.random.default_rng(seed)
    forces = make_force_grid()
    low, high = np.searchsorted(make_speed_grid(), MIDDLE_SPEED_M_S)
    lightest, firmest = np.searchsorted(forces, MIDDLE_FORCE_N)
    strokes = []
    for index, surface in enumerate(surfaces):
        for draw in range(per_surface):
            middle = rng.random() < middle_share and surface.mechanics is not None
            own = surface.mechanics if middle else None
            strokes.append(
                SteadyStroke(
                    surface=index,
                    mechanics=own or draw_mechanics(surface.mechanics, rng),
                    probe="pen" if middle or draw % 3 else "finger",
                    speed=int(rng.integers(low, high)) if middle else int(rng.integers(SPEED_COUNT)),
                    angle=float(rng.uniform(0.0, 2.0 * np.pi)),
                    force=float(forces[rng.integers(lightest, firmest) if middle else rng.integers(FORCE_COUNT)]),
                    start=(float(rng.uniform(0.0, 0.02)), float(rng.uniform(0.0, 0.02))),
                )
            )
    return strokes


def draw_mechanics(typical: Mechanics | None, rng: np.random.Generator) -> Mechanics:
    """The material's own values (with 20 % of scatter) or any, so that the condition is not read off the token."""
    if typical is not None and rng.random() < MATERIAL_MECHANICS_SHARE:
        scatter = np.exp(0.2 * rng.standard_normal(3))
        return Mechanics(
            None if typical.stiffness_n_m is None else typical.stiffness_n_m * float(scatter[0]),
            None if typical.damping_ratio is None else typical.damping_ratio * float(scatter[1]),
            None if typical.friction is None else typical.friction * float(scatter[2]),
        )
    return Mechanics(
        float(np.exp(rng.uniform(*np.log(STIFFNESS_RANGE_N_M)))),
        float(np.exp(rng.uniform(*np.log(DAMPING_RANGE)))),
        float(np.exp(rng.uniform(*np.log(FRICTION_RANGE)))),
    )


def withhold_mechanics(mechanics: Mechanics, rng: np.random.Generator) -> Mechanics:
    """Each value dropped to unknown with chance UNKNOWN_SHARE; one time in eight all of them."""
    if rng.random() < 0.125:
        return Mechanics()
    keep = rng.random(3) >= WITHHELD_SHARE
    return Mechanics(
        mechanics.stiffness_n_m if keep[0] else None,
        mechanics.damping_ratio if keep[1] else None,
        mechanics.friction if keep[2] else None,
    )


@dataclass(frozen=True)
class StrokeCondition:
    """A steady stroke with the pen. speed: index into speed_grid(). force: N. angle: rad."""

    speed: int
    force: float
    angle: float


def make_middle_conditions() -> list[StrokeCondition]:
    """Six: speed and force about the middle, directions between the tile's axes."""
    grid = make_speed_grid()
    return [
        StrokeCondition(int(np.argmin(np.abs(np.log(grid / speed)))), force, float(angle))
        for (speed, force), angle in zip(SPEEDS_AND_FORCES, ANGLES_RAD, strict=True)
    ]
