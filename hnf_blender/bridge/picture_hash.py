"""What a lit picture of a scene follows from, as a hash: camera, lights, world, and all that stands in it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from hnf_core.errors import HnfError
from hnf_core.files import content_hash
from hnf_core.scene.camera import Camera

from .. import compat
from .hashes import format_settings, hash_material, hash_node_tree
from .images import fingerprint_file
from .meshes import get_slot_materials, hash_mesh
from .owner import find_shader_inputs, format_object_inputs

VISIBILITY_FLAGS = (
    "hide_render", "visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission",
    "visible_volume_scatter", "visible_shadow", "is_holdout", "is_shadow_catcher",
)  # fmt: skip
SCATTER_MODIFIERS = frozenset({"NODES", "PARTICLE_SYSTEM"})
"""Modifiers that may show what is in no mesh of the object's own."""


class RenderHashes:
    """Of the pictures of one scene as it is now; each object is looked at once.

    Files of images count by size and time of change: what stands around may have many, and a picture is soon drawn.

    source: hash of the file, which stands in for what is not looked at: scattered copies, hair, what has no faces.
    """

    def __init__(self, scene: Any, depsgraph: Any, metres_per_unit: float, source: str = "") -> None:
        self._scene, self._depsgraph, self._metres, self._source = scene, depsgraph, metres_per_unit, source
        self._lighting_hash = ""
        self._objects: dict[int, str] = {}
        self._materials: dict[int, str] = {}

    def hash_view(self, camera: Camera, objects: Iterable[Any], *extra: str) -> str:
        """Of a view by camera of these objects. words: what else is drawn."""
        if not self._lighting_hash:
            self._lighting_hash = content_hash(*_iter_lighting_values(self._scene, self._depsgraph))
        view = (
            camera.kind, camera.width, camera.height, camera.intrinsics.tolist(), camera.pose.tolist(),
            camera.clip_start, camera.clip_end,
        )  # fmt: skip
        return content_hash(repr(view), self._lighting_hash, *sorted(map(self._hash_object, objects)), *extra)

    def _hash_object(self, obj: Any) -> str:
        key = obj.as_pointer()
        if key not in self._objects:
            self._objects[key] = content_hash(*self._iter_object_values(obj))
        return self._objects[key]

    def _iter_object_values(self, obj: Any) -> Iterator[str]:
        yield _format_world_matrix(obj, self._depsgraph)
        yield repr([getattr(obj, name) for name in VISIBILITY_FLAGS])
        yield repr([(each.show_render, getattr(each, "render_levels", 0)) for each in obj.modifiers])
        if obj.instance_type != "NONE" or any(each.type in SCATTER_MODIFIERS for each in obj.modifiers):
            yield self._source
        try:
            materials = get_slot_materials(obj, self._depsgraph)
            reads = find_shader_inputs(obj, materials)
            yield hash_mesh(obj, self._depsgraph, self._metres, reads.layers)
        except HnfError:
            yield self._source
            return
        yield format_object_inputs(obj, self._scene.view_layers[0], materials, reads)
        yield from map(self._hash_material, materials)

    def _hash_material(self, material: Any) -> str:
        if material is None:
            return ""
        key = material.as_pointer()
        if key not in self._materials:
            self._materials[key] = hash_material(material, self._scene.frame_current, fingerprint_file)
        return self._materials[key]


def _iter_lighting_values(scene: Any, depsgraph: Any) -> Iterator[str]:
    """What lights the scene."""
    frame, world = scene.frame_current, scene.world
    for lamp in (obj for obj in scene.objects if obj.type == "LIGHT"):
        data = lamp.data
        yield _format_world_matrix(lamp, depsgraph)
        yield repr([getattr(lamp, name) for name in VISIBILITY_FLAGS])
        yield data.type + format_settings(data) + format_settings(getattr(data, "cycles", None))
        yield hash_node_tree(data.node_tree if getattr(data, "use_nodes", True) else None, frame, fingerprint_file)
    if world is not None:
        yield format_settings(world) + format_settings(getattr(world, "cycles", None))
        yield hash_node_tree(world.node_tree if compat.use_nodes(world) else None, frame, fingerprint_file)


def _format_world_matrix(obj: Any, depsgraph: Any) -> str:
    return repr([list(row) for row in obj.evaluated_get(depsgraph).matrix_world])
