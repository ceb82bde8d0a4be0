"""Read micro-geometry from shader nodes: the heights of Bump and Displacement nodes, and the slopes of normal maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from .images import GREY_DIFFERENCE
from .node_graph import NodeGraph

Float = NDArray[np.float64]

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
    `procedural` and `texel_limited` tell, as in Relief, which textures it is made from, `strength` multiplies the
    slopes. `colour` is the AOV pass with the color of a Normal Map node in tangent space.
    """

    tap: Tap
    source: str
    images: tuple[ImageTap, ...]
    procedural: bool
    texel_limited: bool
    strength: float = 1.0
    colour: Tap | None = None


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
    colour = _rebuild_blue(end.node, tapper) if end.node.bl_idname == "ShaderNodeNormalMap" else None
    slopes = Slopes(
        tapper.tap_output(end, "COLOR"),
        _format_label(end.node, "normals"),
        images,
        procedural,
        texel_limited,
        _get_strength(end.node, tapper.graph),
        colour,
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
    images, procedural = find_image_sources(tapper, [node.inputs["Height"]], with_values=True)
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
    images, procedural = find_image_sources(tapper, [node.inputs["Height"]], with_values=True)
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


LEAST_BLUE, LARGEST_NORMAL_SQUARE = 0.51, 1.1
"""Blue of a normal map below which a normal would lie in the surface, and squared length [1] above which it is none.

Interpolation makes normals shorter, never longer."""


def _rebuild_blue(node: Any, tapper: Tapper) -> Tap | None:
    """Give the pixels of a Normal Map node whose blue cannot be right the blue of a unit normal; tap its own color.

    Maps of two channels have x and y alone: z = √(1 − x² − y²). None for a map in other axes or without a picture.
    """
    socket, tree = node.inputs["Color"], node.id_data
    if node.space != "TANGENT" or not tapper.graph.resolve(socket).is_output or not socket.links:
        return None
    source = socket.links[0].from_socket

    def compute(operation: str, *values: Any) -> Any:
        math = tree.nodes.new("ShaderNodeMath")
        math.operation = operation
        for value, target in zip(values, math.inputs, strict=False):
            copy_input(tree, value, target)
        return math.outputs[0]

    parts, whole = tree.nodes.new("ShaderNodeSeparateXYZ"), tree.nodes.new("ShaderNodeCombineXYZ")
    tree.links.new(source, parts.inputs[0])
    red, green, blue = parts.outputs
    x, y, z = (compute("MULTIPLY_ADD", part, 2.0, -1.0) for part in (red, green, blue))
    plane_square = compute("MULTIPLY_ADD", x, x, compute("MULTIPLY", y, y))
    height = compute("SQRT", compute("MAXIMUM", compute("SUBTRACT", 1.0, plane_square), 1e-3))
    is_low = compute("LESS_THAN", blue, LEAST_BLUE)
    is_long = compute("GREATER_THAN", compute("MULTIPLY_ADD", z, z, plane_square), LARGEST_NORMAL_SQUARE)
    missing = compute("SUBTRACT", compute("MULTIPLY_ADD", height, 0.5, 0.5), blue)
    rebuilt = compute("MULTIPLY_ADD", compute("MAXIMUM", is_low, is_long), missing, blue)
    for part, target in zip((red, green, rebuilt), whole.inputs, strict=True):
        tree.links.new(part, target)
    tree.links.new(whole.outputs[0], socket)
    return tapper.tap_output(source, "COLOR")


LEAST_TILT_SQUARE = 1e-3
"""Mean square of x and y of normals [1] below which a map is flat, whatever its blue."""


def judge_normal_colour(colour: Float, mask: NDArray[np.bool_]) -> tuple[str, Float]:
    """Tell what a normal map holds from its color (H, W, 3) on a patch, and correct its slopes.

    Returns
    -------
    kind : str
        "grey" for a picture without normals, "two channels" if blue is constant and z was rebuilt, else "".
    factor : ndarray, shape (H, W)
        Factor on the slopes that the Normal Map node gives.
    """
    ones, inside = np.ones(mask.shape), colour[mask]
    spread = float(np.ptp(inside[:, :2])) if len(inside) else 0.0
    if spread <= GREY_DIFFERENCE:
        return "", ones
    if np.ptp(inside, axis=1).max() <= GREY_DIFFERENCE:
        return "grey", 0.0 * ones
    x, y, z = np.moveaxis(2.0 * colour - 1.0, -1, 0)
    plane_square = x**2 + y**2
    blue = inside[:, 2]
    if np.ptp(blue) > GREY_DIFFERENCE or np.mean(plane_square[mask]) < LEAST_TILT_SQUARE:
        return "", ones
    height = np.sqrt(np.maximum(1.0 - plane_square, 1e-3))
    if abs(float(np.median(height[mask] - z[mask]))) < 0.05:
        return "", ones  # as good as a unit normal's
    is_rebuilt = (colour[..., 2] < LEAST_BLUE) | (plane_square + z**2 > LARGEST_NORMAL_SQUARE)
    return "two channels", np.where(is_rebuilt, 1.0, z / height)


def _get_strength(node: Any, graph: NodeGraph) -> float:
    """Return the constant Strength of a Normal Map node; 1 for a textured one and for other nodes."""
    socket = node.inputs.get("Strength") if node.bl_idname == "ShaderNodeNormalMap" else None
    source = None if socket is None else graph.resolve(socket)
    return 1.0 if source is None or source.is_output else float(get_constant_value(source, "VALUE"))


def _format_label(node: Any, kind: str) -> str:
    return f"normal map '{node.name}'" if node.bl_idname == "ShaderNodeNormalMap" else f"{kind} of '{node.name}'"
