"""What a shader has to show where it has no relief: the images, patterns and painted vertices behind its colour."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from .. import compat
from .appearance import BSDFS, EMISSIVE, ClosureTable
from .node_graph import NodeGraph
from .shader_height import follow_normal_chain, get_relief_inputs, is_displacing
from .taps import Tapper
from .texels import IMAGE_NODE, PROCEDURAL_NODES, ImageTap, find_image_sources, is_texel_limited

VERTEX_COLOUR_NODES = frozenset({"ShaderNodeVertexColor", "ShaderNodeAttribute"})
VARYING_NODES = (
    PROCEDURAL_NODES
    | VERTEX_COLOUR_NODES
    | {IMAGE_NODE, "ShaderNodeTexCoord", "ShaderNodeUVMap", "ShaderNodeNewGeometry"}
)
"""Nodes whose value differs from place to place. Constants, however they are mixed, do not."""


class ReliefSource(Enum):
    """What a material can tell of the surface's relief: RELIEF: it has its own. PICTURE: none, but a colour that may
    vary from place to place. NOTHING: neither."""

    RELIEF = "relief"
    VARYING_COLOUR = "picture"
    NONE = "nothing"


@dataclass(frozen=True)
class ColourSources:
    """What a colour that may vary is made from. images: textures. procedural: also of what has no texels. painted: also
    of colours on the mesh's own points. source: in words, for the report."""

    images: tuple[ImageTap, ...]
    procedural: bool
    painted: bool
    source: str


def find_relief_source(material: Any) -> ReliefSource:
    """Without a copy and without a render. A node group that stands in a material twice is read once."""
    if material is None or not compat.use_nodes(material):
        return ReliefSource.NONE
    graph = NodeGraph(material, copy_groups=False)
    if has_relief(graph):
        return ReliefSource.RELIEF
    return (
        ReliefSource.VARYING_COLOUR
        if _collect_node_types(graph, list_colour_sockets(graph)) & VARYING_NODES
        else ReliefSource.NONE
    )


def is_direct_image(material: Any) -> bool:
    """Is its relief that of images, read so that a first look can tell how fine they are (see fewest_pixels)? Without a
    copy and without a render, as shows()."""
    if material is None or not compat.use_nodes(material):
        return False
    graph = NodeGraph(material, copy_groups=False)
    if graph.output is None or not has_relief(graph):
        return False
    closures, factors = _find_surface_closures(graph)
    chains = [follow_normal_chain(graph, node.inputs["Normal"]) for node in closures if "Normal" in node.inputs]
    inputs = [get_relief_inputs(bump) for bumps, _ in chains for bump in bumps]
    inputs += [list(end.node.inputs) for _, end in chains if end is not None and end.node.bl_idname != IMAGE_NODE]
    if is_displacing(graph, graph.output.inputs["Displacement"]):
        inputs.append(get_relief_inputs(graph.source_node(graph.output.inputs["Displacement"])))
    even = not any(graph.resolve(factor).is_output for factor in factors)
    return even and all(is_texel_limited(graph, each) for each in inputs)


def has_relief(graph: NodeGraph) -> bool:
    """Does a closure of the surface, or the displacement, shape the surface?"""
    if graph.output is None:
        return False
    closures, _ = _find_surface_closures(graph)
    chains = [follow_normal_chain(graph, node.inputs["Normal"]) for node in closures if "Normal" in node.inputs]
    shaped = any(bumps or end is not None for bumps, end in chains)
    return shaped or is_displacing(graph, graph.output.inputs["Displacement"])


def find_colour_sources(tapper: Tapper) -> ColourSources | None:
    """Of a material copy; None where it has a relief of its own, or its colour is the same everywhere."""
    sockets = list_colour_sockets(tapper.graph)
    kinds = _collect_node_types(tapper.graph, sockets)
    if has_relief(tapper.graph) or not kinds & VARYING_NODES:
        return None
    images, procedural = find_image_sources(tapper, sockets)
    painted, pattern = bool(kinds & VERTEX_COLOUR_NODES), bool(kinds & PROCEDURAL_NODES)
    said = [f"image '{name}'" for name in dict.fromkeys(image.name for image in images)]
    said += ["a pattern"] if pattern else []
    said += ["painted vertices"] if painted else []
    # A bare coordinate is a pattern without texels; what is painted on a mesh is as fine as its points.
    return ColourSources(images, procedural and (pattern or not painted), painted, ", ".join(said) or "a pattern")


def list_colour_sockets(graph: NodeGraph) -> list[Any]:
    """Colour inputs of the surface's closures, and the factors that mix them."""
    closures, factors = _find_surface_closures(graph)
    names = [({**BSDFS, **EMISSIVE})[node.bl_idname][0]["base_color"][0] for node in closures]
    return [node.inputs[name] for node, name in zip(closures, names, strict=True) if name in node.inputs] + factors


def _find_surface_closures(graph: NodeGraph) -> tuple[list[Any], list[Any]]:
    """BSDF nodes of the surface (glowing ones where there is none), and the factor sockets of Mix Shaders that have one
    on either side."""
    if graph.output is None:
        return [], []
    socket = graph.output.inputs["Surface"]
    found = _collect_closures(graph, socket, BSDFS)
    return found if found[0] else _collect_closures(graph, socket, EMISSIVE)


def _collect_closures(graph: NodeGraph, socket: Any, table: ClosureTable) -> tuple[list[Any], list[Any]]:
    node = graph.source_node(socket)
    if node is None:
        return [], []
    if node.bl_idname not in {"ShaderNodeMixShader", "ShaderNodeAddShader"}:
        return ([node] if node.bl_idname in table else []), []
    (first, one), (second, other) = (
        _collect_closures(graph, side, table) for side in node.inputs if side.type == "SHADER"
    )
    mixes = first and second and node.bl_idname == "ShaderNodeMixShader"
    return first + second, one + other + ([node.inputs[0]] if mixes else [])


def _collect_node_types(graph: NodeGraph, sockets: Iterable[Any]) -> set[str]:
    """Types of all nodes behind the sockets; what stands behind a texture is not looked at."""
    return {node.bl_idname for socket in sockets for node in graph.upstream(socket, PROCEDURAL_NODES | {IMAGE_NODE})}
