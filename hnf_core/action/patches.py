"""Patches (flat square frames on the surface) that cover a stroke, and its action u(t) in their tangent frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.camera import PATCH_SIZE_M, Patch
from .action import Action
from .contacts import Contacts

Float = NDArray[np.float64]
Int32 = NDArray[np.int32]
Bool = NDArray[np.bool_]

USABLE_SHARE = 0.7
"""Fraction of a patch's half side within which the path must stay, so that no touched point is at the map's border."""
MAX_TURN_COSINE = float(np.cos(np.radians(25.0)))
"""Cosine of the largest angle between the normals of a contact and its patch."""
REST_M_S = 1e-6
"""Speed below which a hand rests and keeps its last direction [m/s]."""


def covers(patch: Patch, contacts: Contacts) -> Bool:
    """Return a mask (n,) of the contacts well inside a patch, a flat square on the surface.

    Same material slot, within `USABLE_SHARE` of the square, normal within 25°.
    """
    local = contacts.point - patch.centre
    reach = USABLE_SHARE * patch.size_m / 2.0
    inside = (np.abs(patch.to_plane(contacts.point)) <= reach).all(axis=1) & (np.abs(local @ patch.normal) <= reach)
    return np.asarray(inside & (contacts.slot == patch.slot) & (contacts.normal @ patch.normal >= MAX_TURN_COSINE))


def plan_patches(contacts: Contacts, patch_size: float = PATCH_SIZE_M) -> tuple[tuple[Patch, ...], Int32]:
    """Choose the fewest patches (flat squares on the surface) that cover a stroke in order.

    Each new patch is centred as far ahead as it still covers the first sample that no earlier patch covers. A sample
    then belongs to the covering patch with the nearest centre, so that the choice depends on the position alone, and a
    stroke that returns uses the same patches.

    Parameters
    ----------
    contacts : Contacts
        Contacts of the stroke.
    patch_size : float
        Side of a patch [m].

    Returns
    -------
    patches : tuple of Patch
        The patches.
    index : ndarray of int32, shape (n,)
        Patch of each sample, −1 off the surface or without force.
    """
    is_touching = contacts.on_surface & (contacts.force > 0.0)
    uncovered = is_touching.copy()
    patches: list[Patch] = []
    while uncovered.any():
        first = int(np.argmax(uncovered))
        centre = first
        patch = _make_patch(contacts, first, patch_size)
        for index in range(first + 1, len(uncovered)):
            if not uncovered[index]:
                break
            candidate = _make_patch(contacts, index, patch_size)
            if not covers(candidate, _slice_contacts(contacts, slice(first, index + 1))).all():
                break
            patch, centre = candidate, index
        covered = covers(patch, contacts)
        covered[centre] = covered[first] = True
        uncovered &= ~covered
        patches.append(patch)
    return tuple(patches), _assign_patches(contacts, patches, is_touching)


def action_from_contacts(
    contacts: Contacts, patches: tuple[Patch, ...], patch_index: Int32, probe: str = "pen"
) -> Action:
    """Compute the action u(t) of a stroke, with directions in each sample's patch.

    Parameters
    ----------
    contacts : Contacts
        Contacts of the stroke.
    patches : tuple of Patch
        Patches from `plan_patches`.
    patch_index : ndarray of int32, shape (n,)
        Patch of each sample; there is contact where it has one.
    probe : str
        Contacting tip.

    Returns
    -------
    Action
        The action. At rest and off the surface, the direction is the last one before, else the first one after; +x if
        the hand never moves.
    """
    speed = np.linalg.norm(contacts.velocity, axis=1)
    x_axis, y_axis = contacts.uv_tangent.copy(), np.cross(contacts.normal, contacts.uv_tangent)
    on_patch = patch_index >= 0
    if patches:
        x_axis[on_patch] = np.array([patch.x_axis for patch in patches])[patch_index[on_patch]]
        y_axis[on_patch] = np.array([patch.y_axis for patch in patches])[patch_index[on_patch]]
    tangential = np.stack([np.einsum("nx,nx->n", contacts.velocity, axis) for axis in (x_axis, y_axis)], axis=1)
    tangential_speed = np.linalg.norm(tangential, axis=1)
    direction = _fill_direction(
        tangential / np.where(tangential_speed > 0.0, tangential_speed, 1.0)[:, None],
        (tangential_speed > REST_M_S) & on_patch,
    )
    step = float(contacts.time[1] - contacts.time[0]) if len(contacts.time) > 1 else 1.0
    return Action(
        rate=round(1.0 / step, 9),
        direction=direction,
        speed=speed,
        force=contacts.force,
        position=contacts.position,
        contact=on_patch,
        probe=probe,
    )


def _make_patch(contacts: Contacts, i: int, size_m: float) -> Patch:
    return Patch(contacts.point[i], contacts.uv_tangent[i], contacts.normal[i], int(contacts.slot[i]), size_m)


def _slice_contacts(contacts: Contacts, rows: slice) -> Contacts:
    return Contacts(**{name: getattr(contacts, name)[rows] for name in Contacts.__dataclass_fields__})


def _assign_patches(contacts: Contacts, patches: list[Patch], touched: Bool) -> Int32:
    """Return for each sample the patch with the nearest centre among those that cover it; −1 where not `touched`."""
    index = np.full(len(touched), -1, dtype=np.int32)
    best = np.full(len(touched), np.inf)
    for k, patch in enumerate(patches):
        distance = np.linalg.norm(contacts.point - patch.centre, axis=1)
        distance[~(covers(patch, contacts) & touched)] = np.inf
        closer = distance < best - 1e-9
        index[closer], best[closer] = k, distance[closer]
    return index


def _fill_direction(direction: Float, good: Bool) -> Float:
    """Replace directions (n, 2) that are not `good` by the last good one before, else the first after, else +x."""
    if not good.any():
        return np.tile([1.0, 0.0], (len(good), 1))
    last = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
    last[last < 0] = int(np.argmax(good))
    return np.asarray(direction[last])
