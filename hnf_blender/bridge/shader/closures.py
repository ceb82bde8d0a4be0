"""Read a material's shader as a tree of closures (BSDFs): shading values, micro-geometry, and mix factors.

`read_shader` adds AOV outputs to a material copy for rendering. `read_stated_appearance`, `find_relief_source` and
`is_direct_image` use only the nodes, without a render. `find_colour_sources` gives the images, patterns and vertex
colors behind a color, for materials without a relief.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.library import Appearance

from ... import compat
from ..scene.temp_scene import TemporaryScene
from .aov_taps import (
    IMAGE_NODE,
    PROCEDURAL_NODES,
    Constant,
    ImageTap,
    Passes,
    Quantity,
    Tapper,
    find_image_sources,
    get_constant_value,
    is_texel_limited,
)
from .bump_displacement import (
    BUMP_FACTORS,
    MicroGeometry,
    follow_normal_chain,
    get_relief_inputs,
    is_displacing,
    read_displacement,
    read_normal_input,
)
from .node_graph import NodeGraph

Float = NDArray[np.float64]
SHADING = ("base_color", "roughness", "metallic", "sheen", "transmission")
"""Names of the shading values of an Appearance."""


@dataclass(frozen=True)
class Closure:
    """One BSDF of a material: its shading values by name (see SHADING), and its micro-geometry."""

    shading: Mapping[str, Quantity] = field(default_factory=dict)
    micro: MicroGeometry = field(default_factory=MicroGeometry)


@dataclass(frozen=True)
class Blend:
    """Mix of two shaders: (1 − factor) · first + factor · second."""

    factor: Quantity
    first: Layers
    second: Layers


Layers = Closure | Blend


@dataclass(frozen=True)
class ShaderReading:
    """Shading of a material as its nodes define it, as AOV passes (taps) and constants.

    `layers` is its surface, a tree of mixed BSDFs, None without nodes; `displacement` is added to all of them; `notes`
    are remarks for the user.
    """

    layers: Layers | None
    displacement: MicroGeometry
    notes: tuple[str, ...] = ()


def read_shader(tapper: Tapper) -> ShaderReading:
    """Add AOV outputs for the shading values and the micro-geometry to a material copy; return the reading."""
    output = tapper.graph.output
    if output is None:
        return ShaderReading(None, MicroGeometry(), ())
    notes: list[str] = []
    surface = tapper.graph.resolve(output.inputs["Surface"])
    layers = _read_layers(surface, tapper, notes, BSDFS) or _read_layers(surface, tapper, notes, EMISSIVE)
    displacement = read_displacement(output.inputs["Displacement"], tapper, notes)
    return ShaderReading(layers, displacement, tuple(dict.fromkeys(notes)))


def read_viewport_shading(material: Any) -> Closure:
    """Return a material's viewport color, roughness and metallic as a closure (BSDF), for materials without nodes."""
    colour = tuple(float(part) for part in material.diffuse_color)[:3]
    return Closure({
        "base_color": Constant((colour[0], colour[1], colour[2])),
        "roughness": Constant(float(material.roughness)),
        "metallic": Constant(float(material.metallic)),
    })  # fmt: skip


def mix_closures(layers: Layers, passes: Passes, value: Callable[[Closure], Float | None]) -> Float | None:
    """Evaluate `value` for every closure (BSDF) and mix the results by the mix factors, pixel by pixel.

    Where `value` is None for one side of a mix, the other side counts alone; the result is None if it is None for all.
    """
    if isinstance(layers, Closure):
        return value(layers)
    first, second = mix_closures(layers.first, passes, value), mix_closures(layers.second, passes, value)
    if first is None or second is None:
        return second if first is None else first
    factor = np.clip(layers.factor.read(passes), 0.0, 1.0)
    if factor.ndim == 2 and max(first.ndim, second.ndim) % 2:  # colours: (3,) or (H, W, 3)
        factor = factor[..., None]
    return np.asarray((1.0 - factor) * first + factor * second)


def list_closures(layers: Layers | None) -> list[Closure]:
    """Return all closures (BSDFs) of a surface, however they are mixed."""
    if layers is None:
        return []
    if isinstance(layers, Closure):
        return [layers]
    return list_closures(layers.first) + list_closures(layers.second)


def list_mix_factors(layers: Layers | None) -> list[Quantity]:
    """Return the mix factors of a surface's Mix Shader nodes."""
    if layers is None or isinstance(layers, Closure):
        return []
    return [layers.factor, *list_mix_factors(layers.first), *list_mix_factors(layers.second)]


def average_appearance(layers: Layers | None, passes: Passes, mask: NDArray[np.bool_]) -> Appearance:
    """Return the shading values averaged over the pixels of a mask (H, W)."""
    if layers is None or not mask.any():
        return Appearance()
    values: dict[str, Any] = {}
    for name in SHADING:
        image = mix_closures(layers, passes, partial(read_shading_value, name, passes))
        if image is None:
            continue
        if image.shape[:2] == mask.shape and image.ndim >= 2:
            image = image[mask].mean(axis=0)
        clipped = np.clip(image, 0.0, 1.0)
        values[name] = tuple(float(part) for part in clipped) if name == "base_color" else float(clipped)
    return Appearance(**values)


def read_shading_value(name: str, passes: Passes, closure: Closure) -> Float | None:
    """Return a BSDF's shading value of a name (see SHADING) at every pixel, or None if it has none."""
    quantity = closure.shading.get(name)
    return None if quantity is None else quantity.read(passes)


_PRINCIPLED_INPUTS = {
    "base_color": ("Base Color", "COLOR"), "roughness": ("Roughness", "VALUE"), "metallic": ("Metallic", "VALUE"),
    "sheen": ("Sheen Weight", "VALUE"), "transmission": ("Transmission Weight", "VALUE"),
}  # fmt: skip
_COLOUR_INPUT = {"base_color": ("Color", "COLOR")}
_ROUGHNESS_INPUTS = {**_COLOUR_INPUT, "roughness": ("Roughness", "VALUE")}
ClosureTable = Mapping[str, tuple[Mapping[str, tuple[str, str]], Mapping[str, float]]]
BSDFS: ClosureTable = {
    "ShaderNodeBsdfPrincipled": (_PRINCIPLED_INPUTS, {}),
    "ShaderNodeBsdfDiffuse": (_COLOUR_INPUT, {"roughness": 1.0, "metallic": 0.0, "sheen": 0.0, "transmission": 0.0}),
    "ShaderNodeBsdfAnisotropic": (_ROUGHNESS_INPUTS, {"metallic": 1.0, "sheen": 0.0, "transmission": 0.0}),
    "ShaderNodeBsdfGlossy": (_ROUGHNESS_INPUTS, {"metallic": 1.0, "sheen": 0.0, "transmission": 0.0}),
    "ShaderNodeBsdfMetallic": (
        {"base_color": ("Base Color", "COLOR"), "roughness": ("Roughness", "VALUE")},
        {"metallic": 1.0, "sheen": 0.0, "transmission": 0.0},
    ),
    "ShaderNodeBsdfGlass": (_ROUGHNESS_INPUTS, {"metallic": 0.0, "sheen": 0.0, "transmission": 1.0}),
    "ShaderNodeBsdfRefraction": (_ROUGHNESS_INPUTS, {"metallic": 0.0, "sheen": 0.0, "transmission": 1.0}),
    "ShaderNodeBsdfSheen": (_COLOUR_INPUT, {"roughness": 1.0, "metallic": 0.0, "sheen": 1.0, "transmission": 0.0}),
    "ShaderNodeBsdfTranslucent": (_COLOUR_INPUT, {"roughness": 1.0, "metallic": 0.0}),
    "ShaderNodeSubsurfaceScattering": (_COLOUR_INPUT, {"metallic": 0.0}),
    "ShaderNodeBsdfToon": (_COLOUR_INPUT, {"metallic": 0.0}),
    "ShaderNodeBsdfHair": (_COLOUR_INPUT, {"metallic": 0.0}),
    "ShaderNodeBsdfHairPrincipled": (_COLOUR_INPUT, {"metallic": 0.0}),
    "ShaderNodeEeveeSpecular": ({"base_color": ("Base Color", "COLOR"), "roughness": ("Roughness", "VALUE")}, {}),
}
"""Type of a BSDF node → shading values read from its inputs (socket name and kind), and values known from its type."""
EMISSIVE: ClosureTable = {"ShaderNodeEmission": (_COLOUR_INPUT, {}), "ShaderNodeBackground": (_COLOUR_INPUT, {})}
"""Emissive nodes, read if a surface has no BSDF: scans are often saved with emission, to be shown without light."""


def _read_layers(socket: Any, tapper: Tapper, notes: list[str], table: ClosureTable) -> Layers | None:
    """Read the tree of closures (BSDFs) behind a shader socket, as far as their node types are in `table`.

    Returns None if there are none.
    """
    if not socket.is_output or socket.node.mute:
        return None
    node, graph = socket.node, tapper.graph
    if node.bl_idname in {"ShaderNodeMixShader", "ShaderNodeAddShader"}:
        sides = [entry for entry in node.inputs if entry.type == "SHADER"]
        first, second = (_read_layers(graph.resolve(side), tapper, notes, table) for side in sides)
        if first is None or second is None:  # transparency and emission cannot be felt
            return second if first is None else first
        factor = tapper.tap_input(node.inputs[0], "VALUE") if node.bl_idname == "ShaderNodeMixShader" else Constant(0.5)
        return Blend(factor, first, second)
    if node.bl_idname not in table:
        return None
    inputs, known = table[node.bl_idname]
    shading: dict[str, Quantity] = {name: Constant(value) for name, value in known.items()}
    for name, (socket_name, kind) in inputs.items():
        entry = node.inputs.get(socket_name)
        if entry is not None:
            shading[name] = tapper.tap_input(entry, "COLOR" if kind == "COLOR" else "VALUE")
    normal = node.inputs.get("Normal")
    micro = MicroGeometry() if normal is None else read_normal_input(normal, tapper, notes)
    coat = node.inputs.get("Coat Normal")
    if coat is not None and coat.is_linked and micro == MicroGeometry():
        notes.append(f"the coat normal of '{node.name}' is not read; link it to Normal too to feel it.")
    return Closure(shading, micro)


CONSTANT_NODES = {"ShaderNodeRGB", "ShaderNodeValue"}
UNKNOWN_MIX_FACTOR = 0.5
"""Factor assumed for two mixed shaders whose factor is textured."""


def read_stated_appearance(material: Any) -> Appearance:
    """Return the shading values that a material's nodes state; textured or computed values stay unknown.

    Nothing is rendered, and the file is left unchanged.
    """
    if not compat.use_nodes(material):
        return _make_appearance(read_viewport_shading(material), {})
    with TemporaryScene():
        tapper = _ConstantTapper(NodeGraph(material.copy()), "hnf")
        layers = read_shader(tapper).layers
        mix_factors = {tap.name: np.asarray(UNKNOWN_MIX_FACTOR, dtype=np.float32) for tap in tapper.taps}
    return Appearance() if layers is None else _make_appearance(layers, mix_factors)


class _ConstantTapper(Tapper):
    """A Tapper that reads Value and RGB nodes as constants, for readings without a render."""

    def tap_input(self, socket: Any, kind: Literal["VALUE", "COLOR"]) -> Quantity:
        source = self.graph.resolve(socket)
        if source.is_output and source.node.bl_idname in CONSTANT_NODES and not source.node.mute:
            return Constant(get_constant_value(source, kind))
        return super().tap_input(socket, kind)


def _make_appearance(layers: Any, mix_factors: dict[str, NDArray[np.float32]]) -> Appearance:
    """Return the shading values of a tree of BSDFs that are constant, with mix factors by AOV name."""
    values: dict[str, Any] = {}
    for name in SHADING:
        value = mix_closures(layers, mix_factors, partial(_read_constant, name))
        if value is not None:
            clipped = np.clip(value, 0.0, 1.0)
            values[name] = tuple(float(part) for part in clipped) if name == "base_color" else float(clipped)
    return Appearance(**values)


def _read_constant(name: str, closure: Closure) -> NDArray[np.float64] | None:
    """Return a BSDF's shading value of a name if it is constant, else None."""
    quantity = closure.shading.get(name)
    return quantity.read({}) if isinstance(quantity, Constant) else None


VERTEX_COLOUR_NODES = frozenset({"ShaderNodeVertexColor", "ShaderNodeAttribute"})
VARYING_NODES = (
    PROCEDURAL_NODES
    | VERTEX_COLOUR_NODES
    | {IMAGE_NODE, "ShaderNodeTexCoord", "ShaderNodeUVMap", "ShaderNodeNewGeometry"}
)
"""Nodes whose value varies from place to place; mixed constants do not."""


class ReliefSource(Enum):
    """Source that a material's relief (height) can be read or predicted from.

    RELIEF: the material has bump, displacement or normal maps. VARYING_COLOUR: it has none, but its color may vary from
    place to place. NONE: neither.
    """

    RELIEF = "relief"
    VARYING_COLOUR = "picture"
    NONE = "nothing"


@dataclass(frozen=True)
class ColourSources:
    """Sources of a material's color variation: images, procedural textures, vertex colors.

    Attributes
    ----------
    images : tuple of ImageTap
    procedural : bool
        True if procedural textures are among the sources.
    painted : bool
        True if vertex colors are among the sources.
    source : str
        Description for the report.
    """

    images: tuple[ImageTap, ...]
    procedural: bool
    painted: bool
    source: str


def find_relief_source(material: Any) -> ReliefSource:
    """Tell what a material's relief can be read or predicted from, by its nodes alone: no copy, no render.

    A node group that is used twice in the material is read once.
    """
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
    """Return True if a material's relief is made of images directly, so that a coarse render can measure their texels.

    Reads the nodes only, like `find_relief_source`; `bridge/isolated_object.py` uses the texels.
    """
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
    has_constant_factors = not any(graph.resolve(factor).is_output for factor in factors)
    return has_constant_factors and all(is_texel_limited(graph, sockets) for sockets in inputs)


def get_stated_height(material: Any) -> float:
    """Return the largest height that the numbers of a Bump or Displacement node state [Blender units]; 0 for none.

    Reads the nodes only. Those count whose Height is a texture, 0 to 1, and whose factors are constant.
    """
    if material is None or not compat.use_nodes(material):
        return 0.0
    graph = NodeGraph(material, copy_groups=False)
    if graph.output is None:
        return 0.0
    closures, _ = _find_surface_closures(graph)
    chains = [follow_normal_chain(graph, node.inputs["Normal"]) for node in closures if "Normal" in node.inputs]
    scaled: list[tuple[Any, tuple[str, ...]]] = [(bump, BUMP_FACTORS) for bumps, _ in chains for bump in bumps]
    if is_displacing(graph, graph.output.inputs["Displacement"]):
        scaled.append((graph.source_node(graph.output.inputs["Displacement"]), ("Scale",)))
    heights = [0.0]
    for node, factors in scaled:
        texture = graph.resolve(node.inputs["Height"]).node
        sources = [graph.resolve(node.inputs[name]) for name in factors]
        if texture.bl_idname in PROCEDURAL_NODES | {IMAGE_NODE} and not any(source.is_output for source in sources):
            heights.append(abs(float(np.prod([get_constant_value(source, "VALUE") for source in sources]))))
    return max(heights)


def has_relief(graph: NodeGraph) -> bool:
    """Return True if a BSDF's Normal input, or the material's displacement, shapes the surface."""
    if graph.output is None:
        return False
    closures, _ = _find_surface_closures(graph)
    chains = [follow_normal_chain(graph, node.inputs["Normal"]) for node in closures if "Normal" in node.inputs]
    shaped = any(bumps or end is not None for bumps, end in chains)
    return shaped or is_displacing(graph, graph.output.inputs["Displacement"])


def find_colour_sources(tapper: Tapper) -> ColourSources | None:
    """Return what makes the color of a material copy vary; None if the material has a relief or a uniform color."""
    sockets = list_colour_sockets(tapper.graph)
    kinds = _collect_node_types(tapper.graph, sockets)
    if has_relief(tapper.graph) or not kinds & VARYING_NODES:
        return None
    images, procedural = find_image_sources(tapper, sockets)
    painted, pattern = bool(kinds & VERTEX_COLOUR_NODES), bool(kinds & PROCEDURAL_NODES)
    descriptions = [f"image '{name}'" for name in dict.fromkeys(image.name for image in images)]
    descriptions += ["a pattern"] if pattern else []
    descriptions += ["painted vertices"] if painted else []
    # A bare coordinate counts as a pattern without texels. Vertex colors are as fine as the mesh's vertices.
    return ColourSources(
        images, procedural and (pattern or not painted), painted, ", ".join(descriptions) or "a pattern"
    )


def list_colour_sockets(graph: NodeGraph) -> list[Any]:
    """Return the color inputs of the surface's BSDF nodes, and the factor inputs of the Mix Shaders between them."""
    closures, factors = _find_surface_closures(graph)
    names = [({**BSDFS, **EMISSIVE})[node.bl_idname][0]["base_color"][0] for node in closures]
    return [node.inputs[name] for node, name in zip(closures, names, strict=True) if name in node.inputs] + factors


def _find_surface_closures(graph: NodeGraph) -> tuple[list[Any], list[Any]]:
    """Return the surface's BSDF nodes, and the factor sockets of Mix Shaders that have BSDFs on both sides.

    If there is no BSDF, emissive nodes are returned instead.
    """
    if graph.output is None:
        return [], []
    socket = graph.output.inputs["Surface"]
    closures = _collect_closures(graph, socket, BSDFS)
    return closures if closures[0] else _collect_closures(graph, socket, EMISSIVE)


def _collect_closures(graph: NodeGraph, socket: Any, table: ClosureTable) -> tuple[list[Any], list[Any]]:
    """Return the nodes behind a shader socket whose types are in `table`, and the factor sockets that mix them."""
    node = graph.source_node(socket)
    if node is None:
        return [], []
    if node.bl_idname not in {"ShaderNodeMixShader", "ShaderNodeAddShader"}:
        return ([node] if node.bl_idname in table else []), []
    (first, first_factors), (second, second_factors) = (
        _collect_closures(graph, side, table) for side in node.inputs if side.type == "SHADER"
    )
    mixes = first and second and node.bl_idname == "ShaderNodeMixShader"
    return first + second, first_factors + second_factors + ([node.inputs[0]] if mixes else [])


def _collect_node_types(graph: NodeGraph, sockets: Iterable[Any]) -> set[str]:
    """Return the types of all nodes behind sockets, up to and including textures."""
    return {node.bl_idname for socket in sockets for node in graph.upstream(socket, PROCEDURAL_NODES | {IMAGE_NODE})}
