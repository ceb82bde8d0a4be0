"""What a lit picture of a scene follows from, as a hash: camera, lights, world, and all that stands in it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from hnf_core.errors import HnfError
from hnf_core.files import content_hash
from hnf_core.scene.camera import Camera

from .. import compat
from .hashes import material_hash, settings_text, tree_hash
from .images import file_facts
from .meshes import mesh_hash, slot_materials
from .owner import owner_text, reads_of

SHOWN = (
    "hide_render", "visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission",
    "visible_volume_scatter", "visible_shadow", "is_holdout", "is_shadow_catcher",
)  # fmt: skip
SCATTERING = frozenset({"NODES", "PARTICLE_SYSTEM"})
"""Modifiers that may show what is in no mesh of the object's own."""


class PictureHashes:
    """Of the pictures of one scene as it is now; each object is looked at once.

    Files of images count by size and time of change: what stands around may have many, and a picture is soon drawn.

    source: hash of the file, which stands in for what is not looked at: scattered copies, hair, what has no faces.
    """

    def __init__(self, scene: Any, depsgraph: Any, metres_per_unit: float, source: str = "") -> None:
        self._scene, self._depsgraph, self._metres, self._source = scene, depsgraph, metres_per_unit, source
        self._around = ""
        self._objects: dict[int, str] = {}
        self._materials: dict[int, str] = {}

    def of(self, camera: Camera, objects: Iterable[Any], *words: str) -> str:
        """Of a view by camera of these objects. words: what else is drawn."""
        if not self._around:
            self._around = content_hash(*_around(self._scene, self._depsgraph))
        view = (
            camera.kind, camera.width, camera.height, camera.intrinsics.tolist(), camera.pose.tolist(),
            camera.clip_start, camera.clip_end,
        )  # fmt: skip
        return content_hash(repr(view), self._around, *sorted(map(self._object, objects)), *words)

    def _object(self, obj: Any) -> str:
        key = obj.as_pointer()
        if key not in self._objects:
            self._objects[key] = content_hash(*self._parts(obj))
        return self._objects[key]

    def _parts(self, obj: Any) -> Iterator[str]:
        yield _place(obj, self._depsgraph)
        yield repr([getattr(obj, name) for name in SHOWN])
        yield repr([(each.show_render, getattr(each, "render_levels", 0)) for each in obj.modifiers])
        if obj.instance_type != "NONE" or any(each.type in SCATTERING for each in obj.modifiers):
            yield self._source
        try:
            materials = slot_materials(obj, self._depsgraph)
            reads = reads_of(obj, materials)
            yield mesh_hash(obj, self._depsgraph, self._metres, reads.layers)
        except HnfError:
            yield self._source
            return
        yield owner_text(obj, self._scene.view_layers[0], materials, reads)
        yield from map(self._material, materials)

    def _material(self, material: Any) -> str:
        if material is None:
            return ""
        key = material.as_pointer()
        if key not in self._materials:
            self._materials[key] = material_hash(material, self._scene.frame_current, file_facts)
        return self._materials[key]


def _around(scene: Any, depsgraph: Any) -> Iterator[str]:
    """What lights the scene."""
    frame, world = scene.frame_current, scene.world
    for lamp in (obj for obj in scene.objects if obj.type == "LIGHT"):
        data = lamp.data
        yield _place(lamp, depsgraph)
        yield repr([getattr(lamp, name) for name in SHOWN])
        yield data.type + settings_text(data) + settings_text(getattr(data, "cycles", None))
        yield tree_hash(data.node_tree if getattr(data, "use_nodes", True) else None, frame, file_facts)
    if world is not None:
        yield settings_text(world) + settings_text(getattr(world, "cycles", None))
        yield tree_hash(world.node_tree if compat.use_nodes(world) else None, frame, file_facts)


def _place(obj: Any, depsgraph: Any) -> str:
    return repr([list(row) for row in obj.evaluated_get(depsgraph).matrix_world])
