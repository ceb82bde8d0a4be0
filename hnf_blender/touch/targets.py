"""OBJECT[:SLOT] → an object of the scene and one of its material slots."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import Any

from hnf_core.errors import SceneError

from ..bridge.scene_names import named_objects


@dataclass(frozen=True)
class Target:
    """object_name: a mesh object of the scene, as name_in calls it. slot: index of the material slot, None = the
    whole object."""

    object_name: str
    slot: int | None


def resolve_target(scene: Any, text: str) -> Target:
    """Object names may hold colons: the longest name that exists wins.

    Raises SceneError naming what is there instead.
    """
    meshes = {name: obj for name, obj in named_objects(scene).items() if obj.type == "MESH"}
    if text in meshes:
        return Target(text, None)
    name, colon, slot_text = text.rpartition(":")
    if colon and name in meshes:
        return Target(name, _slot_index(meshes[name], slot_text))
    other = scene.objects.get(text)
    if other is not None:
        raise SceneError(
            f"it is a {other.type.lower()} object and has no surface to touch.",
            where=f"object '{text}'",
            remedy="Name a mesh object, or convert this one to a mesh (Object > Convert > Mesh).",
        )
    raise SceneError("there is no such object in the scene.", where=f"object '{text}'", remedy=_offer(text, meshes))


def _slot_index(obj: Any, text: str) -> int:
    names = [slot.material.name if slot.material else "" for slot in obj.material_slots]
    if text in names:
        return names.index(text)
    if text.isdecimal() and int(text) < max(1, len(names)):
        return int(text)
    listed = ", ".join(f"{index} {name or '(empty)'}" for index, name in enumerate(names)) or "none"
    raise SceneError(f"it has no material slot '{text}'.", where=f"object '{obj.name}'", remedy=f"Its slots: {listed}.")


def _offer(text: str, names: Any) -> str:
    close = difflib.get_close_matches(text, list(names), n=3, cutoff=0.4)
    if close:
        return "Did you mean " + " or ".join(f"'{name}'" for name in close) + "?"
    listed = ", ".join(f"'{name}'" for name in sorted(names)[:8])
    return f"Mesh objects here: {listed}." if listed else "The scene holds no mesh object."
