"""Content hashes of shaders: materials with equal hashes give equal renders.

Names, layout and selection of nodes do not count, and a file has the same hash in every Blender version.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hnf_core.files import content_hash

from ... import compat
from .images import hash_image, read_file_bytes

COSMETIC_PROPERTIES = frozenset({
    "name", "label", "location", "location_absolute", "width", "height", "select", "color", "use_custom_color",
    "show_options", "show_preview", "show_texture", "hide", "parent", "dimensions", "is_active_output", "rna_type",
    "warning_propagation", "color_tag", "is_active_preview", "subsurface_method", "falloff",
})  # fmt: skip
"""Node properties that affect only the editor, or only subsurface scattering (close-ups are unlit, and Blender 5.2
renamed its methods)."""

NEUTRAL_VALUES: dict[str, dict[str, object]] = {
    "ShaderNodeBsdfPrincipled": {"Diffuse Roughness": 0.0, "Thin Wall": False},
    "ShaderNodeBsdfGlass": {"Thin Film Thickness": 0.0, "Thin Film IOR": 1.33},
    "ShaderNodeBsdfMetallic": {"Thin Film Thickness": 0.0, "Thin Film IOR": 1.33},
    "ShaderNodeBump": {"Filter Width": 1.0},
    "ShaderNodeVolumeScatter": {
        "phase": "HENYEY_GREENSTEIN",
        "IOR": 1.33,
        "Backscatter": 0.1,
        "Alpha": 0.5,
        "Diameter": 20.0,
    },
    "ShaderNodeNormalMap": {"base": "DISPLACED", "convention": "OPENGL"},
}
"""Sockets and properties added after Blender 4.2, by node type, with the value that gives the result of older versions.
At that value they do not count."""

CURVE_SETTINGS = (
    "extend", "tone", "use_clip", "clip_min_x", "clip_min_y", "clip_max_x", "clip_max_y", "black_level", "white_level",
)  # fmt: skip
"""Properties of a curve mapping that affect its result."""
TEXTURE_MAPPING = (
    "vector_type", "translation", "rotation", "scale", "mapping", "mapping_x", "mapping_y", "mapping_z", "use_min",
    "use_max", "min", "max",
)  # fmt: skip

OUTPUT_NODES = ("ShaderNodeOutputMaterial", "ShaderNodeOutputWorld", "ShaderNodeOutputLight", "NodeGroupOutput")
"""Output nodes of which a tree may have several."""

FileReader = Callable[[Path], bytes | str]
ImageHash = Callable[[Any, Any], str]
"""Function (image, its user in a node) → hash."""

FLOAT32_TOLERANCE = 1e-6
"""Tolerance for comparing values that Blender stores as float32."""


def hash_material(material: Any, frame: int = 1, read_file: FileReader = read_file_bytes) -> str:
    """Hash everything that a material's node tree computes, pixels of images included.

    The file's working color space counts, since colors depend on it. Nodes that feed only the viewport do not count,
    nor does data of the object or mesh (see `object_inputs.py`).

    Parameters
    ----------
    material : bpy.types.Material or None
        Material; None gives "".
    frame : int, default 1
        Scene frame, which selects images of sequences; all other values are as they are now.
    read_file : callable, optional
        Content of an external image file that counts; its bytes by default.

    Returns
    -------
    str
    """
    if material is None:
        return ""
    if not compat.use_nodes(material):
        shading = (material.diffuse_color, material.roughness, material.metallic)
        return content_hash("plain", repr([list(shading[0]), shading[1], shading[2]]))
    method = getattr(material, "displacement_method", "")
    return content_hash(
        "nodes",
        method,
        *_iter_tree_values(material.node_tree, {}, _make_image_hash(frame, read_file)),
        *_describe_working_space(),
    )


def format_settings(block: Any) -> str:
    """Format a datablock's own numbers, texts and switches, without its nodes; "" for None.

    Properties that all datablocks have are left out.
    """
    import bpy

    if block is None:
        return ""
    common = {"rna_type", "name", "use_nodes", *bpy.types.ID.bl_rna.properties.keys()}
    settings = [
        (prop.identifier, _to_plain_value(getattr(block, prop.identifier)))
        for prop in block.bl_rna.properties
        if prop.type not in {"POINTER", "COLLECTION"} and not prop.is_readonly and prop.identifier not in common
    ]
    return repr(sorted(settings))


def hash_node_tree(tree: Any, frame: int = 1, read_file: FileReader = read_file_bytes) -> str:
    """Hash the node tree of a world or a light like `hash_material`; "" for None."""
    if tree is None:
        return ""
    return content_hash(
        "tree", *_iter_tree_values(tree, {}, _make_image_hash(frame, read_file)), *_describe_working_space()
    )


def _make_image_hash(frame: int, read_file: FileReader) -> ImageHash:
    return lambda image, user: hash_image(image, user, frame, read_file)


def _describe_working_space() -> Iterator[str]:
    """Yield the working color space, except for the default one, which older versions do not name."""
    yield from filter(None, [compat.working_space()])


def _iter_tree_values(tree: Any, visited: dict[str, int], image_hash: ImageHash) -> Iterator[str]:
    """Yield a node tree's nodes, in the order of the names by which links refer to them, and its links, as text."""
    if tree.name_full in visited:
        yield str(visited[tree.name_full])  # not its name, which a copy changes
        return
    visited[tree.name_full] = len(visited)
    if tree.animation_data is not None and tree.animation_data.drivers:
        yield repr([(driver.data_path, driver.driver.expression) for driver in tree.animation_data.drivers])
    yield from _iter_active_outputs(tree)
    for node in sorted(tree.nodes, key=lambda node: node.name):
        if node.bl_idname == "NodeFrame":
            continue
        yield node.name
        yield node.bl_idname
        yield repr(sorted(_iter_simple_properties(node)))
        yield repr(list(_iter_socket_values(node)))
        if node.bl_idname.startswith(("ShaderNodeValue", "ShaderNodeRGB")) or node.bl_idname == "ShaderNodeNormal":
            yield repr([_read_socket_value(socket) for socket in node.outputs])
        yield from _iter_special_values(node, visited, image_hash)
    yield from sorted(
        f"{link.from_node.name}|{link.from_socket.identifier}|{link.to_node.name}|{link.to_socket.identifier}"
        for link in tree.links
        if not link.is_muted
    )


def _iter_simple_properties(node: Any) -> Iterator[tuple[str, str]]:
    """Yield (name, value) of a node's properties that affect its result."""
    neutral = NEUTRAL_VALUES.get(node.bl_idname, {})
    for prop in node.bl_rna.properties:
        # Properties bl_… describe the node's type, and differ between versions.
        if (
            prop.identifier in COSMETIC_PROPERTIES
            or prop.identifier.startswith("bl_")
            or prop.type in {"POINTER", "COLLECTION"}
        ):
            continue
        if prop.is_readonly and prop.identifier != "mute":
            continue
        value = getattr(node, prop.identifier)
        if prop.identifier in neutral and value == neutral[prop.identifier]:
            continue
        yield prop.identifier, repr(list(value) if getattr(prop, "is_array", False) else value)


def _iter_socket_values(node: Any) -> Iterator[tuple[str, object]]:
    """Yield (identifier, value) of a node's inputs, in their order.

    Inputs that newer versions of Blender added are left out while they have no effect, so that hashes stay equal.
    """
    neutral = NEUTRAL_VALUES.get(node.bl_idname, {})
    for socket in node.inputs:
        value, name = _read_socket_value(socket), str(socket.identifier)
        neutral_value = neutral.get(name)
        if isinstance(neutral_value, float) and isinstance(value, float):
            neutral_value = value if abs(value - neutral_value) < FLOAT32_TOLERANCE else neutral_value
        if name not in neutral or socket.is_linked or value != neutral_value:
            yield name, value


def _read_socket_value(socket: Any) -> object:
    """Return a socket's default value as a plain Python value."""
    value = getattr(socket, "default_value", None)
    if value is None or isinstance(value, (int, float, str, bool)):
        return value
    try:
        return [float(part) for part in value]
    except TypeError:  # an object, image or collection socket
        return getattr(value, "name_full", repr(value))


def _iter_special_values(node: Any, visited: dict[str, int], image_hash: ImageHash) -> Iterator[str]:
    """Yield a node's values that are not simple properties: images, ramps, curves, texts, groups."""
    image = getattr(node, "image", None)
    if image is not None:
        yield image_hash(image, getattr(node, "image_user", None))
    ramp = getattr(node, "color_ramp", None)
    if ramp is not None:
        kinds = (ramp.interpolation, ramp.color_mode, ramp.hue_interpolation)
        yield repr((*kinds, [(e.position, list(e.color)) for e in ramp.elements]))
    mapping = getattr(node, "mapping", None)
    if mapping is not None and hasattr(mapping, "curves"):
        yield repr([[(list(point.location), point.handle_type) for point in curve.points] for curve in mapping.curves])
        yield repr([_to_plain_value(getattr(mapping, name)) for name in CURVE_SETTINGS])
    texture = getattr(node, "texture_mapping", None)
    if texture is not None:
        yield repr([_to_plain_value(getattr(texture, name)) for name in TEXTURE_MAPPING])
    for name in ("script", "ies"):
        text = getattr(node, name, None)
        if text is not None:
            yield str(text.as_string())
    target = getattr(node, "object", None)
    if target is not None:
        yield repr([list(row) for row in target.matrix_world])
    group = getattr(node, "node_tree", None)
    if group is not None:
        yield from _iter_tree_values(group, visited, image_hash)


def _iter_active_outputs(tree: Any) -> Iterator[str]:
    """Yield the names of a tree's active output nodes, for types of output of which it has several."""
    for kind in OUTPUT_NODES:
        outputs = [node for node in tree.nodes if node.bl_idname == kind]
        if len(outputs) > 1:
            yield repr(sorted(node.name for node in outputs if node.is_active_output))


def _to_plain_value(value: Any) -> object:
    return value if isinstance(value, (bool, int, float, str)) or not hasattr(value, "__len__") else list(value)
