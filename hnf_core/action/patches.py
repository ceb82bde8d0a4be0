"""The patches a stroke touches, and the stroke as seen from them: u(t)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.patch import PATCH_SIZE_M, Patch
from .action import Action
from .contacts import Contacts

Float = NDArray[np.float64]
Int32 = NDArray[np.int32]
Bool = NDArray[np.bool_]

USABLE_SHARE = 0.7
"""Share of the half side that the path may use: the rest keeps every touched point off the map's border."""
MAX_TURN_COSINE = float(np.cos(np.radians(25.0)))
REST_M_S = 1e-6
"""Below this speed a hand rests, and its direction is the last one it had."""


def covers(patch: Patch, contacts: Contacts) -> Bool:
    """(n,) whether each contact lies well inside the patch: same slot, within REACH, normal within 25°."""
    local = contacts.point - patch.centre
    reach = USABLE_SHARE * patch.size_m / 2.0
    inside = (np.abs(patch.to_plane(contacts.point)) <= reach).all(axis=1) & (np.abs(local @ patch.normal) <= reach)
    return np.asarray(inside & (contacts.slot == patch.slot) & (contacts.normal @ patch.normal >= MAX_TURN_COSINE))


def plan_patches(contacts: Contacts, patch_size: float = PATCH_SIZE_M) -> tuple[tuple[Patch, ...], Int32]:
    """The fewest patches a walk along the stroke needs, and which one each sample lies on ((n,) int32, −1 off the
    surface or without force).

    Each new patch is centred as far ahead as it still covers the first sample that no earlier patch covers. A
    sample then belongs to the covering patch with the nearest centre, so that the choice depends on the place
    alone: a stroke that comes back meets the same patches.
    """
    touched = contacts.on_surface & (contacts.force > 0.0)
    open_ = touched.copy()
    patches: list[Patch] = []
    while open_.any():
        first = int(np.argmax(open_))
        centre = first
        patch = _make_patch(contacts, first, patch_size)
        for ahead in range(first + 1, len(open_)):
            if not open_[ahead]:
                break
            candidate = _make_patch(contacts, ahead, patch_size)
            if not covers(candidate, _slice_contacts(contacts, slice(first, ahead + 1))).all():
                break
            patch, centre = candidate, ahead
        covered = covers(patch, contacts)
        covered[centre] = covered[first] = True
        open_ &= ~covered
        patches.append(patch)
    return tuple(patches), _assign_patches(contacts, patches, touched)


def action_from_contacts(
    contacts: Contacts, patches: tuple[Patch, ...], patch_index: Int32, probe: str = "pen"
) -> Action:
    """u(t) of a stroke: direction in each sample's patch, speed, force, and contact where there is a patch.

    Directions at rest, and off the surface, are the last one before, or else the first one after; +x if the hand
    never moves.
    """
    speed = np.linalg.norm(contacts.velocity, axis=1)
    x_axis, y_axis = contacts.uv_tangent.copy(), np.cross(contacts.normal, contacts.uv_tangent)
    on = patch_index >= 0
    if patches:
        x_axis[on] = np.array([patch.x_axis for patch in patches])[patch_index[on]]
        y_axis[on] = np.array([patch.y_axis for patch in patches])[patch_index[on]]
    flat = np.stack([np.einsum("nx,nx->n", contacts.velocity, axis) for axis in (x_axis, y_axis)], axis=1)
    size = np.linalg.norm(flat, axis=1)
    direction = _fill_direction(flat / np.where(size > 0.0, size, 1.0)[:, None], (size > REST_M_S) & on)
    step = float(contacts.time[1] - contacts.time[0]) if len(contacts.time) > 1 else 1.0
    return Action(
        rate=round(1.0 / step, 9),
        direction=direction,
        speed=speed,
        force=contacts.force,
        position=contacts.position,
        contact=on,
        probe=probe,
    )


def _make_patch(contacts: Contacts, i: int, size_m: float) -> Patch:
    return Patch(contacts.point[i], contacts.uv_tangent[i], contacts.normal[i], int(contacts.slot[i]), size_m)


def _slice_contacts(contacts: Contacts, rows: slice) -> Contacts:
    return Contacts(**{name: getattr(contacts, name)[rows] for name in Contacts.__dataclass_fields__})


def _assign_patches(contacts: Contacts, patches: list[Patch], touched: Bool) -> Int32:
    """The covering patch with the nearest centre; the earlier one of equals."""
    index = np.full(len(touched), -1, dtype=np.int32)
    best = np.full(len(touched), np.inf)
    for k, patch in enumerate(patches):
        away = np.linalg.norm(contacts.point - patch.centre, axis=1)
        away[~(covers(patch, contacts) & touched)] = np.inf
        closer = away < best - 1e-9
        index[closer], best[closer] = k, away[closer]
    return index


def _fill_direction(direction: Float, good: Bool) -> Float:
    """Each row of direction where good, else the last good one before, or else the first after; +x if none is."""
    if not good.any():
        return np.tile([1.0, 0.0], (len(good), 1))
    last = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
    last[last < 0] = int(np.argmax(good))
    return np.asarray(direction[last])
