"""OBJECT[:SLOT] → an object of the scene and one of its material slots."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from hnf_core.closest import close_matches, format_choices
from hnf_core.errors import SceneError

from ..bridge.scene_names import get_named_objects
from ..bridge.splat_cloud import is_cloud

MAX_NAMES = 12
"""Names in a message: more would not be read."""


@dataclass(frozen=True)
class Target:
    """object_name: a mesh object of the scene, as name_in calls it. slot: index of the material slot, None = the
    whole object."""

    object_name: str
    slot: int | None


def resolve_target(scene: Any, text: str) -> Target:
    """Object names may hold colons: the longest name that exists wins. Case counts only where it tells two names apart.

    Raises SceneError naming what is there instead.
    """
    meshes = {name: obj for name, obj in get_named_objects(scene).items() if obj.type == "MESH"}
    whole = _match_name(text, meshes)
    if whole is not None:
        return Target(whole, None)
    before, colon, slot_text = text.rpartition(":")
    name = _match_name(before, meshes) if colon else None
    if name is not None:
        return Target(name, _find_slot(meshes[name], slot_text))
    other = scene.objects.get(text)
    if other is not None:
        raise SceneError(
            f"it is a {other.type.lower()} object and has no surface to touch.",
            where=f"object '{text}'",
            remedy="Name a mesh object, or convert this one to a mesh (Object > Convert > Mesh).",
        )
    asked = before if colon else text
    raise SceneError(
        "there is no such object in the scene.", where=f"object '{asked}'", remedy=_suggest_objects(asked, meshes)
    )


def _match_name(text: str, names: Iterable[str]) -> str | None:
    """The name that text stands for: itself, or the only one that differs from it in case alone; None where none is."""
    known = list(names)
    if text in known:
        return text
    same = [name for name in known if name.casefold() == text.casefold()]
    return same[0] if len(same) == 1 else None


def _find_slot(obj: Any, text: str) -> int:
    names = [slot.material.name if slot.material else "" for slot in obj.material_slots]
    name = _match_name(text, names) if text else None
    if name is not None:
        return names.index(name)
    if text.isdecimal() and int(text) < max(1, len(names)):
        return int(text)
    slots = [f"{index} {name or '(empty)'}" for index, name in enumerate(names[:MAX_NAMES])]
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    raise SceneError(
        f"it has no material slot '{text}'.",
        where=f"object '{obj.name}'",
        remedy=f"Its slots: {', '.join(slots) or 'none'}{more}.",
    )


def _suggest_objects(text: str, meshes: Mapping[str, Any]) -> str:
    """The objects that could be meant: those with faces, those that are called like it first."""
    touchable = sorted(name for name, obj in meshes.items() if len(obj.data.polygons) and not is_cloud(obj))
    near = close_matches(text, touchable)
    guess = f"Did you mean {' or '.join(repr(name) for name in near)}? " if near else ""
    return (
        f"{guess}Objects here: {format_choices(touchable, MAX_NAMES)}."
        if touchable
        else "The scene holds no mesh with faces."
    )
