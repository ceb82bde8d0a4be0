"""Strokes across several objects: which object is touched at each sample, contacts with all of them, and their seams.

Every object has its own contacts, patches and tokens, in its own surface frame. They are brought into the frame of the
first object, which is the stroke's own, and joined. Where the stroke passes to another object, the difference in height
between the two is a seam, which the probe climbs or falls from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..scene.camera import Patch
from .contacts import CONTACT_TOLERANCE_M, Contacts

Float = NDArray[np.float64]
Int32 = NDArray[np.int32]

CROSSING_MARGIN_M = 0.5e-3
"""Distance by which another object must be nearer to be touched instead of the stroke's own [m]. Of surfaces that lie
on each other, such as a copy, the own one is touched."""
LEAST_SEAM_M = 5e-6
"""Difference in height below which a seam is no step [m]; objects that were placed by eye differ by less."""
PARALLEL = 1e-4
"""Sine of the angle between two surfaces below which they do not meet in a fold."""
STEP_OVER_M = 2.0 * CONTACT_TOLERANCE_M
"""Longest way from one object to another that a drawn stroke takes in any direction [m]: on it, contact is kept."""
STRIDE_FACTOR = 1.5
"""Way to another object, relative to the last step on the same one, that is still one of its steps."""
LEAST_SHARE = 0.1
"""Share of a drawn path below which an object on it counts as grazed by chance, at the end of a drag."""
SAME_SEAM_M = 1e-3
"""Distance along the path within which two crossings, there and back, are one seam [m]."""


@dataclass(frozen=True)
class Seam:
    """A place on the path where it passes from one object to another.

    Attributes
    ----------
    position_m : float
        Position along the path [m].
    step_m : float
        Height that the surface gains there in the direction of growing position [m].
    """

    position_m: float
    step_m: float


def choose_objects(distances: Float) -> Int32:
    """Choose the object that a stroke touches at each sample.

    Parameters
    ----------
    distances : ndarray, shape (k, n)
        Distance between curve and surface of k objects at n samples [m]; the first is the stroke's own.

    Returns
    -------
    ndarray of int32, shape (n,)
        The own one (0) while it lies under the stroke, within `CONTACT_TOLERANCE_M`, else the nearest of those that
        do; 0 where none does. Another one wins over the own only if it is nearer by more than `CROSSING_MARGIN_M`.
    """
    own, others = distances[0], distances[1:]
    if not len(others):
        return np.zeros(len(own), dtype=np.int32)
    nearest, distance = others.argmin(axis=0), others.min(axis=0)
    wins = (distance <= CONTACT_TOLERANCE_M) & ((own > CONTACT_TOLERANCE_M) | (distance + CROSSING_MARGIN_M < own))
    return np.where(wins, nearest + 1, 0).astype(np.int32)


def can_step_over(way: ArrayLike, view: ArrayLike, stride_m: float) -> bool:
    """Return whether a drawn stroke goes over to another object instead of leaving the last one.

    Parameters
    ----------
    way : array_like, shape (3,)
        Way from the last touched point to the first one on the other object [m].
    view : array_like, shape (3,)
        Direction of the view there, a unit vector.
    stride_m : float
        Last step on one object [m]; in a view along a surface the steps are long.

    Returns
    -------
    bool
        True if the way is a short one, or leads no further into depth than sideways: to a neighbor, but not from the
        edge of a box to the floor behind it.
    """
    way, view = np.asarray(way, dtype=np.float64), np.asarray(view, dtype=np.float64)
    depth = abs(float(way @ view))
    sideways = float(np.linalg.norm(way - (way @ view) * view))
    return float(np.linalg.norm(way)) <= max(STEP_OVER_M, STRIDE_FACTOR * stride_m) or depth <= sideways


def choose_touched(names: Sequence[str], points: Float) -> tuple[str, ...]:
    """Choose the objects that a drawn path touches, in the order touched.

    Parameters
    ----------
    names : sequence of str
        Object of each point, "" for none.
    points : ndarray, shape (n, 3)
        The path.

    Returns
    -------
    tuple of str
        Without those that have less than `LEAST_SHARE` of its length; all if none of it has any length.
    """
    length = dict.fromkeys(filter(None, names), 0.0)
    for before, name, step in zip(names, names[1:], np.linalg.norm(np.diff(points, axis=0), axis=1), strict=False):
        if name and before == name:
            length[name] += float(step)
    least = LEAST_SHARE * sum(length.values())
    return tuple(name for name, part in length.items() if part >= least)


def move_contacts(contacts: Contacts, frame: Float) -> Contacts:
    """Return contacts in another frame; `frame` (4, 4) is the rigid transform from theirs to it."""
    rotation = frame[:3, :3].T
    return replace(
        contacts,
        point=contacts.point @ rotation + frame[:3, 3],
        normal=contacts.normal @ rotation,
        uv_tangent=contacts.uv_tangent @ rotation,
        velocity=contacts.velocity @ rotation,
    )


def move_patch(patch: Patch, frame: Float) -> Patch:
    """Return a patch in another frame; `frame` (4, 4) is the rigid transform from its own to it."""
    rotation = frame[:3, :3]
    centre = rotation @ patch.centre + frame[:3, 3]
    return replace(patch, centre=centre, x_axis=rotation @ patch.x_axis, normal=rotation @ patch.normal)


def join_contacts(parts: Sequence[Contacts], owner: Int32) -> Contacts:
    """Join contacts with k objects, all in one frame, to those with the object `owner` (n,) of each sample.

    Time, force and position are the first one's. Triangles, faces and slots are those of the sample's own object.
    """
    rows = np.arange(len(owner))
    own = {"time", "force", "position"}
    joined = {
        name: np.stack([getattr(part, name) for part in parts])[owner, rows]
        for name in Contacts.__dataclass_fields__
        if name not in own
    }
    return replace(parts[0], **joined)


def find_seams(contacts: Contacts, owner: Int32) -> tuple[Seam, ...]:
    """Find where a path passes from one object to another without losing contact.

    `owner` (n,) is the object of each sample of the joined contacts, −1 without contact. Where the two surfaces meet in
    a fold between the samples, there is no step.
    """
    seams: list[Seam] = []
    for i in np.flatnonzero((owner[1:] != owner[:-1]) & (owner[1:] >= 0) & (owner[:-1] >= 0)):
        travel = contacts.position[i + 1] - contacts.position[i]
        normal = contacts.normal[i] + contacts.normal[i + 1]
        length = float(np.linalg.norm(normal))
        if travel == 0.0 or length < 1e-6 or _is_fold(contacts, i):
            continue
        step = float((contacts.point[i + 1] - contacts.point[i]) @ normal) / length * float(np.sign(travel))
        place = float(contacts.position[i] + contacts.position[i + 1]) / 2.0
        # The other edge of a narrow object is as near as a second crossing of the same one, but goes the other way.
        is_known = any(abs(seam.position_m - place) <= SAME_SEAM_M and seam.step_m * step > 0.0 for seam in seams)
        if abs(step) >= LEAST_SEAM_M and not is_known:
            seams.append(Seam(place, step))
    return tuple(seams)


def _is_fold(contacts: Contacts, i: int) -> bool:
    """Return True if the tangent planes of samples i and i + 1 meet between the two, along the way."""
    way = contacts.point[i + 1] - contacts.point[i]
    chord = float(np.linalg.norm(way))
    for normal, other in ((contacts.normal[i], contacts.normal[i + 1]), (contacts.normal[i + 1], contacts.normal[i])):
        along = way - (way @ normal) * normal
        length = float(np.linalg.norm(along))
        turn = float(along @ other) / length if length > 0.0 else 0.0
        if abs(turn) < PARALLEL or not -PARALLEL <= float(way @ other) / (turn * chord) <= 1.0 + PARALLEL:
            return False
    return True
