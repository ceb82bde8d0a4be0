"""Splat file → surface mesh → Blender objects: the surface that is touched, with the splats as its child.

`read_reconstruction` of an opened file needs no bpy, so that a thread can run it; surfaces are cached by their splats.
In the viewport splats are ellipsoids instanced by Geometry Nodes. Each display stride (every n-th splat is shown) has a
node group of its own, because Blender 5.2 does not find modifier inputs under the names of 4.2 to 5.0. The native
splats of Blender 5.3 are not used; no such version was available for tests.
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
from hnf_core.progress import ProgressCallback, ignore_progress
from hnf_core.scene.splats.gaussians import C0, Splats, SplatSource
from hnf_core.scene.splats.reconstruct import DEFAULT_CELLS, DEFAULT_VIEWS, reconstruct_surface
from hnf_core.scene.splats.splat_file import open_splat_file, read_splats

from .. import compat
from .scene.stored_data import show_vertex_colours
from .shader.images import decode_image
from .splat_cloud import (
    HARMONIC_ATTRIBUTE,
    OPACITY_ATTRIBUTE,
    ROTATION_ATTRIBUTE,
    SCALE_ATTRIBUTE,
    create_cloud,
    link_cloud,
)

CACHE_VERSION = 1
"""Part of the cache key; to be raised if reconstructions change."""
COMPRESSED_SUFFIX = ".compressed"
"""Suffix that PlayCanvas's tools put before .ply; not part of a scene's name."""


@dataclass(frozen=True)
class TouchSurface:
    """Surface reconstructed from splats, in their frame and unit.

    Attributes
    ----------
    vertices : (V, 3) float32 array
    triangles : (T, 3) int32 array
    colour : (V, 3) float32 array
        Linear color.
    warnings : tuple of str
        Defects that make it poor to touch.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    colour: NDArray[np.float32]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Reconstruction:
    """A splat file with its surface.

    Attributes
    ----------
    name : str
        Name of the object.
    source : str
        Name of the file.
    up : (3,) tuple
        Unit vector that points up, in the splats' frame.
    splats : Splats
    surface : TouchSurface
    was_cached : bool
        True if the surface came from the cache.
    """

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
    progress: ProgressCallback = ignore_progress,
    source: SplatSource | None = None,
) -> Reconstruction:
    """Read a splat file and reconstruct its surface, or load the surface from the cache if it was made before.

    Parameters
    ----------
    path : Path
        Splat file of any layout.
    cache : Path, optional
        Folder of the cache; None neither reads nor writes one.
    write_cache : bool, default True
        If False, the cache is only read.
    cells : int, optional
        Grid cells along the longest axis; DEFAULT_CELLS by default.
    progress : callable, optional
        As in `reconstruct_surface`.
    source : SplatSource, optional
        The file if it was opened by `open_splats`.

    Returns
    -------
    Reconstruction

    Raises
    ------
    FileError
        If the file cannot be read.
    SceneError
        If it shows nothing solid.
    """
    cells = DEFAULT_CELLS if cells is None else cells
    source = open_splats(path) if source is None else source
    splats = read_splats(path, source=source)
    surface = None if cache is None else _load_cached(cache, splats, cells)
    was_cached = surface is not None
    if surface is None:
        result = reconstruct_surface(splats, cells=cells, progress=progress, where=str(path))
        surface = TouchSurface(result.vertices, result.triangles, result.colour, result.quality.warnings)
        if cache is not None and write_cache:
            _save_cached(cache, splats, cells, surface)
    name = path.stem[: -len(COMPRESSED_SUFFIX)] if path.stem.lower().endswith(COMPRESSED_SUFFIX) else path.stem
    return Reconstruction(name or path.stem, path.name, source.up.direction, splats, surface, was_cached)


def open_splats(path: Path) -> SplatSource:
    """Open a splat file in Blender's main thread, which decodes the pictures of a .sog; errors as `open_splat_file`."""
    return open_splat_file(path, decode_image)


def _get_cache_path(cache: Path, splats: Splats, cells: int) -> Path:
    version_key = f"{__version__} {CACHE_VERSION} {cells} {DEFAULT_VIEWS}"
    parts = (splats.means, splats.scales, splats.rotations, splats.opacities, splats.harmonics)
    digests = [content_hash(part.tobytes()) for part in parts]  # one copy in memory at a time
    return cache / f"{content_hash('reconstruction', version_key, *digests)}.npz"


def _load_cached(cache: Path, splats: Splats, cells: int) -> TouchSurface | None:
    """Load the surface of splats, made with `cells` grid cells, from the cache; None if missing or damaged."""
    try:
        with np.load(_get_cache_path(cache, splats, cells), allow_pickle=False) as data:
            warnings = tuple(str(line) for line in data["warnings"])
            surface = TouchSurface(data["vertices"], data["triangles"], data["colour"], warnings)
    except NPZ_ERRORS:
        return None
    count = len(surface.vertices)
    fits = surface.triangles.size and surface.triangles.min() >= 0 and surface.triangles.max() < count
    return surface if fits and surface.colour.shape == surface.vertices.shape == (count, 3) else None


def _save_cached(cache: Path, splats: Splats, cells: int, surface: TouchSurface) -> None:
    packed = io.BytesIO()
    np.savez(
        packed,
        vertices=surface.vertices,
        triangles=surface.triangles,
        colour=surface.colour,
        warnings=np.array(surface.warnings, dtype=np.str_),
    )
    write_bytes(_get_cache_path(cache, splats, cells), packed.getvalue())


GROUP_NAME = "HNF Splats"
MODIFIER_NAME = "Splats"
MATERIAL_NAME = "HNF Splats"
MAX_SHOWN_SPLATS = 100_000
"""Maximum number of ellipsoids of one cloud in the viewport; every redraw visits each instance."""
ELLIPSOID_RADIUS = 1.5
"""Radius of an ellipsoid in standard deviations, at which ellipsoids just close the surface."""


def show_ellipsoids(cloud: Any) -> None:
    """Add the Geometry Nodes modifier to a cloud; of more than MAX_SHOWN_SPLATS only every n-th is shown."""
    modifier = cloud.modifiers.new(MODIFIER_NAME, "NODES")
    modifier.node_group = _get_node_group(get_display_stride(len(cloud.data.vertices)))


def get_display_stride(count: int) -> int:
    """Return n if every n-th of `count` splats is shown."""
    return max(1, -(-count // MAX_SHOWN_SPLATS))


def _get_node_group(stride: int) -> Any:
    """Return the node group that shows every `stride`-th splat; it is created once per file."""
    import bpy

    name = GROUP_NAME if stride == 1 else f"{GROUP_NAME}, 1 of {stride}"
    existing = bpy.data.node_groups.get(name)
    if existing is not None and existing.bl_idname == "GeometryNodeTree" and existing.library is None:
        return existing
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.interface.new_socket("Splats", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Ellipsoids", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, link = group.nodes, group.links.new
    group_input, group_output = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    sphere = nodes.new("GeometryNodeMeshIcoSphere")
    sphere.inputs["Subdivisions"].default_value, sphere.inputs["Radius"].default_value = 1, ELLIPSOID_RADIUS
    set_material = nodes.new("GeometryNodeSetMaterial")
    set_material.inputs["Material"].default_value = _get_splat_material()
    index, compare = nodes.new("GeometryNodeInputIndex"), nodes.new("FunctionNodeCompare")
    modulo = nodes.new("ShaderNodeMath")
    modulo.operation, compare.data_type, compare.operation = "MODULO", "FLOAT", "LESS_THAN"
    compare.inputs["B"].default_value = 0.5
    instances = nodes.new("GeometryNodeInstanceOnPoints")
    link(sphere.outputs["Mesh"], set_material.inputs["Geometry"])
    link(index.outputs[0], modulo.inputs[0])
    modulo.inputs[1].default_value = float(stride)
    link(modulo.outputs[0], compare.inputs["A"])
    link(compare.outputs["Result"], instances.inputs["Selection"])
    link(group_input.outputs["Splats"], instances.inputs["Points"])
    link(set_material.outputs["Geometry"], instances.inputs["Instance"])
    link(_add_named_attribute(nodes, ROTATION_ATTRIBUTE, "QUATERNION"), instances.inputs["Rotation"])
    link(_add_named_attribute(nodes, SCALE_ATTRIBUTE, "FLOAT_VECTOR"), instances.inputs["Scale"])
    link(instances.outputs["Instances"], group_output.inputs["Ellipsoids"])
    for column, node in enumerate(nodes):
        node.location = (column * 180.0, 0.0)
    return group


def _add_named_attribute(nodes: Any, name: str, kind: str) -> Any:
    node = nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return next(output for output in node.outputs if output.enabled and output.name == "Attribute")


def _get_splat_material() -> Any:
    """Return the unlit material of splats, with their color and opacity.

    The color is the constant term of the spherical harmonics, the mean over all viewing directions.
    """
    import bpy

    existing = bpy.data.materials.get(MATERIAL_NAME)
    if existing is not None and existing.library is None:
        return existing
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
    clamped = tree.nodes.new("ShaderNodeVectorMath")
    clamped.operation = "MAXIMUM"
    linear = tree.nodes.new("ShaderNodeGamma")
    linear.inputs["Gamma"].default_value = 2.2
    emission, transparent = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeBsdfTransparent")
    mix, output = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeOutputMaterial")
    link = tree.links.new
    link(constant.outputs["Vector"], colour.inputs[0])
    link(colour.outputs["Vector"], clamped.inputs[0])
    link(clamped.outputs["Vector"], linear.inputs["Color"])
    link(linear.outputs["Color"], emission.inputs["Color"])
    link(opacity.outputs["Fac"], mix.inputs[0])
    link(transparent.outputs[0], mix.inputs[1])
    link(emission.outputs[0], mix.inputs[2])
    link(mix.outputs[0], output.inputs["Surface"])
    for column, node in enumerate(tree.nodes):
        node.location = (column * 180.0, 0.0)
    return material


def _add_instance_attribute(tree: Any, name: str) -> Any:
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_type, node.attribute_name = "INSTANCER", name
    return node


COLOUR_ATTRIBUTE = "Color"
"""Colour attribute of the surface's vertices."""


def add_reconstruction(scene: Any, reconstruction: Reconstruction) -> Any:
    """Add the surface object to a scene, upright, with its splats as the child '<name> splats'.

    Both keep the file's frame and unit as their own; the surface's rotation turns the file's up axis to +z. Returns the
    surface object.
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
    """Describe which fraction of the splats the viewport shows; "" if it shows all."""
    stride = get_display_stride(len(reconstruction.splats))
    if stride == 1:
        return ""
    shown = f"one in {stride} of its {len(reconstruction.splats)} splats ({MAX_SHOWN_SPLATS} at most)"
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
    """Return the shortest rotation from the unit vector `up` to +z; about x if `up` points straight down."""
    from mathutils import Quaternion, Vector

    if up[2] < -0.999999:
        return Quaternion((0.0, 1.0, 0.0, 0.0))
    return Vector(up).rotation_difference(Vector((0.0, 0.0, 1.0)))
