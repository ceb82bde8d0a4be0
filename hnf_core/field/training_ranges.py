"""Ranges of the training data, by which range_check judges whether a field may be trusted on a stroke.

Recordings cover a region of speed and force, not a box (nobody presses hard and fast at once), so the convex hull of
the visited pairs is stored beside the two ranges. Directions are stored as sectors of the circle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..errors import StrokeError
from ..material.contact_model import LEARNED_MECHANICS, Mechanics
from .linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S

Float = NDArray[np.float64]

SECTORS = 16
SECTOR_RAD = 2.0 * np.pi / SECTORS
"""Width of a sector [rad]; sector k is centred on the direction k · 22.5°."""
CELLS_PER_OCTAVE = 2.0
OUTLIER_SHARE = 1e-4
"""Smallest fraction of all states that makes a cell of speed and force, or a sector, count as trained.

With fewer than 10⁴ states (50 s) every one counts.
"""
_BATCH_STATES = 2**14
"""States compared with all edges or sectors at a time: an hour has 720 000."""


@dataclass(frozen=True)
class PropertyRange:
    """Range of one mechanical property in training.

    span: (low, high) of the known values, None if none was ever known. unknown: True if it was unknown always or at
    times.
    """

    span: tuple[float, float] | None
    unknown: bool


@dataclass(frozen=True)
class TrainingRanges:
    """Ranges that a field was trained on; None means not on record (older weights), and is not checked.

    Attributes
    ----------
    speed, force
        (low, high) [m/s] and [N], above the floors of the field's input.
    token_low, token_high
        (TOKEN_DIM,) smallest and largest value of each feature of the material tokens.
    hull
        (k, 2) [m/s, N] corners of the convex hull, in log speed and log force, of the visited pairs; anticlockwise.
    sectors
        SECTORS flags, True where that direction was trained; () if no directions were recorded.
    mechanics
        Range of each property, by its name in Mechanics.
    probes
        Names of the probes.
    """

    speed: tuple[float, float]
    force: tuple[float, float]
    token_low: NDArray[np.float32]
    token_high: NDArray[np.float32]
    hull: Float | None = None
    sectors: tuple[bool, ...] | None = None
    mechanics: Mapping[str, PropertyRange] | None = None
    probes: tuple[str, ...] | None = None


def compute_training_ranges(
    actions: Sequence[Action],
    tokens: NDArray[np.float32],
    mechanics: Sequence[Mechanics],
    probes: Sequence[str] | None = None,
    *,
    directed: Sequence[bool] | None = None,
    withheld: bool = False,
) -> TrainingRanges:
    """Compute the ranges of training data.

    Parameters
    ----------
    actions
        All strokes; states out of contact, at rest or below the input's floors do not count.
    tokens
        (M, TOKEN_DIM) of all materials.
    mechanics
        Stiffness, damping and friction given with them.
    probes
        Names; None for those of the actions.
    directed
        For each action whether its direction was recorded; None if all were.
    withheld
        True if known mechanics were also withheld at random.

    Returns
    -------
    TrainingRanges
        Ranges, hull and sectors.

    Raises
    ------
    StrokeError
        If no state counts, or no token or mechanics are given.
    """
    has_direction = [True] * len(actions) if directed is None else list(directed)
    if len(tokens) == 0 or len(mechanics) == 0 or len(has_direction) != len(actions):
        raise _unusable_error("training needs tokens, mechanics, and for each action whether its direction is known.")
    counted_states = [action.contact & (action.force >= FORCE_FLOOR_N) & (action.speed >= SPEED_FLOOR_M_S)
               for action in actions]  # fmt: skip
    speed = np.concatenate([np.zeros(0), *(a.speed[rows] for a, rows in zip(actions, counted_states, strict=True))])
    force = np.concatenate([np.zeros(0), *(a.force[rows] for a, rows in zip(actions, counted_states, strict=True))])
    if len(speed) == 0:
        moves, presses = (any((values > 0.0).any() for values in each) for each in (
            [a.speed for a in actions], [a.force for a in actions]))  # fmt: skip
        fault = "moves in contact" if moves and presses else "presses (force)" if moves else "moves (speed, or x and y)"
        raise StrokeError(
            f"no recorded stroke ever {fault}.", where="training", remedy="Check that column and its unit."
        )
    pairs = np.log2(np.stack([speed, force], axis=1))
    cell = np.unique(np.floor(CELLS_PER_OCTAVE * pairs), axis=0, return_inverse=True)[1].ravel()
    is_counted = (np.bincount(cell) >= OUTLIER_SHARE * len(pairs))[cell]
    directions = [
        a.direction[rows] for a, rows, is_known in zip(actions, counted_states, has_direction, strict=True) if is_known
    ]
    return TrainingRanges(
        speed=(float(speed[is_counted].min()), float(speed[is_counted].max())),
        force=(float(force[is_counted].min()), float(force[is_counted].max())),
        token_low=np.min(tokens, axis=0),
        token_high=np.max(tokens, axis=0),
        hull=np.exp2(compute_convex_hull(pairs[is_counted])),
        sectors=_find_sectors(np.concatenate(directions)) if directions else (),
        mechanics={
            name: _summarise_property([getattr(properties, name) for properties in mechanics], withheld)
            for name in LEARNED_MECHANICS
        },
        probes=tuple(sorted(set(probes if probes is not None else (action.probe for action in actions)))),
    )


def compute_convex_hull(points: Float) -> Float:
    """Compute the convex hull (k, 2) of points (n, 2), anticlockwise without collinear corners.

    Monotone chain (A. M. Andrew 1979). k is 1 or 2 if all points coincide or lie on a line.
    """
    ordered = np.unique(points, axis=0)
    if len(ordered) < 3:
        return ordered
    chains: list[Float] = []
    for walk in (ordered, ordered[::-1]):
        chain: list[Float] = []
        for point in walk:
            while len(chain) > 1 and _cross(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return np.array(chains)


def find_nearest_in_hull(hull: Float, points: Float) -> Float:
    """Find the point (n, 2) of a convex hull (k, 2) nearest to each of points (n, 2); one inside is its own nearest."""
    batches = [
        _find_nearest_in_hull(hull, points[first : first + _BATCH_STATES])
        for first in range(0, len(points), _BATCH_STATES)
    ]
    return np.concatenate(batches) if batches else np.zeros((0, 2))


def _find_nearest_in_hull(hull: Float, points: Float) -> Float:
    """Find the nearest points for one batch of points."""
    start, edge = hull, np.roll(hull, -1, axis=0) - hull
    along = points[:, None, :] - start
    fraction = (along * edge).sum(axis=2) / np.maximum((edge * edge).sum(axis=1), 1e-300)
    foot_points = start + np.clip(fraction, 0.0, 1.0)[..., None] * edge
    best = np.argmin(np.linalg.norm(points[:, None, :] - foot_points, axis=2), axis=1)
    nearest = foot_points[np.arange(len(points)), best]
    if len(hull) < 3:
        return np.asarray(nearest)
    inside = (edge[:, 0] * along[..., 1] - edge[:, 1] * along[..., 0] >= 0.0).all(axis=1)
    return np.where(inside[:, None], points, nearest)


def compute_angle_to_sectors(sectors: Sequence[bool], angle: Float) -> tuple[Float, NDArray[np.intp]]:
    """Compute the angle (n,) [rad] to the edge of the nearest trained sector, 0 inside, and that sector's index."""
    trained = np.flatnonzero(np.asarray(sectors))
    batches = [
        _angle_to_nearest(trained, angle[first : first + _BATCH_STATES])
        for first in range(0, max(len(angle), 1), _BATCH_STATES)
    ]
    return np.concatenate([distance for distance, _ in batches]), np.concatenate([nearest for _, nearest in batches])


def _angle_to_nearest(trained: NDArray[np.intp], angle: Float) -> tuple[Float, NDArray[np.intp]]:
    """Compute angle [rad] to, and index of, the nearest of the sectors `trained` for one batch of angles [rad]."""
    distance = np.abs((angle[:, None] - trained * SECTOR_RAD + np.pi) % (2.0 * np.pi) - np.pi)
    return np.maximum(distance.min(axis=1) - SECTOR_RAD / 2.0, 0.0), trained[np.argmin(distance, axis=1)]


def _find_sectors(direction: Float) -> tuple[bool, ...]:
    """Return for each sector of the circle whether any of the directions (n, 2) lies in it."""
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    counts = np.bincount(np.rint(angle / SECTOR_RAD).astype(int) % SECTORS, minlength=SECTORS)
    return tuple(bool(count > 0 and count >= OUTLIER_SHARE * len(angle)) for count in counts)


def _summarise_property(values: Sequence[float | None], withheld: bool) -> PropertyRange:
    """Return the range of a mechanical property's values, None for unknown; withheld: training also hid known ones."""
    known = [float(value) for value in values if value is not None]
    return PropertyRange((min(known), max(known)) if known else None, withheld or len(known) < len(values))


def _cross(a: Float, b: Float, c: Float) -> float:
    """Return the cross product of a→b and a→c."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _unusable_error(what: str) -> StrokeError:
    """Return the error that training data are unusable because of `what`."""
    return StrokeError(what, where="training ranges", remedy="Give the data that the field was trained on.")
