"""What shaders read of the object they are on, beside the shape of its surface: layers of its mesh, its place in the
world, its colour, its numbers, its properties."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from .aov_taps import IMAGE_NODE
from .node_graph import iter_nodes

WORLD_SPACE_OUTPUTS = frozenset({"Position", "Normal", "True Normal", "Tangent", "Incoming"})
"""Outputs of the Geometry node that are given in the world's own axes."""
RENDER_COLOUR_LAYER = ""
"""Of layers: the colours that are drawn where none are named."""


@dataclass(frozen=True)
class ShaderInputs:
    """What some shaders read. layers: names of attributes, UV maps and colours of the mesh. of_object, of_scene:
    names of properties. worldly: where it stands. generated: coordinates in its bounding box, which a radial tangent
    turns around too. info: names of the outputs of Object Info that are used."""

    layers: frozenset[str] = frozenset()
    object_properties: frozenset[str] = frozenset()
    scene_properties: frozenset[str] = frozenset()
    uses_world_space: bool = False
    uses_generated: bool = False
    object_info: frozenset[str] = frozenset()


def find_shader_inputs(obj: Any, materials: Iterable[Any]) -> ShaderInputs:
    """materials: of obj, None = empty slot."""
    layers: set[str] = set()
    of_object: set[str] = set()
    of_scene: set[str] = set()
    info: set[str] = set()
    worldly = generated = False
    for node in (node for material in materials if material is not None for node in iter_nodes(material.node_tree)):
        used = {output.name for output in node.outputs if output.is_linked}
        kind = node.bl_idname
        if kind == "ShaderNodeNewGeometry":
            worldly |= bool(used & WORLD_SPACE_OUTPUTS)
            generated |= "Tangent" in used
        elif kind == "ShaderNodeTexCoord":
            worldly |= "Object" in used and node.object is not None and node.object != obj
            worldly |= bool(used & {"Camera", "Window", "Reflection"})
            generated |= "Generated" in used
        elif kind == "ShaderNodeVectorTransform":
            worldly = True
        elif kind == "ShaderNodeObjectInfo":
            worldly |= "Location" in used
            info |= used
        elif kind == "ShaderNodeAttribute":
            {"GEOMETRY": layers, "VIEW_LAYER": of_scene}.get(node.attribute_type, of_object).add(node.attribute_name)
        elif kind == "ShaderNodeVertexColor":
            layers.add(node.layer_name or RENDER_COLOUR_LAYER)
        elif kind in {"ShaderNodeUVMap", "ShaderNodeTangent", "ShaderNodeNormalMap"}:
            layers |= {node.uv_map} - {""}
            worldly |= getattr(node, "space", "") in {"WORLD", "BLENDER_WORLD"}
            generated |= getattr(node, "direction_type", "") == "RADIAL"
        elif kind.startswith("ShaderNodeTex") and kind != IMAGE_NODE:
            vector = node.inputs.get("Vector")
            generated |= vector is not None and not vector.is_linked
    names = (frozenset(layers), frozenset(of_object), frozenset(of_scene))
    return ShaderInputs(*names, worldly, generated, frozenset(info))


def format_object_inputs(obj: Any, view_layer: Any, materials: Iterable[Any], inputs: ShaderInputs) -> str:
    """What shaders find there, as text; "" where they read nothing of the object. view_layer: of the scene that obj is
    touched in; it may stand in others too."""
    return "".join(f"{part}\n" for part in _iter_input_values(obj, view_layer, materials, inputs))


def _iter_input_values(obj: Any, view_layer: Any, materials: Iterable[Any], inputs: ShaderInputs) -> Iterator[str]:
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
    """Give a stand-in for obj what the shaders on it read of obj and of its scene. view_layer: as for owner_text, None
    where it stands in no scene."""
    stand_in.color, stand_in.pass_index = obj.color, obj.pass_index
    for name in inputs.object_properties:
        _set_property(stand_in, name, _find_property((obj, obj.data), name))
    for name in inputs.scene_properties if view_layer is not None else ():
        _set_property(temporary_scene, name, _find_property(_get_property_owners(view_layer), name))


def _get_property_owners(view_layer: Any) -> tuple[Any, ...]:
    """Where an Attribute node looks for a property of the view layer, in this order."""
    scene = view_layer.id_data
    return view_layer, scene, scene.world


def _set_property(block: Any, name: str, value: Any) -> None:
    """As a property of the block's own, which an Attribute node finds before any of Blender's."""
    if isinstance(value, (bool, int, float, list)):
        block[name] = value


def _find_property(blocks: Iterable[Any], name: str) -> Any:
    """As an Attribute node finds it: of the first block that has it, one of the artist's own, else one of Blender's."""
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
    """Numbers, and rows of them, alike however Blender wraps them."""
    return list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
