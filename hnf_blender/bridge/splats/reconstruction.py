"""A splat file → its splats and the surface to touch them on. Without bpy, so that a thread can do it; the surface is
made once and kept by the file's content.

How a cloud of splats shows in the viewport: ellipsoids by Geometry Nodes, one set of nodes for all clouds of which
the same share is shown (Blender 5.2 takes no value for a modifier's input under the names that 4.2 to 5.0 know).

Native splats of Blender 5.3 and later are not used: no such Blender could be tried.

A reconstruction → Blender objects: the surface that is touched, and under it the splats that it is seen in.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core import __version__
from hnf_core.files import NPZ_ERRORS, content_hash, write_bytes
from hnf_core.scene.ply import read_ply_header
from hnf_core.scene.splats.gaussians import C0, Splats
from hnf_core.scene.splats.io_ply import detect_up_axis, read_splats
from hnf_core.scene.splats.reconstruct import DEFAULT_CELLS, DEFAULT_VIEWS, Progress, reconstruct_surface

from ... import compat
from ..scene.mesh_attributes import show_vertex_colours
from .splat_cloud import (
    HARMONIC_ATTRIBUTE,
    OPACITY_ATTRIBUTE,
    ROTATION_ATTRIBUTE,
    SCALE_ATTRIBUTE,
    create_cloud,
    link_cloud,
)

CACHE_VERSION = 1
COMPRESSED_SUFFIX = ".compressed"
"""What PlayCanvas's tools put before .ply; no part of a scene's name."""


@dataclass(frozen=True)
class TouchSurface:
    """What is touched of splats, in their frame and unit. vertices: (V, 3) float32. triangles: (T, 3) int32. colour:
    (V, 3) float32 linear. warnings: what makes it poor to touch."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    colour: NDArray[np.float32]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Reconstruction:
    """A splat file as a scene. name: of the object. source: of the file. up: (3,) unit, of the splats' frame.
    was_kept: nothing was reconstructed for it."""

    name: str
    source: str
    up: tuple[float, float, float]
    splats: Splats
    surface: TouchSurface
    was_cached: bool


def read_reconstruction(
    path: Path,
    cache: Path | None = None,
    *,
    write_cache: bool = True,
    cells: int | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """The splats of a file and their surface: from cache where it was made before, else made now and put there.

    cache: folder, None = nothing is kept. keep: False = read from it and write nothing. cells: along its longest axis,
    None = CELLS. progress: as reconstruct takes it. Raises FileError where the file cannot be read, SceneError where
    nothing solid is seen in it.
    """
    cells = DEFAULT_CELLS if cells is None else cells
    splats = read_splats(path)
    surface = None if cache is None else _load_cached(cache, path, cells)
    found = surface is not None
    if surface is None:
        made = reconstruct_surface(splats, cells=cells, progress=progress, where=str(path))
        surface = TouchSurface(made.vertices, made.triangles, made.colour, made.quality.warnings)
        if cache is not None and write_cache:
            _save_cached(cache, path, cells, surface)
    name = path.stem[: -len(COMPRESSED_SUFFIX)] if path.stem.lower().endswith(COMPRESSED_SUFFIX) else path.stem
    up = detect_up_axis(read_ply_header(path)).direction
    return Reconstruction(name or path.stem, path.name, up, splats, surface, found)


def _get_cache_path(cache: Path, path: Path, cells: int) -> Path:
    made_by = f"{__version__} {CACHE_VERSION} {cells} {DEFAULT_VIEWS}"
    return cache / f"{content_hash('reconstruction', made_by, path.read_bytes())}.npz"


def _load_cached(cache: Path, path: Path, cells: int) -> TouchSurface | None:
    """A damaged file counts as absent: it is made anew."""
    try:
        with np.load(_get_cache_path(cache, path, cells), allow_pickle=False) as data:
            warnings = tuple(str(line) for line in data["warnings"])
            surface = TouchSurface(data["vertices"], data["triangles"], data["colour"], warnings)
    except NPZ_ERRORS:
        return None
    count = len(surface.vertices)
    fits = surface.triangles.size and surface.triangles.min() >= 0 and surface.triangles.max() < count
    return surface if fits and surface.colour.shape == surface.vertices.shape == (count, 3) else None


def _save_cached(cache: Path, path: Path, cells: int, surface: TouchSurface) -> None:
    packed = io.BytesIO()
    np.savez(
        packed,
        vertices=surface.vertices,
        triangles=surface.triangles,
        colour=surface.colour,
        warnings=np.array(surface.warnings, dtype=np.str_),
    )
    write_bytes(_get_cache_path(cache, path, cells), packed.getvalue())


GROUP_NAME = "HNF Splats"
MODIFIER_NAME = "Splats"
MATERIAL_NAME = "HNF Splats"
MAX_SHOWN_SPLATS = 100_000
"""Ellipsoids of one cloud in the viewport. Each is an instance that every redraw walks over."""
ELLIPSOID_RADIUS = 1.5
"""Of an ellipsoid, in standard deviations: they then just close the surface they stand for."""


def show_ellipsoids(cloud: Any) -> None:
    """Give a cloud its modifier. Of more than MOST_SHOWN splats every second, third, … is shown."""
    modifier = cloud.modifiers.new(MODIFIER_NAME, "NODES")
    modifier.node_group = _get_node_group(get_display_stride(len(cloud.data.vertices)))


def get_display_stride(count: int) -> int:
    """1: all of so many splats are shown; 2: every second."""
    return max(1, -(-count // MAX_SHOWN_SPLATS))


def _get_node_group(stride: int) -> Any:
    """The node group that shows every splat, every second, …; made once in a file."""
    import bpy

    name = GROUP_NAME if stride == 1 else f"{GROUP_NAME}, 1 of {stride}"
    found = bpy.data.node_groups.get(name)
    if found is not None and found.bl_idname == "GeometryNodeTree" and found.library is None:
        return found
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.interface.new_socket("Splats", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Ellipsoids", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, link = group.nodes, group.links.new
    given, result = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    ball = nodes.new("GeometryNodeMeshIcoSphere")
    ball.inputs["Subdivisions"].default_value, ball.inputs["Radius"].default_value = 1, ELLIPSOID_RADIUS
    dressed = nodes.new("GeometryNodeSetMaterial")
    dressed.inputs["Material"].default_value = _get_splat_material()
    index, rest = nodes.new("GeometryNodeInputIndex"), nodes.new("FunctionNodeCompare")
    part = nodes.new("ShaderNodeMath")
    part.operation, rest.data_type, rest.operation = "MODULO", "FLOAT", "LESS_THAN"
    rest.inputs["B"].default_value = 0.5
    instances = nodes.new("GeometryNodeInstanceOnPoints")
    link(ball.outputs["Mesh"], dressed.inputs["Geometry"])
    link(index.outputs[0], part.inputs[0])
    part.inputs[1].default_value = float(stride)
    link(part.outputs[0], rest.inputs["A"])
    link(rest.outputs["Result"], instances.inputs["Selection"])
    link(given.outputs["Splats"], instances.inputs["Points"])
    link(dressed.outputs["Geometry"], instances.inputs["Instance"])
    link(_add_named_attribute(nodes, ROTATION_ATTRIBUTE, "QUATERNION"), instances.inputs["Rotation"])
    link(_add_named_attribute(nodes, SCALE_ATTRIBUTE, "FLOAT_VECTOR"), instances.inputs["Scale"])
    link(instances.outputs["Instances"], result.inputs["Ellipsoids"])
    for column, node in enumerate(nodes):
        node.location = (column * 180.0, 0.0)
    return group


def _add_named_attribute(nodes: Any, name: str, kind: str) -> Any:
    node = nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return next(output for output in node.outputs if output.enabled and output.name == "Attribute")


def _get_splat_material() -> Any:
    """The splats' own colour, unlit: the harmonics' constant part, which is what is left of them without a view."""
    import bpy

    found = bpy.data.materials.get(MATERIAL_NAME)
    if found is not None and found.library is None:
        return found
    material = bpy.data.materials.new(MATERIAL_NAME)
    compat.switch_nodes_on(material)
    tree = material.node_tree
    tree.nodes.clear()
    constant, opacity = (
        _add_instance_attribute(tree, name) for name in (HARMONIC_ATTRIBUTE.format(0), OPACITY_ATTRIBUTE)
    )
    colour = tree.nodes.new("ShaderNodeVectorMath")
    colour.operation = "MULTIPLY_ADD"
    colour.inputs[1].default_value, colour.inputs[2].default_value = (C0,) * 3, (0.5,) * 3
    shown = tree.nodes.new("ShaderNodeVectorMath")
    shown.operation = "MAXIMUM"
    linear = tree.nodes.new("ShaderNodeGamma")
    linear.inputs["Gamma"].default_value = 2.2
    glow, clear = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeBsdfTransparent")
    mix, output = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeOutputMaterial")
    link = tree.links.new
    link(constant.outputs["Vector"], colour.inputs[0])
    link(colour.outputs["Vector"], shown.inputs[0])
    link(shown.outputs["Vector"], linear.inputs["Color"])
    link(linear.outputs["Color"], glow.inputs["Color"])
    link(opacity.outputs["Fac"], mix.inputs[0])
    link(clear.outputs[0], mix.inputs[1])
    link(glow.outputs[0], mix.inputs[2])
    link(mix.outputs[0], output.inputs["Surface"])
    for column, node in enumerate(tree.nodes):
        node.location = (column * 180.0, 0.0)
    return material


def _add_instance_attribute(tree: Any, name: str) -> Any:
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_type, node.attribute_name = "INSTANCER", name
    return node


COLOUR_ATTRIBUTE = "Color"
"""Of the surface's points."""


def add_reconstruction(scene: Any, reconstruction: Reconstruction) -> Any:
    """The surface object, in scene's collection, upright; its splats are its child '<name> splats'.

    Both keep the file's frame and unit as their own; the surface's rotation turns the file's up to +z.
    """
    import bpy

    surface = bpy.data.objects.new(reconstruction.name, _create_mesh(reconstruction.name, reconstruction.surface))
    cloud = create_cloud(f"{reconstruction.name} splats", reconstruction.splats, reconstruction.source)
    for obj in (surface, cloud):
        scene.collection.objects.link(obj)
    notes = [f"object '{reconstruction.name}': {warning}" for warning in reconstruction.surface.warnings]
    link_cloud(surface, cloud, notes)
    show_vertex_colours(surface)
    show_ellipsoids(cloud)
    surface.rotation_mode = "QUATERNION"
    surface.rotation_quaternion = _compute_upright_rotation(reconstruction.up)
    return surface


def describe_shown_splats(reconstruction: Reconstruction) -> str:
    """What the viewport leaves out of so many splats; "" where it shows all."""
    every = get_display_stride(len(reconstruction.splats))
    if every == 1:
        return ""
    shown = f"one in {every} of its {len(reconstruction.splats)} splats ({MAX_SHOWN_SPLATS} at most)"
    return f"the viewport shows {shown}; all are felt."


def _create_mesh(name: str, surface: TouchSurface) -> Any:
    import bpy

    mesh = bpy.data.meshes.new(name)
    count = len(surface.triangles)
    mesh.vertices.add(len(surface.vertices))
    mesh.vertices.foreach_set("co", surface.vertices.ravel())
    mesh.loops.add(3 * count)
    mesh.loops.foreach_set("vertex_index", surface.triangles.ravel())
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(count, dtype=np.bool_))
    mesh.update(calc_edges=True)
    colour = mesh.color_attributes.new(COLOUR_ATTRIBUTE, "FLOAT_COLOR", "POINT")
    opaque = np.ones((len(surface.vertices), 4), dtype=np.float32)
    opaque[:, :3] = surface.colour
    colour.data.foreach_set("color", opaque.ravel())
    mesh.color_attributes.active_color_index = mesh.color_attributes.render_color_index = 0
    return mesh


def _compute_upright_rotation(up: tuple[float, float, float]) -> Any:
    """The shortest turn that brings up to +z; about x where it points straight down."""
    from mathutils import Quaternion, Vector

    if up[2] < -0.999999:
        return Quaternion((0.0, 1.0, 0.0, 0.0))
    return Vector(up).rotation_difference(Vector((0.0, 0.0, 1.0)))
