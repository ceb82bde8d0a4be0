"""Read a baked object and a stroke's path over it, for exports that bind touch to geometry.

Nothing is rendered; faces that were not baked have no token (description of the material's micro-geometry).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import Contacts, action_from_contacts, find_contacts, plan_patches
from hnf_core.errors import UsageError
from hnf_core.export.touched_surface import UNTOUCHED, StrokePath, TouchedSurface

from ..scene.meshes import Surface, read_surface
from ..scene.scene_names import find_object, get_scene_name
from ..scene.stored_data import FaceTokens, read_tokens
from .read_stroke import read_stroke


def read_touched_surface(
    scene: Any, depsgraph: Any, metres_per_unit: float, *, stroke: Any = None, obj: Any = None
) -> TouchedSurface:
    """Read an object with its baked tokens, and the path of a stroke over it.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene of the objects.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    metres_per_unit : float
        Length of a Blender unit [m].
    stroke : bpy.types.Object, optional
        Stroke whose path is included if it touches the object.
    obj : bpy.types.Object, optional
        Object to export; by default the stroke's surface.

    Returns
    -------
    TouchedSurface

    Raises
    ------
    UsageError
        If there is neither a stroke nor an object.
    StrokeError, SceneError
        If either cannot be read.
    FileError
        If the stored palette is damaged.
    """
    scene_stroke = None if stroke is None else read_stroke(stroke, scene, depsgraph, metres_per_unit)
    target = (
        obj if obj is not None else find_object(scene, scene_stroke.object_name) if scene_stroke is not None else None
    )
    if target is None:
        raise UsageError("no object to export.", remedy="Name a stroke or an object.")
    surface = read_surface(target, depsgraph, metres_per_unit)
    touched = _make_touched_surface(surface, read_tokens(target.data) if target.type == "MESH" else None)
    if scene_stroke is None or scene_stroke.object_name != get_scene_name(scene, target):
        return touched
    contacts = find_contacts(
        scene_stroke.samples, scene_stroke.get_surface(surface.mesh), where=f"stroke '{scene_stroke.name}'"
    )
    patches, index = plan_patches(contacts)
    action = action_from_contacts(contacts, patches, index, scene_stroke.probe)
    return replace(touched, path=make_stroke_path(contacts), action=action)


def make_stroke_path(contacts: Contacts) -> StrokePath:
    """Return, over time, the distance that the tip traveled over the material [m] and the triangles it pressed."""
    speed = np.linalg.norm(contacts.velocity, axis=1)
    steps = np.diff(contacts.time) * (speed[1:] + speed[:-1]) / 2.0
    pressed = contacts.on_surface & (contacts.force > 0.0)
    return StrokePath(
        time=contacts.time - contacts.time[0],
        distance=np.concatenate([[0.0], np.cumsum(steps)]),
        triangle=np.where(pressed, contacts.triangle, np.int32(UNTOUCHED)).astype(np.int32),
    )


def find_surface_in_scene(
    scene: Any, depsgraph: Any, metres_per_unit: float, provenance: Mapping[str, str], object_name: str | None
) -> TouchedSurface:
    """Find the surface on which a signal was synthesized, by the stroke and object named in its provenance.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene to search.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    metres_per_unit : float
        Length of a Blender unit [m].
    provenance : Mapping[str, str]
        Provenance of the signal's WAV file, with its stroke and object.
    object_name : str or None
        Object to use instead of the one in the provenance.

    Returns
    -------
    TouchedSurface

    Raises
    ------
    UsageError
        If there is no such object; lists the baked ones.
    """
    stroke = find_object(scene, provenance.get("stroke", ""))
    if stroke is not None and not stroke.hnf_stroke.is_stroke:
        stroke = None
    name = object_name or ("" if stroke is not None else provenance.get("object", ""))
    target = find_object(scene, name) if name else None
    if (name and target is None) or (target is None and stroke is None):
        meshes = [obj.name for obj in scene.objects if obj.type == "MESH" and read_tokens(obj.data) is not None]
        problem = f"there is no object '{name}' in scene '{scene.name}'" if name else "the WAV does not say its object"
        remedy = f"Name one with --object. Baked: {', '.join(meshes) or 'none; run hnf touch first'}."
        raise UsageError(f"{problem}.", remedy=remedy)
    return read_touched_surface(scene, depsgraph, metres_per_unit, stroke=stroke, obj=target)


def _make_touched_surface(surface: Surface, tokens: FaceTokens | None) -> TouchedSurface:
    """Combine a surface with its baked tokens per triangle; faces that a modifier created get none."""
    count = len(surface.mesh.triangles)
    index = np.full(count, UNTOUCHED, dtype=np.int32)
    roughness, confidence = np.zeros(count, np.float32), np.zeros(count, np.float32)
    if tokens is not None and surface.source_face is not None:
        source = surface.source_face[surface.mesh.face]
        known: NDArray[np.bool_] = (source >= 0) & (source < len(tokens.index))
        index[known] = tokens.index[source[known]]
        roughness[known], confidence[known] = tokens.roughness[source[known]], tokens.confidence[source[known]]
    return TouchedSurface(
        name=surface.object_name,
        mesh=surface.mesh,
        materials=surface.materials,
        token=index,
        roughness=roughness,
        confidence=confidence,
        palette=None if tokens is None else tokens.palette,
        placement=surface.rigid,
    )
