"""Micro-geometry in shaders: which bump, displacement and normal-map nodes shape a surface, and how high."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .node_graph import NodeGraph
from .taps import Tap, Tapper, copy_input

PROCEDURAL = frozenset({
    "ShaderNodeTexNoise", "ShaderNodeTexVoronoi", "ShaderNodeTexWave", "ShaderNodeTexMagic", "ShaderNodeTexBrick",
    "ShaderNodeTexChecker", "ShaderNodeTexGradient", "ShaderNodeTexWhiteNoise", "ShaderNodeTexGabor",
    "ShaderNodeTexMusgrave", "ShaderNodeTexPointDensity", "ShaderNodeTexIES",
})  # fmt: skip
IMAGE = "ShaderNodeTexImage"
COORDINATES = frozenset({"ShaderNodeUVMap", "ShaderNodeTexCoord", "ShaderNodeNewGeometry", "ShaderNodeAttribute"})


@dataclass(frozen=True)
class ImageTap:
    """An image that shapes the surface. vector: tap of its texture coordinates. texels: for one unit of each
    coordinate: (x, y), or (x, y, z) where the image is projected from several sides."""

    name: str
    vector: Tap
    texels: tuple[float, ...]


@dataclass(frozen=True)
class Relief:
    """One source of height. tap: the height, VALUE, in Blender units of the world, or of the object where
    in_object_space (it then follows the object's scale). source: for the report. images: what it is made from.
    procedural: some of it has no texels."""

    tap: Tap
    in_object_space: bool
    source: str
    images: tuple[ImageTap, ...]
    procedural: bool


@dataclass(frozen=True)
class Slopes:
    """A shading normal that no height is known for. tap: world-space normal (COLOR)."""

    tap: Tap
    source: str
    images: tuple[ImageTap, ...]
    procedural: bool


@dataclass(frozen=True)
class MicroGeometry:
    """What one closure's Normal input, or a material's Displacement, says of the surface; heights add up."""

    reliefs: tuple[Relief, ...] = ()
    slopes: tuple[Slopes, ...] = ()


def from_normal_input(socket: Any, tapper: Tapper, notes: list[str]) -> MicroGeometry:
    """Follow a closure's Normal input: bumps chained by their Normal inputs, and what stands at the chain's end."""
    graph = tapper.graph
    reliefs: list[Relief] = []
    source = graph.resolve(socket)
    while source.is_output and source.node.bl_idname == "ShaderNodeBump":
        relief = _bump(source.node, tapper, notes)
        if relief is not None:
            reliefs.append(relief)
        source = graph.resolve(source.node.inputs["Normal"])
    if not source.is_output or source.node.mute or _is_plain_normal(source):
        return MicroGeometry(tuple(reliefs))
    _check_normal_map(source.node, graph, notes)
    images, procedural = _made_from(tapper, source.node)
    slopes = Slopes(tapper.output(source, "COLOR"), _label(source.node, "normals"), images, procedural)
    return MicroGeometry(tuple(reliefs), (slopes,))


def from_displacement(socket: Any, tapper: Tapper, notes: list[str]) -> MicroGeometry:
    """Height of a Displacement node: (Height − Midlevel) × Scale."""
    node = tapper.graph.source_node(socket)
    if node is None:
        return MicroGeometry()
    if node.bl_idname != "ShaderNodeDisplacement":
        notes.append(f"'{node.name}' displaces in all directions: only Displacement nodes are read as height.")
        return MicroGeometry()
    if not tapper.graph.resolve(node.inputs["Height"]).is_output:
        return MicroGeometry()
    tree = node.id_data
    raised = tree.nodes.new("ShaderNodeMath")
    raised.operation = "SUBTRACT"
    copy_input(tree, node.inputs["Height"], raised.inputs[0])
    copy_input(tree, node.inputs["Midlevel"], raised.inputs[1])
    height = tapper.product(tree, raised.outputs[0], node.inputs["Scale"])
    images, procedural = _made_from(tapper, node, "Height")
    source = f"displacement '{node.name}', {_amount(node, 'Scale')}"
    in_object_space = node.space == "OBJECT"
    return MicroGeometry((Relief(tapper.output(height, "VALUE"), in_object_space, source, images, procedural),))


def _bump(node: Any, tapper: Tapper, notes: list[str]) -> Relief | None:
    """Height × Distance × Strength of a Bump node (Cycles blends normals by Strength: its slope grows with it)."""
    if not tapper.graph.resolve(node.inputs["Height"]).is_output:
        return None
    sign = -1.0 if node.invert else 1.0
    height = tapper.product(node.id_data, sign, node.inputs["Height"], node.inputs["Distance"], node.inputs["Strength"])
    images, procedural = _made_from(tapper, node, "Height")
    source = f"bump '{node.name}', {_amount(node, 'Distance')}, {_amount(node, 'Strength')}"
    return Relief(tapper.output(height, "VALUE"), False, source, images, procedural)


def _made_from(tapper: Tapper, node: Any, *inputs: str) -> tuple[tuple[ImageTap, ...], bool]:
    """The images that a node's inputs are made from, and whether procedural textures are among their sources.

    What only moves or bends an image's coordinates adds no detail of its own.
    """
    stop = PROCEDURAL | {IMAGE}
    sockets = [node.inputs[name] for name in inputs] if inputs else list(node.inputs)
    if node.bl_idname == IMAGE:
        return (_image_tap(node, tapper),), False
    found = [upstream for socket in sockets for upstream in tapper.graph.upstream(socket, stop)]
    images = tuple(_image_tap(each, tapper) for each in found if each.bl_idname == IMAGE and each.image is not None)
    kinds = {each.bl_idname for each in found}
    return images, bool(kinds & PROCEDURAL) or (not images and bool(kinds & COORDINATES))


def _image_tap(node: Any, tapper: Tapper) -> ImageTap:
    tree, vector = node.id_data, node.inputs["Vector"]
    if tapper.graph.resolve(vector).is_output:
        tap = tapper.output(vector.links[0].from_socket, "COLOR")
    else:
        active = tree.nodes.new("ShaderNodeUVMap")
        tree.links.new(active.outputs["UV"], vector)
        tap = tapper.output(active.outputs["UV"], "COLOR")
    scale = node.texture_mapping.scale
    width, height = node.image.size
    flat = (width * scale[0], height * scale[1])
    # Box, sphere and tube projections look along all three axes.
    return ImageTap(node.image.name, tap, flat if node.projection == "FLAT" else (*flat, width * scale[2]))


def _is_plain_normal(source: Any) -> bool:
    """The surface's own smooth normal, just passed along."""
    return source.node.bl_idname == "ShaderNodeNewGeometry" and source.name in {"Normal"}


def _check_normal_map(node: Any, graph: NodeGraph, notes: list[str]) -> None:
    if node.bl_idname != "ShaderNodeNormalMap":
        return
    for each in graph.upstream(node.inputs["Color"], PROCEDURAL | {IMAGE}):
        if each.bl_idname == IMAGE and each.image is not None and not each.image.colorspace_settings.is_data:
            space = each.image.colorspace_settings.name
            notes.append(f"normal map '{each.image.name}' is tagged {space}: set its Color Space to Non-Color.")


def _amount(node: Any, name: str) -> str:
    socket = node.inputs[name]
    return f"{name.lower()} textured" if socket.is_linked else f"{name.lower()} {socket.default_value:g}"


def _label(node: Any, kind: str) -> str:
    return f"normal map '{node.name}'" if node.bl_idname == "ShaderNodeNormalMap" else f"{kind} of '{node.name}'"
