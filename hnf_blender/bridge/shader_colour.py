"""What a shader has to show where it has no relief: the images, patterns and painted vertices behind its colour."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from .. import compat
from .appearance import BSDFS, GLOWING, Closures
from .node_graph import NodeGraph
from .shader_height import displaces, normal_chain, relief_inputs
from .taps import Tapper
from .texels import IMAGE, PROCEDURAL, ImageTap, is_plain, made_from

PAINTED = frozenset({"ShaderNodeVertexColor", "ShaderNodeAttribute"})
PLACED = PROCEDURAL | PAINTED | {IMAGE, "ShaderNodeTexCoord", "ShaderNodeUVMap", "ShaderNodeNewGeometry"}
"""Nodes whose value differs from place to place. Constants, however they are mixed, do not."""


class Shows(Enum):
    """What a material can tell of the surface's relief: RELIEF: it has its own. PICTURE: none, but a colour that may
    vary from place to place. NOTHING: neither."""

    RELIEF = "relief"
    PICTURE = "picture"
    NOTHING = "nothing"


@dataclass(frozen=True)
class ColourSources:
    """What a colour that may vary is made from. images: textures. procedural: also of what has no texels. painted: also
    of colours on the mesh's own points. source: in words, for the report."""

    images: tuple[ImageTap, ...]
    procedural: bool
    painted: bool
    source: str


def shows(material: Any) -> Shows:
    """Without a copy and without a render. A node group that stands in a material twice is read once."""
    if material is None or not compat.use_nodes(material):
        return Shows.NOTHING
    graph = NodeGraph(material, own_groups=False)
    if has_relief(graph):
        return Shows.RELIEF
    return Shows.PICTURE if _kinds(graph, colour_sockets(graph)) & PLACED else Shows.NOTHING


def reads_plainly(material: Any) -> bool:
    """Is its relief that of images, read so that a first look can tell how fine they are (see fewest_pixels)? Without a
    copy and without a render, as shows()."""
    if material is None or not compat.use_nodes(material):
        return False
    graph = NodeGraph(material, own_groups=False)
    if graph.output is None or not has_relief(graph):
        return False
    closures, factors = _surface(graph)
    chains = [normal_chain(graph, node.inputs["Normal"]) for node in closures if "Normal" in node.inputs]
    inputs = [relief_inputs(bump) for bumps, _ in chains for bump in bumps]
    inputs += [list(end.node.inputs) for _, end in chains if end is not None and end.node.bl_idname != IMAGE]
    if displaces(graph, graph.output.inputs["Displacement"]):
        inputs.append(relief_inputs(graph.source_node(graph.output.inputs["Displacement"])))
    even = not any(graph.resolve(factor).is_output for factor in factors)
    return even and all(is_plain(graph, each) for each in inputs)


def has_relief(graph: NodeGraph) -> bool:
    """Does a closure of the surface, or the displacement, shape the surface?"""
    if graph.output is None:
        return False
    closures, _ = _surface(graph)
    chains = [normal_chain(graph, node.inputs["Normal"]) for node in closures if "Normal" in node.inputs]
    shaped = any(bumps or end is not None for bumps, end in chains)
    return shaped or displaces(graph, graph.output.inputs["Displacement"])


def colour_sources(tapper: Tapper) -> ColourSources | None:
    """Of a material copy; None where it has a relief of its own, or its colour is the same everywhere."""
    sockets = colour_sockets(tapper.graph)
    kinds = _kinds(tapper.graph, sockets)
    if has_relief(tapper.graph) or not kinds & PLACED:
        return None
    images, procedural = made_from(tapper, sockets)
    painted, pattern = bool(kinds & PAINTED), bool(kinds & PROCEDURAL)
    said = [f"image '{name}'" for name in dict.fromkeys(image.name for image in images)]
    said += ["a pattern"] if pattern else []
    said += ["painted vertices"] if painted else []
    # A bare coordinate is a pattern without texels; what is painted on a mesh is as fine as its points.
    return ColourSources(images, procedural and (pattern or not painted), painted, ", ".join(said) or "a pattern")


def colour_sockets(graph: NodeGraph) -> list[Any]:
    """Colour inputs of the surface's closures, and the factors that mix them."""
    closures, factors = _surface(graph)
    names = [({**BSDFS, **GLOWING})[node.bl_idname][0]["base_color"][0] for node in closures]
    return [node.inputs[name] for node, name in zip(closures, names, strict=True) if name in node.inputs] + factors


def _surface(graph: NodeGraph) -> tuple[list[Any], list[Any]]:
    """BSDF nodes of the surface (glowing ones where there is none), and the factor sockets of Mix Shaders that have one
    on either side."""
    if graph.output is None:
        return [], []
    socket = graph.output.inputs["Surface"]
    found = _behind(graph, socket, BSDFS)
    return found if found[0] else _behind(graph, socket, GLOWING)


def _behind(graph: NodeGraph, socket: Any, kinds: Closures) -> tuple[list[Any], list[Any]]:
    node = graph.source_node(socket)
    if node is None:
        return [], []
    if node.bl_idname not in {"ShaderNodeMixShader", "ShaderNodeAddShader"}:
        return ([node] if node.bl_idname in kinds else []), []
    (first, one), (second, other) = (_behind(graph, side, kinds) for side in node.inputs if side.type == "SHADER")
    mixes = first and second and node.bl_idname == "ShaderNodeMixShader"
    return first + second, one + other + ([node.inputs[0]] if mixes else [])


def _kinds(graph: NodeGraph, sockets: Iterable[Any]) -> set[str]:
    """Types of all nodes behind the sockets; what stands behind a texture is not looked at."""
    return {node.bl_idname for socket in sockets for node in graph.upstream(socket, PROCEDURAL | {IMAGE})}
