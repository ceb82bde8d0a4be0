"""Object and scene data that shaders read, besides the shape of the surface.

These are attributes of the mesh, the object's place in the world, its color and indices, and custom properties. They
are hashed, and copied to the copy of the object that is rendered in a temporary scene (stand-in).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from .aov_taps import IMAGE_NODE
from .node_graph import iter_nodes

WORLD_SPACE_OUTPUTS = frozenset({"Position", "Normal", "True Normal", "Tangent", "Incoming"})
"""Outputs of the Geometry node that are in world axes."""
RENDER_COLOUR_LAYER = ""
"""Name in `layers` of the color attribute that is rendered if none is named."""


@dataclass(frozen=True)
class ShaderInputs:
    """Object and scene data that shaders read.

    Attributes
    ----------
    layers : frozenset of str
        Names of the mesh's attributes, UV maps and colors.
    object_properties, scene_properties : frozenset of str
        Names of properties.
    uses_world_space : bool
        True if the object's place in the world counts.
    uses_generated : bool
        True if coordinates in its bounding box count, as for radial tangents.
    object_info : frozenset of str
        Names of the outputs of Object Info that are used.
    """

    layers: frozenset[str] = frozenset()
    object_properties: frozenset[str] = frozenset()
    scene_properties: frozenset[str] = frozenset()
    uses_world_space: bool = False
    uses_generated: bool = False
    object_info: frozenset[str] = frozenset()


def find_shader_inputs(obj: Any, materials: Iterable[Any]) -> ShaderInputs:
    """Return the object and scene data that the shaders of an object's materials (None for an empty slot) read."""
    layers: set[str] = set()
    object_properties: set[str] = set()
    scene_properties: set[str] = set()
    object_info: set[str] = set()
    uses_world_space = uses_generated = False
    for node in (node for material in materials if material is not None for node in iter_nodes(material.node_tree)):
        used = {output.name for output in node.outputs if output.is_linked}
        kind = node.bl_idname
        if kind == "ShaderNodeNewGeometry":
            uses_world_space |= bool(used & WORLD_SPACE_OUTPUTS)
            uses_generated |= "Tangent" in used
        elif kind == "ShaderNodeTexCoord":
            uses_world_space |= "Object" in used and node.object is not None and node.object != obj
            uses_world_space |= bool(used & {"Camera", "Window", "Reflection"})
            uses_generated |= "Generated" in used
        elif kind == "ShaderNodeVectorTransform":
            uses_world_space = True
        elif kind == "ShaderNodeObjectInfo":
            uses_world_space |= "Location" in used
            object_info |= used
        elif kind == "ShaderNodeAttribute":
            {"GEOMETRY": layers, "VIEW_LAYER": scene_properties}.get(node.attribute_type, object_properties).add(
                node.attribute_name
            )
        elif kind == "ShaderNodeVertexColor":
            layers.add(node.layer_name or RENDER_COLOUR_LAYER)
        elif kind in {"ShaderNodeUVMap", "ShaderNodeTangent", "ShaderNodeNormalMap"}:
            layers |= {node.uv_map} - {""}
            uses_world_space |= getattr(node, "space", "") in {"WORLD", "BLENDER_WORLD"}
            uses_generated |= getattr(node, "direction_type", "") == "RADIAL"
        elif kind.startswith("ShaderNodeTex") and kind != IMAGE_NODE:
            vector = node.inputs.get("Vector")
            uses_generated |= vector is not None and not vector.is_linked
    names = (frozenset(layers), frozenset(object_properties), frozenset(scene_properties))
    return ShaderInputs(*names, uses_world_space, uses_generated, frozenset(object_info))


def format_object_inputs(obj: Any, view_layer: Any, materials: Iterable[Any], inputs: ShaderInputs) -> str:
    """Format the values of the object and scene data that shaders read, for hashing; "" if they read none.

    `view_layer` is one of the scene in which the object is touched, since the object may be in other scenes too.
    """
    return "".join(f"{part}\n" for part in _iter_input_values(obj, view_layer, materials, inputs))


def _iter_input_values(obj: Any, view_layer: Any, materials: Iterable[Any], inputs: ShaderInputs) -> Iterator[str]:
    """Yield the values of the object and scene data that shaders read, as text."""
    if inputs.uses_world_space:
        yield repr([list(row) for row in obj.matrix_world])
    if inputs.object_info & {"Color", "Alpha"}:
        yield repr(list(obj.color))
    if "Object Index" in inputs.object_info:
        yield repr(obj.pass_index)
    if "Material Index" in inputs.object_info:
        yield repr([None if material is None else material.pass_index for material in materials])
    if "Random" in inputs.object_info:
        yield obj.name
    for name in sorted(inputs.object_properties):
        yield f"{name} {_find_property((obj, obj.data), name)!r}"
    for name in sorted(inputs.scene_properties):
        yield f"{name} {_find_property(_get_property_owners(view_layer), name)!r}"
    if inputs.uses_generated:
        yield repr([list(getattr(obj.data, name, ())) for name in ("texspace_location", "texspace_size")])


def copy_object_inputs(stand_in: Any, temporary_scene: Any, obj: Any, view_layer: Any, inputs: ShaderInputs) -> None:
    """Copy the values that shaders read from an object and its scene to its copy (stand-in) in a temporary scene.

    `view_layer` is one of the scene in which the object is touched, None if it is in no scene.
    """
    stand_in.color, stand_in.pass_index = obj.color, obj.pass_index
    for name in inputs.object_properties:
        _set_property(stand_in, name, _find_property((obj, obj.data), name))
    for name in inputs.scene_properties if view_layer is not None else ():
        _set_property(temporary_scene, name, _find_property(_get_property_owners(view_layer), name))


def _get_property_owners(view_layer: Any) -> tuple[Any, ...]:
    """Return the datablocks in which an Attribute node of type View Layer looks for a property, in its order."""
    scene = view_layer.id_data
    return view_layer, scene, scene.world


def _set_property(block: Any, name: str, value: Any) -> None:
    """Set a property as a custom one, which an Attribute node finds before Blender's built-in properties."""
    if isinstance(value, (bool, int, float, list)):
        block[name] = value


def _find_property(blocks: Iterable[Any], name: str) -> Any:
    """Return a property as an Attribute node finds it, or None.

    The first block that has it counts; custom properties come before Blender's own.
    """
    for block in blocks:
        if block is None:
            continue
        if name in block:
            return _to_plain_value(block[name])
        try:
            return _to_plain_value(block.path_resolve(name))
        except ValueError:
            continue
    return None


def _to_plain_value(value: Any) -> Any:
    """Convert Blender's arrays to lists, whatever type wraps them."""
    return list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
