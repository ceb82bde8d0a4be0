"""Micro-geometry in shaders: which bump, displacement and normal-map nodes shape a surface, and how high."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hnf_core.units import m_to_mm

from .aov_taps import (
    IMAGE_NODE,
    PROCEDURAL_NODES,
    ImageTap,
    Tap,
    Tapper,
    copy_input,
    find_image_sources,
    get_constant_value,
    is_texel_limited,
    tap_image,
)
from .node_graph import NodeGraph

BUMP_FACTORS = ("Distance", "Strength")


@dataclass(frozen=True)
class Amount:
    """An input of a node, for the report. value: None where it is textured. is_length: of the tap's Blender units."""

    label: str
    value: float | None
    is_length: bool

    def format(self, metres_per_unit: float) -> str:
        if self.value is None:
            return f"{self.label} textured"
        if not self.is_length:
            return f"{self.label} {self.value:g}"
        metres = self.value * metres_per_unit
        small = 0.0 < abs(metres) < 1e-6
        return f"{self.label} {metres * 1e6:.3g} µm" if small else f"{self.label} {m_to_mm(metres):.6g} mm"


@dataclass(frozen=True)
class Relief:
    """One source of height. tap: the height, VALUE, in Blender units of the world, or of the object where
    in_object_space (it then follows the object's scale). node, amounts: for the report. images: what it is made from.
    procedural: some of it has no texels. plain: it is no finer than its images' texels, see texels.is_plain."""

    tap: Tap
    in_object_space: bool
    node: str
    amounts: tuple[Amount, ...]
    images: tuple[ImageTap, ...]
    procedural: bool
    texel_limited: bool


@dataclass(frozen=True)
class Slopes:
    """A shading normal that no height is known for. tap: world-space normal (COLOR). Others: as of a Relief."""

    tap: Tap
    source: str
    images: tuple[ImageTap, ...]
    procedural: bool
    texel_limited: bool


@dataclass(frozen=True)
class MicroGeometry:
    """What one closure's Normal input, or a material's Displacement, says of the surface; heights add up."""

    reliefs: tuple[Relief, ...] = ()
    slopes: tuple[Slopes, ...] = ()


def read_normal_input(socket: Any, tapper: Tapper, notes: list[str]) -> MicroGeometry:
    """Follow a closure's Normal input: bumps chained by their Normal inputs, and what stands at the chain's end."""
    bumps, end = follow_normal_chain(tapper.graph, socket)
    reliefs = tuple(_read_bump(node, tapper) for node in bumps)
    if end is None:
        return MicroGeometry(reliefs)
    _check_normal_map(end.node, tapper.graph, notes)
    images: tuple[ImageTap, ...]
    if end.node.bl_idname == IMAGE_NODE:
        images, procedural, plain = (tap_image(end.node, tapper),), False, True
    else:
        images, procedural = find_image_sources(tapper, end.node.inputs)
        plain = is_texel_limited(tapper.graph, end.node.inputs)
    slopes = Slopes(tapper.tap_output(end, "COLOR"), _format_label(end.node, "normals"), images, procedural, plain)
    return MicroGeometry(reliefs, (slopes,))


def follow_normal_chain(graph: NodeGraph, socket: Any) -> tuple[list[Any], Any]:
    """The bumps behind a closure's Normal input, and the socket of the normal at the chain's end, None where that is
    the smooth surface's own. What is turned off (Strength 0, nothing linked to Height) does not count."""
    bumps: list[Any] = []
    source = graph.resolve(socket)
    while source.is_output and source.node.bl_idname == "ShaderNodeBump":
        if graph.resolve(source.node.inputs["Height"]).is_output and not _is_off(graph, source.node, *BUMP_FACTORS):
            bumps.append(source.node)
        source = graph.resolve(source.node.inputs["Normal"])
    if not source.is_output or source.node.mute or _is_smooth_normal(source):
        return bumps, None
    off = source.node.bl_idname == "ShaderNodeNormalMap" and _is_off(graph, source.node, "Strength")
    return bumps, None if off else source


def is_displacing(graph: NodeGraph, socket: Any) -> bool:
    """Does a Displacement node behind the Material Output's Displacement input raise anything?"""
    node = graph.source_node(socket)
    if node is None or node.bl_idname != "ShaderNodeDisplacement":
        return False
    return graph.resolve(node.inputs["Height"]).is_output and not _is_off(graph, node, "Scale")


def read_displacement(socket: Any, tapper: Tapper, notes: list[str]) -> MicroGeometry:
    """Height of a Displacement node: (Height − Midlevel) × Scale."""
    node = tapper.graph.source_node(socket)
    if node is None:
        return MicroGeometry()
    if node.bl_idname != "ShaderNodeDisplacement":
        notes.append(f"'{node.name}' displaces in all directions: only Displacement nodes are read as height.")
        return MicroGeometry()
    if not is_displacing(tapper.graph, socket):
        return MicroGeometry()
    tree = node.id_data
    raised = tree.nodes.new("ShaderNodeMath")
    raised.operation = "SUBTRACT"
    copy_input(tree, node.inputs["Height"], raised.inputs[0])
    copy_input(tree, node.inputs["Midlevel"], raised.inputs[1])
    height = tapper.multiply(tree, raised.outputs[0], node.inputs["Scale"])
    images, procedural = find_image_sources(tapper, [node.inputs["Height"]])
    relief = Relief(
        tapper.tap_output(height, "VALUE"),
        node.space == "OBJECT",
        f"displacement '{node.name}'",
        (_read_amount(node, "Scale", is_length=True),),
        images,
        procedural,
        is_texel_limited(tapper.graph, get_relief_inputs(node)),
    )
    return MicroGeometry((relief,))


def _read_bump(node: Any, tapper: Tapper) -> Relief:
    """Height × Distance × Strength of a Bump node (Cycles blends normals by Strength: its slope grows with it)."""
    sign = -1.0 if node.invert else 1.0
    factors = (node.inputs[name] for name in BUMP_FACTORS)
    height = tapper.multiply(node.id_data, sign, node.inputs["Height"], *factors)
    images, procedural = find_image_sources(tapper, [node.inputs["Height"]])
    amounts = (_read_amount(node, "Distance", is_length=True), _read_amount(node, "Strength", is_length=False))
    plain = is_texel_limited(tapper.graph, get_relief_inputs(node))
    return Relief(tapper.tap_output(height, "VALUE"), False, f"bump '{node.name}'", amounts, images, procedural, plain)


def get_relief_inputs(node: Any) -> list[Any]:
    """What a Bump or a Displacement node makes its height from."""
    factors = BUMP_FACTORS if node.bl_idname == "ShaderNodeBump" else ("Midlevel", "Scale")
    return [node.inputs[name] for name in ("Height", *factors)]


def _is_off(graph: NodeGraph, node: Any, *factors: str) -> bool:
    """Is one of these inputs set to 0, and no texture?"""
    ends = [graph.resolve(node.inputs[name]) for name in factors]
    return any(not end.is_output and get_constant_value(end, "VALUE") == 0.0 for end in ends)


def _is_smooth_normal(source: Any) -> bool:
    """The surface's own smooth normal, just passed along."""
    return source.node.bl_idname == "ShaderNodeNewGeometry" and source.name in {"Normal"}


def _check_normal_map(node: Any, graph: NodeGraph, notes: list[str]) -> None:
    if node.bl_idname != "ShaderNodeNormalMap":
        return
    for each in graph.upstream(node.inputs["Color"], PROCEDURAL_NODES | {IMAGE_NODE}):
        if each.bl_idname == IMAGE_NODE and each.image is not None and not each.image.colorspace_settings.is_data:
            space = each.image.colorspace_settings.name
            notes.append(f"normal map '{each.image.name}' is tagged {space}: set its Color Space to Non-Color.")


def _read_amount(node: Any, name: str, *, is_length: bool) -> Amount:
    socket = node.inputs[name]
    return Amount(name.lower(), None if socket.is_linked else float(socket.default_value), is_length)


def _format_label(node: Any, kind: str) -> str:
    return f"normal map '{node.name}'" if node.bl_idname == "ShaderNodeNormalMap" else f"{kind} of '{node.name}'"
