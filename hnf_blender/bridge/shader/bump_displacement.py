"""Read micro-geometry from shader nodes: the heights of Bump and Displacement nodes, and the slopes of normal maps."""

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
"""Inputs of a Bump node that multiply its Height."""


@dataclass(frozen=True)
class Amount:
    """A numeric input of a Bump, Displacement or Normal Map node, for the report.

    `value` is None if the input is textured; `is_length` is true for a length in Blender units, as opposed to a factor.
    """

    label: str
    value: float | None
    is_length: bool

    def format(self, metres_per_unit: float) -> str:
        """Format the amount with its unit."""
        if self.value is None:
            return f"{self.label} textured"
        if not self.is_length:
            return f"{self.label} {self.value:g}"
        metres = self.value * metres_per_unit
        small = 0.0 < abs(metres) < 1e-6
        return f"{self.label} {metres * 1e6:.3g} µm" if small else f"{self.label} {m_to_mm(metres):.6g} mm"


@dataclass(frozen=True)
class Relief:
    """One source of surface height: a Bump or Displacement node.

    Attributes
    ----------
    tap : Tap
        Height (VALUE), in Blender units of the world or, with `in_object_space`, of the object, whose scale it follows.
    in_object_space : bool
    node : str
        Description of the node, for the report.
    amounts : tuple of Amount
        Inputs of the node, for the report.
    images : tuple of ImageTap
        Images that the height is made from.
    procedural : bool
        True if it depends on procedural textures too.
    texel_limited : bool
        True if it is not finer than its images' texels, see `is_texel_limited`.
    """

    tap: Tap
    in_object_space: bool
    node: str
    amounts: tuple[Amount, ...]
    images: tuple[ImageTap, ...]
    procedural: bool
    texel_limited: bool


@dataclass(frozen=True)
class Slopes:
    """A shading normal whose height is unknown, as from a normal map.

    `tap` is the AOV pass with the world-space normal (COLOR), `source` a description for the report. `images`,
    `procedural` and `texel_limited` tell, as in Relief, which textures it is made from.
    """

    tap: Tap
    source: str
    images: tuple[ImageTap, ...]
    procedural: bool
    texel_limited: bool


@dataclass(frozen=True)
class MicroGeometry:
    """Micro-geometry of one closure's (BSDF's) Normal input, or of a material's Displacement; heights add up."""

    reliefs: tuple[Relief, ...] = ()
    slopes: tuple[Slopes, ...] = ()


def read_normal_input(socket: Any, tapper: Tapper, notes: list[str]) -> MicroGeometry:
    """Read the micro-geometry of a BSDF's Normal input: a chain of Bump nodes, and the normal at its end.

    Remarks for the user are appended to `notes`.
    """
    bumps, end = follow_normal_chain(tapper.graph, socket)
    reliefs = tuple(_read_bump(node, tapper) for node in bumps)
    if end is None:
        return MicroGeometry(reliefs)
    _check_normal_map(end.node, tapper.graph, notes)
    images: tuple[ImageTap, ...]
    if end.node.bl_idname == IMAGE_NODE:
        images, procedural, texel_limited = (tap_image(end.node, tapper),), False, True
    else:
        images, procedural = find_image_sources(tapper, end.node.inputs)
        texel_limited = is_texel_limited(tapper.graph, end.node.inputs)
    slopes = Slopes(
        tapper.tap_output(end, "COLOR"), _format_label(end.node, "normals"), images, procedural, texel_limited
    )
    return MicroGeometry(reliefs, (slopes,))


def follow_normal_chain(graph: NodeGraph, socket: Any) -> tuple[list[Any], Any]:
    """Return the Bump nodes chained behind a BSDF's Normal input, and the socket of the normal at the chain's end.

    The socket is None for the smooth surface's own normal. Nodes without effect (Strength 0, no Height) are left out.
    """
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
    """Return True if a Displacement node with an effect is behind the Displacement input `socket`."""
    node = graph.source_node(socket)
    if node is None or node.bl_idname != "ShaderNodeDisplacement":
        return False
    return graph.resolve(node.inputs["Height"]).is_output and not _is_off(graph, node, "Scale")


def read_displacement(socket: Any, tapper: Tapper, notes: list[str]) -> MicroGeometry:
    """Read the height of a Displacement node: (Height − Midlevel) × Scale.

    `socket` is the material's Displacement input. Remarks for the user are appended to `notes`.
    """
    node = tapper.graph.source_node(socket)
    if node is None:
        return MicroGeometry()
    if node.bl_idname != "ShaderNodeDisplacement":
        notes.append(f"'{node.name}' displaces in all directions: only Displacement nodes are read as height.")
        return MicroGeometry()
    if not is_displacing(tapper.graph, socket):
        return MicroGeometry()
    tree = node.id_data
    subtract = tree.nodes.new("ShaderNodeMath")
    subtract.operation = "SUBTRACT"
    copy_input(tree, node.inputs["Height"], subtract.inputs[0])
    copy_input(tree, node.inputs["Midlevel"], subtract.inputs[1])
    height = tapper.multiply(tree, subtract.outputs[0], node.inputs["Scale"])
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
    """Read the height of a Bump node: Height × Distance × Strength.

    Cycles blends normals by Strength, so the slope is proportional to it.
    """
    sign = -1.0 if node.invert else 1.0
    factors = (node.inputs[name] for name in BUMP_FACTORS)
    height = tapper.multiply(node.id_data, sign, node.inputs["Height"], *factors)
    images, procedural = find_image_sources(tapper, [node.inputs["Height"]])
    amounts = (_read_amount(node, "Distance", is_length=True), _read_amount(node, "Strength", is_length=False))
    texel_limited = is_texel_limited(tapper.graph, get_relief_inputs(node))
    return Relief(
        tapper.tap_output(height, "VALUE"), False, f"bump '{node.name}'", amounts, images, procedural, texel_limited
    )


def get_relief_inputs(node: Any) -> list[Any]:
    """Return the input sockets that determine the height of a Bump or Displacement node."""
    factors = BUMP_FACTORS if node.bl_idname == "ShaderNodeBump" else ("Midlevel", "Scale")
    return [node.inputs[name] for name in ("Height", *factors)]


def _is_off(graph: NodeGraph, node: Any, *factors: str) -> bool:
    """Return True if one of the node's inputs named in `factors` is constant 0, so that the node has no effect."""
    sources = [graph.resolve(node.inputs[name]) for name in factors]
    return any(not source.is_output and get_constant_value(source, "VALUE") == 0.0 for source in sources)


def _is_smooth_normal(source: Any) -> bool:
    """Return True if a socket gives the surface's own smooth normal, as the Geometry node does."""
    return source.node.bl_idname == "ShaderNodeNewGeometry" and source.name in {"Normal"}


def _check_normal_map(node: Any, graph: NodeGraph, notes: list[str]) -> None:
    """Append a note for the user for every image of a normal map that is read as a color instead of as data."""
    if node.bl_idname != "ShaderNodeNormalMap":
        return
    for image_node in graph.upstream(node.inputs["Color"], PROCEDURAL_NODES | {IMAGE_NODE}):
        if (
            image_node.bl_idname == IMAGE_NODE
            and image_node.image is not None
            and not image_node.image.colorspace_settings.is_data
        ):
            space = image_node.image.colorspace_settings.name
            notes.append(f"normal map '{image_node.image.name}' is tagged {space}: set its Color Space to Non-Color.")


def _read_amount(node: Any, name: str, *, is_length: bool) -> Amount:
    socket = node.inputs[name]
    return Amount(name.lower(), None if socket.is_linked else float(socket.default_value), is_length)


def _format_label(node: Any, kind: str) -> str:
    return f"normal map '{node.name}'" if node.bl_idname == "ShaderNodeNormalMap" else f"{kind} of '{node.name}'"
