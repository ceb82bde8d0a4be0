"""Where training data lay: what a field may be asked about with confidence.

Recordings cover a region of speed and force, not a box (nobody presses hard and fast at once), so the convex hull of
the pairs visited is kept beside the two ranges. Directions are kept as sectors of the circle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..errors import StrokeError
from ..material.contact_model import MECHANICS_NAMES, Mechanics
from .linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S

Float = NDArray[np.float64]

SECTORS = 16
SECTOR_RAD = 2.0 * np.pi / SECTORS
"""Sector k is centred on the direction k · 22.5°."""
CELLS_PER_OCTAVE = 2.0
OUTLIER_SHARE = 1e-4
"""Cells of speed and force, and sectors, with less than this share of all states are outliers of a recording and do
not count as trained. Of fewer than 10⁴ states (50 s) every one counts."""
_BATCH_STATES = 2**14
"""States compared with all edges or sectors at a time: an hour has 720 000."""


@dataclass(frozen=True)
class PropertyRange:
    """One mechanical property in training. span: (low, high) of the values given, None where none ever was. unknown:
    whether it was left open, always or at times."""

    span: tuple[float, float] | None
    unknown: bool


@dataclass(frozen=True)
class TrainingRanges:
    """What a field has seen in training. None = not on record (older weights): nothing is said about it.

    speed, force: (low, high), m/s and N, above the floors of the field's input. token_low, token_high: (TOKEN_DIM,).
    hull: (k, 2) m/s and N, corners of the convex hull, in log speed and log force, of the pairs visited; anticlockwise.
    sectors: SECTORS flags, True where that direction was trained; () where directions were never told apart.
    mechanics: by field name of Mechanics. probes: names.
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
    """Ranges of training data.

    actions: every stroke trained on; states out of contact, at rest or below the input's floors do not count.
    tokens: (M, TOKEN_DIM) of every material. mechanics: as given with them. probes: None = those of the actions.
    directed: for each action whether its direction was recorded (None: all were). withheld: whether known mechanics
    were also dropped at random. Raises StrokeError where no state counts, or no token or mechanics are given.
    """
    told = [True] * len(actions) if directed is None else list(directed)
    if len(tokens) == 0 or len(mechanics) == 0 or len(told) != len(actions):
        raise _unusable_error("training needs tokens, mechanics, and for each action whether its direction is known.")
    counted = [action.contact & (action.force >= FORCE_FLOOR_N) & (action.speed >= SPEED_FLOOR_M_S)
               for action in actions]  # fmt: skip
    speed = np.concatenate([np.zeros(0), *(a.speed[rows] for a, rows in zip(actions, counted, strict=True))])
    force = np.concatenate([np.zeros(0), *(a.force[rows] for a, rows in zip(actions, counted, strict=True))])
    if len(speed) == 0:
        raise _unusable_error("no training stroke ever moves in contact.")
    pairs = np.log2(np.stack([speed, force], axis=1))
    cell = np.unique(np.floor(CELLS_PER_OCTAVE * pairs), axis=0, return_inverse=True)[1].ravel()
    kept = (np.bincount(cell) >= OUTLIER_SHARE * len(pairs))[cell]
    directions = [a.direction[rows] for a, rows, known in zip(actions, counted, told, strict=True) if known]
    return TrainingRanges(
        speed=(float(speed[kept].min()), float(speed[kept].max())),
        force=(float(force[kept].min()), float(force[kept].max())),
        token_low=np.min(tokens, axis=0),
        token_high=np.max(tokens, axis=0),
        hull=np.exp2(compute_convex_hull(pairs[kept])),
        sectors=_find_sectors(np.concatenate(directions)) if directions else (),
        mechanics={
            name: _summarise_property([getattr(each, name) for each in mechanics], withheld) for name in MECHANICS_NAMES
        },
        probes=tuple(sorted(set(probes if probes is not None else (action.probe for action in actions)))),
    )


def compute_convex_hull(points: Float) -> Float:
    """(n, 2) → (k, 2) corners anticlockwise without collinear ones (A. M. Andrew 1979, monotone chain); k = 1 or 2
    where all points are one, or lie on a line."""
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
    """The point of a convex hull (k, 2) nearest to each of points (n, 2); itself where it lies inside."""
    pieces = [
        _find_nearest_in_hull(hull, points[first : first + _BATCH_STATES])
        for first in range(0, len(points), _BATCH_STATES)
    ]
    return np.concatenate(pieces) if pieces else np.zeros((0, 2))


def _find_nearest_in_hull(hull: Float, points: Float) -> Float:
    start, edge = hull, np.roll(hull, -1, axis=0) - hull
    along = points[:, None, :] - start
    place = (along * edge).sum(axis=2) / np.maximum((edge * edge).sum(axis=1), 1e-300)
    foot = start + np.clip(place, 0.0, 1.0)[..., None] * edge
    best = np.argmin(np.linalg.norm(points[:, None, :] - foot, axis=2), axis=1)
    near = foot[np.arange(len(points)), best]
    if len(hull) < 3:
        return np.asarray(near)
    inside = (edge[:, 0] * along[..., 1] - edge[:, 1] * along[..., 0] >= 0.0).all(axis=1)
    return np.where(inside[:, None], points, near)


def compute_angle_to_sectors(sectors: Sequence[bool], angle: Float) -> tuple[Float, NDArray[np.intp]]:
    """How far (rad, 0 inside) each angle (n,) lies from the edge of the nearest trained sector, and which that is."""
    trained = np.flatnonzero(np.asarray(sectors))
    pieces = [
        _angle_to_nearest(trained, angle[first : first + _BATCH_STATES])
        for first in range(0, max(len(angle), 1), _BATCH_STATES)
    ]
    return np.concatenate([apart for apart, _ in pieces]), np.concatenate([nearest for _, nearest in pieces])


def _angle_to_nearest(trained: NDArray[np.intp], angle: Float) -> tuple[Float, NDArray[np.intp]]:
    apart = np.abs((angle[:, None] - trained * SECTOR_RAD + np.pi) % (2.0 * np.pi) - np.pi)
    return np.maximum(apart.min(axis=1) - SECTOR_RAD / 2.0, 0.0), trained[np.argmin(apart, axis=1)]


def _find_sectors(direction: Float) -> tuple[bool, ...]:
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    counts = np.bincount(np.rint(angle / SECTOR_RAD).astype(int) % SECTORS, minlength=SECTORS)
    return tuple(bool(count > 0 and count >= OUTLIER_SHARE * len(angle)) for count in counts)


def _summarise_property(values: Sequence[float | None], withheld: bool) -> PropertyRange:
    known = [float(value) for value in values if value is not None]
    return PropertyRange((min(known), max(known)) if known else None, withheld or len(known) < len(values))


def _cross(a: Float, b: Float, c: Float) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _unusable_error(what: str) -> StrokeError:
    return StrokeError(what, where="training ranges", remedy="Give the data that the field was trained on.")
