"""Objects of a scene that have a surface to touch, reasons why others have none, and instances made into objects.

Blender evaluates text, curves, NURBS surfaces and metaballs to meshes, so that they are touched like meshes. Instances
are no objects of the scene: `realise_instances` makes objects of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import PureWindowsPath
from typing import Any

import numpy as np

from hnf_core.errors import SceneError, pluralize

from ..splat_cloud import is_cloud
from .meshes import evaluated_mesh, get_coordinate_step
from .object_size import filter_visible

SURFACE_TYPES = frozenset({"MESH", "CURVE", "SURFACE", "META", "FONT"})
"""Types of objects that Blender evaluates to a mesh."""
REASONS_BY_TYPE = {
    "CURVES": "hair has no surface to touch. Convert it to a mesh (Object > Convert > Mesh).",
    "POINTCLOUD": "a point cloud has no faces to touch. Make a mesh of it (Geometry Nodes: Points to Volume, Volume to "
    "Mesh).",
    "VOLUME": "a volume has no faces to touch. Make a mesh of it (modifier Volume to Mesh).",
    "GREASEPENCIL": "drawn lines have no surface to touch. Convert them to a mesh (Object > Convert > Mesh).",
    "GPENCIL": "drawn lines have no surface to touch. Convert them to a mesh (Object > Convert > Mesh).",
}
"""Type of visible objects without a surface → reason and remedy."""
MAKE_REAL = "Object > Apply > Make Instances Real"
MAX_COPIES, MAX_FACES = 500, 2_000_000
"""Largest number of objects that are made of instances, and of faces that Geometry Nodes' instances are made into."""
MAX_MEASURED_FACES = 1_000
"""Number of faces up to which the area of each is read."""
MAX_COUNTED = 200_000
"""Largest number of instances that are counted."""


def is_surface(obj: Any) -> bool:
    """Return True if an object is of a type that is evaluated to a mesh, and no stroke."""
    return obj.type in SURFACE_TYPES and not obj.hnf_stroke.is_stroke


def list_surfaces(scene: Any, view_layer: Any, ignore: Any = None) -> list[Any]:
    """Return the visible objects of a scene that are evaluated to a mesh, without strokes and `ignore`.

    The mesh of some may have no faces.
    """
    return filter_visible((obj for obj in scene.objects if is_surface(obj) and obj != ignore), view_layer)


def explain_untouchable(obj: Any, depsgraph: Any) -> str:
    """Return why nothing of a visible object can be touched, with a remedy; "" if it can be, or shows nothing."""
    if obj.type in SURFACE_TYPES:
        return _explain_no_faces(obj, depsgraph)
    if obj.library is not None and getattr(obj, "is_missing", False):
        return _explain_missing_library(obj.library)
    if obj.type in REASONS_BY_TYPE:
        return REASONS_BY_TYPE[obj.type]
    if obj.type == "EMPTY" and obj.instance_type == "COLLECTION":
        collection = obj.instance_collection
        if collection is None or getattr(collection, "is_missing", False):
            library = None if collection is None else collection.library
            return "it shows no collection." if library is None else _explain_missing_library(library)
        return f"it shows instances of collection '{collection.name}', which are no objects. Use {MAKE_REAL}."
    return ""


def _explain_missing_library(library: Any) -> str:
    name = PureWindowsPath(library.filepath.removeprefix("//")).name
    return f"its library {name} is missing. Put the file back, or find it (File > External Data > Find Missing Files)."


def _explain_no_faces(obj: Any, depsgraph: Any) -> str:
    """Return why an object of one of SURFACE_TYPES has no face with an area; "" if it has one."""
    evaluated = obj.evaluated_get(depsgraph)
    if obj.type == "MESH" and len(evaluated.data.polygons):
        step, has_many = get_coordinate_step(evaluated), len(evaluated.data.polygons) > MAX_MEASURED_FACES
        if has_many and step * 100.0 < min(filter(None, map(abs, evaluated.dimensions)), default=0.0):
            return ""  # far too fine a grid for all its faces to collapse, and a scene may have many such objects
        return _explain_no_area(evaluated.data, step)
    if obj.type == "META" and not _has_faces(evaluated, depsgraph) and "." in obj.name:
        return f"it is a part of the metaball '{obj.name.partition('.')[0]}', whose surface holds it."
    if not _has_faces(evaluated, depsgraph):
        if obj.type == "CURVE":
            return "it is a line without faces. Give it a bevel, or make it a stroke (Touch tab)."
        if obj.type == "MESH" and len(obj.data.polygons):
            return "its modifiers leave no face to touch. Repair or remove them."
        return "it has no faces. Give it some to touch it."
    return ""


def _explain_no_area(mesh: Any, step: float) -> str:
    """Return why none of a mesh's faces has an area; "" if one has. `step` is that of its coordinates."""
    area = np.empty(len(mesh.polygons), dtype=np.float32)
    mesh.polygons.foreach_get("area", area)
    if (area > 0.0).any():
        return ""
    if step >= 1e-3:
        return (
            f"its coordinates are so far from 0 that they are rounded to steps of {step:.2g}, and its faces have no "
            "area. Subtract the map's offset where it was made, and import it again."
        )
    return "none of its faces has any area. Rebuild it."


def _has_faces(evaluated: Any, depsgraph: Any) -> bool:
    try:
        with evaluated_mesh(evaluated, depsgraph, copied=False):
            return True
    except SceneError:
        return False


@dataclass
class _Instanced:
    """Instances that one object (the instancer) shows besides itself: number, and names of their objects."""

    count: int = 0
    names: dict[str, None] = field(default_factory=dict)


def describe_instances(depsgraph: Any) -> Iterator[tuple[Any, str]]:
    """Yield (object, reason) of every object whose instances and particles are visible and cannot be touched.

    Collection instances are left to `explain_untouchable`.
    """
    shown: dict[Any, _Instanced] = {}
    for instance, instancer in _iter_instances(depsgraph):
        if instancer.type == "EMPTY":
            continue
        entry = shown.setdefault(instancer, _Instanced())
        entry.count += 1
        entry.names[instance.object.original.name] = None
    for instancer, entry in shown.items():
        names = ", ".join(list(entry.names)[:3])
        yield instancer, f"its {pluralize(entry.count, 'instance')} ({names}) are no objects. Use {MAKE_REAL}."
    for obj in dict.fromkeys(instance.object.original for instance in depsgraph.object_instances):
        for system in obj.particle_systems:
            if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
                yield obj, f"its hair '{system.name}' has no surface to touch. Convert it to a mesh in its modifier."


def _iter_instances(depsgraph: Any) -> Iterator[tuple[Any, Any]]:
    """Yield (instance, object that shows it) of every visible instance of a surface.

    The mesh of a text or curve counts as its own instance in Blender, and is left out.
    """
    for instance in islice(depsgraph.object_instances, MAX_COUNTED):
        if not instance.is_instance or instance.parent is None or instance.object.type not in SURFACE_TYPES:
            continue
        instancer = instance.parent.original
        scatters = instancer.instance_type != "NONE" or len(instancer.particle_systems) > 0
        scatters = scatters or any(modifier.type == "NODES" for modifier in instancer.modifiers)
        if scatters and not is_cloud(instancer):
            yield instance, instancer


def realise_instances(scene: Any, view_layer: Any) -> list[str]:
    """Make objects of a scene's collection instances, and faces of the instances of Geometry Nodes; return notes.

    An instance becomes an object with the same mesh, a child of the object that shows it. Meshes whose Geometry Nodes
    make instances get a Realize Instances modifier. Too many instances are left as they are, and said.
    """
    view_layer.update()
    depsgraph = view_layer.depsgraph
    copied: list[tuple[Any, Any, Any]] = []
    faces: dict[Any, int] = {}
    for instance, instancer in _iter_instances(depsgraph):
        source = instance.object.original
        if instancer.type == "MESH":
            if instance.particle_system is None and instancer.instance_type == "NONE":
                shape = instance.object.data
                faces[instancer] = faces.get(instancer, 0) + len(getattr(shape, "polygons", ()))
        elif is_surface(source) and not source.hide_render and source != instancer:
            copied.append((source, instancer, instance.matrix_world.copy()))
    notes = _copy_instances(scene, copied)
    realised = [obj for obj, count in faces.items() if count <= MAX_FACES and obj.library is None]
    for obj in realised:
        obj.modifiers.new("Realize Instances", "NODES").node_group = _get_realise_group()
    if realised:
        names = ", ".join(f"'{obj.name}'" for obj in realised[:3])
        notes.append(f"the instances that Geometry Nodes make of {names} were realized, so that they can be touched.")
    if copied or realised:
        view_layer.update()
    return notes


def _copy_instances(scene: Any, instances: list[tuple[Any, Any, Any]]) -> list[str]:
    """Make an object of each (source object, instancer, world matrix), MAX_COPIES at most; return notes."""
    first = {source.session_uid: index for index, (source, _, _) in reversed(list(enumerate(instances)))}
    ranked = sorted(range(len(instances)), key=lambda index: first[instances[index][0].session_uid] != index)
    chosen = sorted(ranked[:MAX_COPIES])
    for source, instancer, matrix in (instances[index] for index in chosen):
        copy = source.copy()
        copy.name = f"{source.name} ({instancer.name})"
        copy.animation_data_clear()
        copy.constraints.clear()
        copy.parent, copy.parent_type = instancer, "OBJECT"
        copy.matrix_parent_inverse = instancer.matrix_world.inverted_safe() @ matrix
        copy.matrix_basis.identity()
        scene.collection.objects.link(copy)
    for instancer in {instancer for _, instancer, _ in instances} if len(instances) <= MAX_COPIES else ():
        instancer.instance_type = "NONE"  # else each would be shown twice
        for modifier in instancer.modifiers:  # of a point cloud or hair that shows meshes
            modifier.show_viewport = modifier.show_render = False
        instancer.hide_render = instancer.type != "EMPTY"
    if not instances:
        return []
    names = ", ".join(dict.fromkeys(f"'{instancer.name}'" for _, instancer, _ in instances[:8]))
    left = len(instances) - len(chosen)
    more = f"; {left} more are left as they are, since they are too many" if left else ""
    return [f"{pluralize(len(chosen), 'object')} made of the instances of {names}, so that they can be touched{more}."]


def _get_realise_group() -> Any:
    """Return the node group that realizes instances."""
    import bpy

    name = "hnf realize instances"
    group = bpy.data.node_groups.get(name)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    start, realise, end = (
        group.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeRealizeInstances", "NodeGroupOutput")
    )
    group.links.new(start.outputs[0], realise.inputs[0])
    group.links.new(realise.outputs[0], end.inputs[0])
    return group
