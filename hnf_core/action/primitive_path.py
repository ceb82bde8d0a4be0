"""Primitives as planar paths with keyframes of progress and force, and as actions on a flat surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from .action import ACTION_RATE_HZ, Action
from .curves import ArcCurve, build_arc_curve, make_smooth_curve
from .keyframes import Keyframes, make_eased_travel
from .primitives import Primitive, find_primitive

Float = NDArray[np.float64]

SCRAPE_LENGTH_M = 60e-3
"""Length of a scrape [m]."""

RUB_EXTENT_M = 30e-3
"""Diameter of a rub [m]."""

RUB_DURATION_S = 2.0
"""Duration of a rub [s]."""

PRESS_S = 0.1
"""Duration of onset and release of the force [s]; half of each overlaps the motion."""

RAMP_S = 0.1
"""Duration of the ramp of speed at both ends [s]."""

SCRAPE_KNOTS = 25

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
    """

    points: Float
    cyclic: bool
    progress: Keyframes
    force: Keyframes
    duration_s: float
    extent_m: float


def make_primitive_path(primitive: Primitive | str, *, size_m: float = SCRAPE_LENGTH_M, seed: int = 0) -> PlanarPath:
    """Make the path of a primitive in a disc; a smaller disc gives a shorter scrape, or a rub of more, smaller rounds.

    Parameters
    ----------
    primitive : Primitive or str
        The primitive, or its name.
    size_m : float
        Diameter of the disc [m]; speed and force do not depend on it.
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
    if not size_m >= MIN_SIZE_M:
        raise UsageError(f"a stroke cannot fit in {size_m * 1e3:g} mm.", remedy="Choose a larger surface.")
    if primitive.kind == "scrape":
        extent = min(size_m, SCRAPE_LENGTH_M)
        points = np.linspace(-extent / 2, extent / 2, SCRAPE_KNOTS)[:, None] * np.array(primitive.direction)
        distance = extent
    else:
        distance = primitive.speed * (RUB_DURATION_S - PRESS_S - RAMP_S)
        extent = min(size_m, RUB_EXTENT_M)
        points = _make_rub_points(distance, extent, np.random.default_rng(seed))
    progress, force, duration = make_primitive_keyframes(primitive, distance)
    return PlanarPath(points, primitive.kind == "rub", progress, force, duration, extent)


def make_primitive_keyframes(primitive: Primitive, distance_m: float) -> tuple[Keyframes, Keyframes, float]:
    """Make keyframes of progress (0–1) and force [N], and the duration [s], of a primitive stroke.

    distance_m: length of its path.
    """
    travel = make_eased_travel(distance_m, primitive.speed, RAMP_S, start_s=PRESS_S / 2)
    progress = Keyframes(travel.time, travel.value / distance_m, travel.slope / distance_m)
    duration = float(travel.time[-1]) + PRESS_S / 2
    press = min(PRESS_S, duration / 2)
    kept_keys = [0, 1, 2, 3] if duration - 2 * press > 1e-9 else [0, 1, 3]
    force = Keyframes(
        np.array([0.0, press, duration - press, duration])[kept_keys],
        np.array([0.0, primitive.force, primitive.force, 0.0])[kept_keys],
        np.zeros(len(kept_keys)),
    )
    return progress, force, duration


def _make_rub_points(distance: float, extent: float, rng: np.random.Generator) -> Float:
    """Return a closed wandering path of an exact arc length inside a disc, with as few rounds as possible."""
    phase = rng.uniform(0.0, 2 * np.pi, size=(3, 3))
    squeeze, tilt = rng.uniform(0.6, 1.0), rng.uniform(0.0, np.pi)
    orientation = rng.choice([-1.0, 1.0])
    rotation = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    order = np.arange(1.0, 4.0)
    rounds = 2
    while rounds < 10_000:
        t = np.linspace(0.0, 2 * np.pi, 12 * rounds, endpoint=False)
        wander = (np.cos(order[:, None] * t + phase[:, :, None]) / order[:, None]).sum(axis=1) / 3
        angle = orientation * rounds * t + 0.5 * wander[2]
        loop = np.stack([np.cos(angle) * (1 + 0.3 * wander[0]), squeeze * np.sin(angle) * (1 + 0.3 * wander[1])], 1)
        loop = (loop + 0.35 * np.stack([wander[1], wander[0]], 1)) @ rotation.T
        arc = build_arc_curve(make_smooth_curve(loop, cyclic=True))
        dense = arc.point_at(np.linspace(0.0, arc.length, 40 * rounds))
        centre = (dense.min(axis=0) + dense.max(axis=0)) / 2
        radius = 1.001 * float(np.linalg.norm(dense - centre, axis=1).max())
        available_length = arc.length * extent / 2 / radius
        if available_length >= distance:
            return np.asarray((loop - centre) * (distance / arc.length))
        # The length grows about linearly with the rounds, so half of the missing ones are added at once.
        rounds = max(rounds + 1, int(0.5 * rounds * distance / available_length))
    raise UsageError(
        f"a rub of {distance * 1e3:g} mm does not fit in {extent * 1e3:g} mm.", remedy="Choose a larger surface."
    )


def make_path_curve(path: PlanarPath) -> ArcCurve:
    """Return the path as a curve by arc length, in 2-D [m]."""
    return build_arc_curve(make_smooth_curve(path.points, cyclic=path.cyclic))


def make_primitive_action(
    primitive: Primitive | str,
    *,
    rate: float = ACTION_RATE_HZ,
    seed: int = 0,
    size_m: float = SCRAPE_LENGTH_M,
    probe: str = "pen",
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
    size_m : float
        Diameter of the surface [m].
    probe : str
        Contacting tip.

    Returns
    -------
    Action
        The action.

    Raises
    ------
    UsageError
        For an unknown name, or a size below 0.1 mm.
    """
    path = make_primitive_path(primitive, size_m=size_m, seed=seed)
    curve = make_path_curve(path)
    time = np.arange(int(np.ceil(path.duration_s * rate - 1e-9)) + 1) / rate
    progress, slope = path.progress.sample(time)
    progress = np.clip(progress, 0.0, 1.0)
    force = np.maximum(path.force.sample(time)[0], 0.0)
    position = progress * curve.length
    return Action(
        rate=rate,
        direction=curve.tangent_at(position),
        speed=np.abs(slope) * curve.length,
        force=force,
        position=position,
        contact=force > 0.0,
        probe=probe,
    )
