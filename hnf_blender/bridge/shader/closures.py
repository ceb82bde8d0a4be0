"""Shaders as layers of closures: shading values and micro-geometry of each, and the weights that mix them.

What a shader says of a material without rendering it: the values that stand in its nodes.

What a shader has to show where it has no relief: the images, patterns and painted vertices behind its colour.
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


@dataclass(frozen=True)
class Closure:
    """One BSDF: its shading values by name (SHADING) and its micro-geometry."""

    shading: Mapping[str, Quantity] = field(default_factory=dict)
    micro: MicroGeometry = field(default_factory=MicroGeometry)


@dataclass(frozen=True)
class Blend:
    """(1 − factor) · first + factor · second."""

    factor: Quantity
    first: Layers
    second: Layers


Layers = Closure | Blend


@dataclass(frozen=True)
class ShaderReading:
    """What to read off a material. layers: its surface, None without nodes. displacement: on top of all layers."""

    layers: Layers | None
    displacement: MicroGeometry
    notes: tuple[str, ...] = ()


def read_shader(tapper: Tapper) -> ShaderReading:
    """Tap everything that matters of a material copy's surface."""
    output = tapper.graph.output
    if output is None:
        return ShaderReading(None, MicroGeometry(), ("its node tree has no Material Output.",))
    notes: list[str] = []
    surface = tapper.graph.resolve(output.inputs["Surface"])
    layers = _read_layers(surface, tapper, notes, BSDFS) or _read_layers(surface, tapper, notes, EMISSIVE)
    displacement = read_displacement(output.inputs["Displacement"], tapper, notes)
    return ShaderReading(layers, displacement, tuple(dict.fromkeys(notes)))


def read_viewport_shading(material: Any) -> Closure:
    """A material without nodes: its viewport values."""
    colour = tuple(float(part) for part in material.diffuse_color)[:3]
    return Closure({
        "base_color": Constant((colour[0], colour[1], colour[2])),
        "roughness": Constant(float(material.roughness)),
        "metallic": Constant(float(material.metallic)),
    })  # fmt: skip


def mix_closures(layers: Layers, passes: Passes, value: Callable[[Closure], Float | None]) -> Float | None:
    """value of every closure, mixed by the factors; closures that do not know it (None) leave it to the others."""
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
    if layers is None:
        return []
    if isinstance(layers, Closure):
        return [layers]
    return list_closures(layers.first) + list_closures(layers.second)


def list_mix_factors(layers: Layers | None) -> list[Quantity]:
    """What the closures are mixed by."""
    if layers is None or isinstance(layers, Closure):
        return []
    return [layers.factor, *list_mix_factors(layers.first), *list_mix_factors(layers.second)]


def average_appearance(layers: Layers | None, passes: Passes, mask: NDArray[np.bool_]) -> Appearance:
    """Shading values averaged over the pixels in mask."""
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
"""Tapped inputs and known values of every BSDF node."""
EMISSIVE: ClosureTable = {"ShaderNodeEmission": (_COLOUR_INPUT, {}), "ShaderNodeBackground": (_COLOUR_INPUT, {})}
"""Read where a surface has no BSDF at all: a scan is often saved as its own light, so that none is needed."""


def _read_layers(socket: Any, tapper: Tapper, notes: list[str], table: ClosureTable) -> Layers | None:
    """Layers of a shader socket (already resolved), of such closures; None where it has none of them."""
    if not socket.is_output or socket.node.mute:
        return None
    node, graph = socket.node, tapper.graph
    if node.bl_idname in {"ShaderNodeMixShader", "ShaderNodeAddShader"}:
        sides = [entry for entry in node.inputs if entry.type == "SHADER"]
        first, second = (_read_layers(graph.resolve(side), tapper, notes, table) for side in sides)
        if first is None or second is None:  # cut-outs and glow are not felt
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
"""Of two mixed shaders whose factor is a texture."""


def read_stated_appearance(material: Any) -> Appearance:
    """Shading values of a material as its nodes state them; what a texture or a calculation says stays unknown.

    Renders nothing and leaves nothing behind in the file.
    """
    if not compat.use_nodes(material):
        return _make_appearance(read_viewport_shading(material), {})
    with TemporaryScene():
        tapper = _ConstantTapper(NodeGraph(material.copy()), "hnf")
        layers = read_shader(tapper).layers
        shares = {tap.name: np.asarray(UNKNOWN_MIX_FACTOR, dtype=np.float32) for tap in tapper.taps}
    return Appearance() if layers is None else _make_appearance(layers, shares)


class _ConstantTapper(Tapper):
    """A tapper that takes the constants of value and colour nodes as such."""

    def tap_input(self, socket: Any, kind: Literal["VALUE", "COLOR"]) -> Quantity:
        source = self.graph.resolve(socket)
        if source.is_output and source.node.bl_idname in CONSTANT_NODES and not source.node.mute:
            return Constant(get_constant_value(source, kind))
        return super().tap_input(socket, kind)


def _make_appearance(layers: Any, mix_factors: dict[str, NDArray[np.float32]]) -> Appearance:
    values: dict[str, Any] = {}
    for name in SHADING:
        value = mix_closures(layers, mix_factors, partial(_read_constant, name))
        if value is not None:
            clipped = np.clip(value, 0.0, 1.0)
            values[name] = tuple(float(part) for part in clipped) if name == "base_color" else float(clipped)
    return Appearance(**values)


def _read_constant(name: str, closure: Closure) -> NDArray[np.float64] | None:
    quantity = closure.shading.get(name)
    return quantity.read({}) if isinstance(quantity, Constant) else None


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
