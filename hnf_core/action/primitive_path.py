"""Strokes in words as planar paths with keyframes of progress and force, and as actions on a flat surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from .action import ACTION_RATE_HZ, Action
from .curves import ArcCurve, build_arc_curve, make_smooth_curve
from .keyframes import Keyframes
from .primitives import Primitive, find_primitive
from .step_plan import LINE_M as SCRAPE_LENGTH_M
from .step_plan import ONSET_S, RAMP_S, ROUND_M, RUB_S, Move, make_plan_keyframes, make_rub_points, plan_steps

Float = NDArray[np.float64]

SCRAPE_KNOTS = 25

LEAST_FORCE_N = 1e-12
"""Force below which there is no contact, but rounding [N]."""

MIN_SIZE_M = 1e-4
"""Smallest size of a stroke [m]."""


@dataclass(frozen=True)
class PlanarPath:
    """Path and timing of a primitive stroke in a tangent plane of the surface.

    Attributes
    ----------
    points : ndarray, shape (k, 2)
        Points that a smooth Bézier spline passes through (`curves.make_smooth_curve`), centred at 0 [m].
    cyclic : bool
        True if the path is closed.
    progress : Keyframes
        Keyframes of the fraction 0–1 of the path's length.
    force : Keyframes
        Keyframes of the force [N].
    duration_s : float
        Duration [s].
    extent_m : float
        Diameter of a disc around 0 that contains the path [m].
    marks : tuple of int
        Indices of the points between which its pieces lie; of a closed path the last is the number of points.
    moves : tuple of Move
        The hand's moves along the pieces, for `step_plan.make_plan_keyframes`.
    """

    points: Float
    cyclic: bool
    progress: Keyframes
    force: Keyframes
    duration_s: float
    extent_m: float
    marks: tuple[int, ...]
    moves: tuple[Move, ...]


def make_primitive_path(primitive: Primitive | str, *, size_m: float | None = None, seed: int = 0) -> PlanarPath:
    """Make the path of a primitive in a disc; a smaller disc gives a shorter scrape, or a rub of more, smaller rounds.

    Parameters
    ----------
    primitive : Primitive or str
        The primitive, or its name.
    size_m : float or None
        Diameter of the disc [m]; None for one that is large enough. Speed and force do not depend on it, nor do
        lengths that were said.
    seed : int
        Shape of a rub; scrapes ignore it.

    Returns
    -------
    PlanarPath
        The path.

    Raises
    ------
    UsageError
        For an unknown name, or a size below 0.1 mm.
    """
    primitive = find_primitive(primitive) if isinstance(primitive, str) else primitive
    if size_m is not None and not size_m >= MIN_SIZE_M:
        raise UsageError(f"a stroke cannot fit in {size_m * 1e3:g} mm.", remedy="Choose a larger surface.")
    if primitive.steps:
        return _make_planned_path(primitive, size_m, seed)
    size = SCRAPE_LENGTH_M if size_m is None else size_m
    if primitive.kind == "scrape":
        distance = extent = min(size, SCRAPE_LENGTH_M)
        points = np.linspace(-extent / 2, extent / 2, SCRAPE_KNOTS)[:, None] * np.array(primitive.direction)
    else:
        distance = primitive.speed * (RUB_S - ONSET_S - RAMP_S)
        extent = min(size, ROUND_M)
        points = make_rub_points(distance, extent, np.random.default_rng(seed))
    moves = (Move(True, None, primitive.speed, primitive.speed, primitive.force, primitive.force),)
    cyclic = primitive.kind == "rub"
    marks = (0, len(points) if cyclic else len(points) - 1)
    return PlanarPath(points, cyclic, *make_plan_keyframes(moves, (0.0, distance)), extent, marks, moves)


def _make_planned_path(primitive: Primitive, size_m: float | None, seed: int) -> PlanarPath:
    plan, scale = plan_steps(primitive.steps, seed=seed), 1.0
    for _ in range(4):
        # Lengths that were said stay, so that scaling once may not be enough.
        extent = _measure_extent(plan.points)
        if size_m is None or extent <= size_m * (1.0 + 1e-9):
            break
        scale *= 0.999 * size_m / extent
        plan = plan_steps(primitive.steps, scale=scale, seed=seed)
    curve = build_arc_curve(make_smooth_curve(plan.points))
    keyframes = make_plan_keyframes(plan.moves, curve.find_stations(plan.marks))
    return PlanarPath(plan.points, False, *keyframes, _measure_extent(plan.points), plan.marks, plan.moves)


def _measure_extent(points: Float) -> float:
    return 2.0 * float(np.linalg.norm(points, axis=1).max())


def make_path_curve(path: PlanarPath) -> ArcCurve:
    """Return the path as a curve by arc length, in 2-D [m]."""
    return build_arc_curve(make_smooth_curve(path.points, cyclic=path.cyclic))


def make_primitive_action(
    primitive: Primitive | str,
    *,
    rate: float = ACTION_RATE_HZ,
    seed: int = 0,
) -> Action:
    """Make the action u(t) of a primitive on a flat surface whose tangent is +x.

    Parameters
    ----------
    primitive : Primitive or str
        The primitive, or its name.
    rate : float
        Rate of the action [Hz].
    seed : int
        Shape of a rub.

    Returns
    -------
    Action
        The action.

    Raises
    ------
    UsageError
        For an unknown name.
    """
    path = make_primitive_path(primitive, seed=seed)
    curve = make_path_curve(path)
    time = np.arange(int(np.ceil(path.duration_s * rate - 1e-9)) + 1) / rate
    progress, slope = path.progress.sample(time)
    progress = np.clip(progress, 0.0, 1.0)
    force = path.force.sample(time)[0]
    force = np.where(force > LEAST_FORCE_N, force, 0.0)
    position = progress * curve.length
    return Action(
        rate=rate,
        direction=curve.tangent_at(position),
        speed=np.abs(slope) * curve.length,
        force=force,
        position=position,
        contact=force > 0.0,
    )
