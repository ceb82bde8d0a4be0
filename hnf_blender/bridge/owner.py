"""What shaders read of the object they are on, beside the shape of its surface: layers of its mesh, its place in the
world, its colour, its numbers, its properties."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from .node_graph import nodes_of
from .texels import IMAGE

WORLDLY_GEOMETRY = frozenset({"Position", "Normal", "True Normal", "Tangent", "Incoming"})
"""Outputs of the Geometry node that are given in the world's own axes."""
RENDERED = ""
"""Of layers: the colours that are drawn where none are named."""


@dataclass(frozen=True)
class Reads:
    """What some shaders read. layers: names of attributes, UV maps and colours of the mesh. of_object, of_scene:
    names of properties. worldly: where it stands. generated: coordinates in its bounding box, which a radial tangent
    turns around too. info: names of the outputs of Object Info that are used."""

    layers: frozenset[str] = frozenset()
    of_object: frozenset[str] = frozenset()
    of_scene: frozenset[str] = frozenset()
    worldly: bool = False
    generated: bool = False
    info: frozenset[str] = frozenset()


def reads_of(obj: Any, materials: Iterable[Any]) -> Reads:
    """materials: of obj, None = empty slot."""
    layers: set[str] = set()
    of_object: set[str] = set()
    of_scene: set[str] = set()
    info: set[str] = set()
    worldly = generated = False
    for node in (node for material in materials if material is not None for node in nodes_of(material.node_tree)):
        used = {output.name for output in node.outputs if output.is_linked}
        kind = node.bl_idname
        if kind == "ShaderNodeNewGeometry":
            worldly |= bool(used & WORLDLY_GEOMETRY)
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
            layers.add(node.layer_name or RENDERED)
        elif kind in {"ShaderNodeUVMap", "ShaderNodeTangent", "ShaderNodeNormalMap"}:
            layers |= {node.uv_map} - {""}
            worldly |= getattr(node, "space", "") in {"WORLD", "BLENDER_WORLD"}
            generated |= getattr(node, "direction_type", "") == "RADIAL"
        elif kind.startswith("ShaderNodeTex") and kind != IMAGE:
            vector = node.inputs.get("Vector")
            generated |= vector is not None and not vector.is_linked
    names = (frozenset(layers), frozenset(of_object), frozenset(of_scene))
    return Reads(*names, worldly, generated, frozenset(info))


def owner_text(obj: Any, view_layer: Any, materials: Iterable[Any], reads: Reads) -> str:
    """What shaders find there, as text; "" where they read nothing of the object. view_layer: of the scene that obj is
    touched in; it may stand in others too."""
    return "".join(f"{part}\n" for part in _parts(obj, view_layer, materials, reads))


def _parts(obj: Any, view_layer: Any, materials: Iterable[Any], reads: Reads) -> Iterator[str]:
    if reads.worldly:
        yield repr([list(row) for row in obj.matrix_world])
    if reads.info & {"Color", "Alpha"}:
        yield repr(list(obj.color))
    if "Object Index" in reads.info:
        yield repr(obj.pass_index)
    if "Material Index" in reads.info:
        yield repr([None if material is None else material.pass_index for material in materials])
    if "Random" in reads.info:
        yield obj.name
    for name in sorted(reads.of_object):
        yield f"{name} {_property((obj, obj.data), name)!r}"
    for name in sorted(reads.of_scene):
        yield f"{name} {_property(_around(view_layer), name)!r}"
    if reads.generated:
        yield repr([list(getattr(obj.data, name, ())) for name in ("texspace_location", "texspace_size")])


def dress(actor: Any, stage_scene: Any, obj: Any, view_layer: Any, reads: Reads) -> None:
    """Give a stand-in for obj what the shaders on it read of obj and of its scene. view_layer: as for owner_text, None
    where it stands in no scene."""
    actor.color, actor.pass_index = obj.color, obj.pass_index
    for name in reads.of_object:
        _give(actor, name, _property((obj, obj.data), name))
    for name in reads.of_scene if view_layer is not None else ():
        _give(stage_scene, name, _property(_around(view_layer), name))


def _around(view_layer: Any) -> tuple[Any, ...]:
    """Where an Attribute node looks for a property of the view layer, in this order."""
    scene = view_layer.id_data
    return view_layer, scene, scene.world


def _give(block: Any, name: str, value: Any) -> None:
    """As a property of the block's own, which an Attribute node finds before any of Blender's."""
    if isinstance(value, (bool, int, float, list)):
        block[name] = value


def _property(blocks: Iterable[Any], name: str) -> Any:
    """As an Attribute node finds it: of the first block that has it, one of the artist's own, else one of Blender's."""
    for block in blocks:
        if block is None:
            continue
        if name in block:
            return _plain(block[name])
        try:
            return _plain(block.path_resolve(name))
        except ValueError:
            continue
    return None


def _plain(value: Any) -> Any:
    """Numbers, and rows of them, alike however Blender wraps them."""
    return list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
