"""Taps: values inside a shader, sent to the render as AOV passes and weighed together in numpy.

How fine the images behind a shader's value are: their texels, measured on the patch where they lie.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from .images import get_image_size
from .node_graph import NodeGraph

Float = NDArray[np.float64]
Passes = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True)
class Tap:
    """A shader value that the render writes as AOV pass `name`: (H, W) for VALUE, (H, W, 3) for COLOR."""

    name: str
    kind: Literal["VALUE", "COLOR"]

    def read(self, passes: Passes) -> Float:
        pixels = passes[self.name].astype(np.float64)
        return pixels[..., :3] if self.kind == "COLOR" else pixels


@dataclass(frozen=True)
class Constant:
    """A value that is the same on every pixel. value: a number or three."""

    value: float | tuple[float, float, float]

    def read(self, passes: Passes) -> Float:
        return np.asarray(self.value, dtype=np.float64)


Quantity = Tap | Constant


class Tapper:
    """Adds AOV outputs to a material copy. Names start with prefix and are unique within it."""

    def __init__(self, graph: NodeGraph, prefix: str) -> None:
        self.graph = graph
        self.taps: list[Tap] = []
        self._prefix = prefix
        self._tap_cache: dict[tuple[str, str, str, str], Tap] = {}

    def tap_output(self, socket: Any, kind: Literal["VALUE", "COLOR"]) -> Tap:
        """Tap an output socket, wherever its node stands."""
        key = (socket.id_data.name_full, socket.node.name, socket.identifier, kind)
        if key not in self._tap_cache:
            tap = Tap(f"{self._prefix}{len(self.taps)}", kind)
            node = socket.id_data.nodes.new("ShaderNodeOutputAOV")
            node.aov_name = tap.name
            socket.id_data.links.new(socket, node.inputs["Color" if kind == "COLOR" else "Value"])
            self.taps.append(tap)
            self._tap_cache[key] = tap
        return self._tap_cache[key]

    def tap_input(self, socket: Any, kind: Literal["VALUE", "COLOR"]) -> Quantity:
        """What an input socket receives: a tap, or a constant where nothing is linked."""
        source = self.graph.resolve(socket)
        if source.is_output and not source.node.mute:
            return self.tap_output(source, kind)
        return Constant(get_constant_value(source, kind))

    def multiply(self, tree: Any, *factors: Any) -> Any:
        """Output socket of a chain of Math nodes in tree: the product of factors (see copy_input)."""
        result: Any = None
        for factor in factors:
            node = tree.nodes.new("ShaderNodeMath")
            node.operation = "MULTIPLY"
            node.inputs[1].default_value = 1.0
            copy_input(tree, factor, node.inputs[0])
            if result is not None:
                tree.links.new(result, node.inputs[1])
            result = node.outputs[0]
        return result


def copy_input(tree: Any, source: Any, target: Any) -> None:
    """Make the input socket target receive source: an output socket in tree, what feeds an input socket in tree, or
    a number."""
    if isinstance(source, float):
        target.default_value = source
        return
    if source.is_output:
        tree.links.new(source, target)
        return
    link = next((link for link in source.links if not link.is_muted), None)
    if link is not None:
        tree.links.new(link.from_socket, target)
    else:
        target.default_value = get_constant_value(source, "VALUE")


def get_constant_value(socket: Any, kind: str) -> Any:
    """A socket's default: a number for VALUE (colours by luminance, as Blender converts them), three for COLOR."""
    value = getattr(socket, "default_value", 0.0)
    if isinstance(value, (bool, int, float)):
        return float(value) if kind == "VALUE" else (float(value),) * 3
    if value is None or isinstance(value, str):
        return 0.0 if kind == "VALUE" else (0.0, 0.0, 0.0)
    colour = tuple(float(part) for part in value)[:3]
    return float(np.dot(colour, (0.2126, 0.7152, 0.0722))) if kind == "VALUE" else colour


Mask = NDArray[np.bool_]

PROCEDURAL_NODES = frozenset({
    "ShaderNodeTexNoise", "ShaderNodeTexVoronoi", "ShaderNodeTexWave", "ShaderNodeTexMagic", "ShaderNodeTexBrick",
    "ShaderNodeTexChecker", "ShaderNodeTexGradient", "ShaderNodeTexWhiteNoise", "ShaderNodeTexGabor",
    "ShaderNodeTexMusgrave", "ShaderNodeTexPointDensity", "ShaderNodeTexIES",
})  # fmt: skip
IMAGE_NODE = "ShaderNodeTexImage"
COORDINATE_NODES = frozenset({"ShaderNodeUVMap", "ShaderNodeTexCoord", "ShaderNodeNewGeometry", "ShaderNodeAttribute"})


TEXEL_LIMITED_NODES = frozenset({
    IMAGE_NODE, "ShaderNodeNormalMap", "ShaderNodeMath", "ShaderNodeInvert", "ShaderNodeRGBCurve", "ShaderNodeRGBToBW",
    "ShaderNodeSeparateColor", "ShaderNodeCombineColor", "ShaderNodeSeparateRGB", "ShaderNodeCombineRGB",
    "ShaderNodeValue", "ShaderNodeRGB",
})  # fmt: skip
"""What may stand between an image and a relief without making it finer than its texels."""
STEPLESS_MATH = frozenset({"ADD", "SUBTRACT", "MULTIPLY", "MULTIPLY_ADD", "DIVIDE"})
"""Of Math nodes, those without a step."""


@dataclass(frozen=True)
class ImageTap:
    """An image behind a value. vector: tap of its texture coordinates. texels: for one unit of each coordinate: (x, y),
    or (x, y, z) where the image is projected from several sides."""

    name: str
    vector: Tap
    texels: tuple[float, ...]


class ImageSourced(Protocol):
    """Something made from images, or in part from what has no texels."""

    @property
    def images(self) -> tuple[ImageTap, ...]: ...
    @property
    def procedural(self) -> bool: ...


def find_image_sources(tapper: Tapper, sockets: Iterable[Any]) -> tuple[tuple[ImageTap, ...], bool]:
    """The images that input sockets are made from, and whether procedural textures are among their sources.

    What only moves or bends an image's coordinates adds no detail of its own.
    """
    stop = PROCEDURAL_NODES | {IMAGE_NODE}
    nodes = {
        (node.id_data.name_full, node.name): node for socket in sockets for node in tapper.graph.upstream(socket, stop)
    }
    images = tuple(
        tap_image(node, tapper) for node in nodes.values() if node.bl_idname == IMAGE_NODE and node.image is not None
    )
    kinds = {node.bl_idname for node in nodes.values()}
    return images, bool(kinds & PROCEDURAL_NODES) or (not images and bool(kinds & COORDINATE_NODES))


def is_texel_limited(graph: NodeGraph, sockets: Iterable[Any]) -> bool:
    """Are input sockets made from one image at most, by nothing that draws edges or details into it?

    A step of a ramp is as fine as pixels can be; two images multiplied have waves of both together.
    """
    stop = frozenset({IMAGE_NODE})
    nodes = {(node.id_data.name_full, node.name): node for each in sockets for node in graph.upstream(each, stop)}
    steps = (
        node for node in nodes.values() if node.bl_idname == "ShaderNodeMath" and node.operation not in STEPLESS_MATH
    )
    images = sum(node.bl_idname == IMAGE_NODE for node in nodes.values())
    return (
        images <= 1 and next(steps, None) is None and {node.bl_idname for node in nodes.values()} <= TEXEL_LIMITED_NODES
    )


def tap_image(node: Any, tapper: Tapper) -> ImageTap:
    """An Image Texture node, with a tap of the coordinates it is read at."""
    tree, vector = node.id_data, node.inputs["Vector"]
    if tapper.graph.resolve(vector).is_output:
        tap = tapper.tap_output(vector.links[0].from_socket, "COLOR")
    else:
        active = tree.nodes.new("ShaderNodeUVMap")
        tree.links.new(active.outputs["UV"], vector)
        tap = tapper.tap_output(active.outputs["UV"], "COLOR")
    scale = node.texture_mapping.scale
    width, height = get_image_size(node.image)
    flat = (width * scale[0], height * scale[1])
    # Box, sphere and tube projections look along all three axes.
    return ImageTap(node.image.name, tap, flat if node.projection == "FLAT" else (*flat, width * scale[2]))


def compute_resolved_wavelength(sources: Iterable[ImageSourced], passes: Passes, mask: Mask, pixel_m: float) -> float:
    """Shortest wavelength in metres that the finest source resolves: two texels, never less than two pixels."""
    return max(2.0 * find_finest_texel(sources, passes, mask, pixel_m), 2.0 * pixel_m)


def find_finest_texel(sources: Iterable[ImageSourced], passes: Passes, mask: Mask, pixel_m: float) -> float:
    """Size in metres of the smallest texels among the sources: 0 where one has none, inf where it cannot be told."""
    sources = tuple(sources)
    if any(source.procedural for source in sources):
        return 0.0
    texels = (measure_texel_size(image, passes, mask, pixel_m) for source in sources for image in source.images)
    return min(texels, default=float("inf"))


def measure_texel_size(image: ImageTap, passes: Passes, mask: Mask, pixel_m: float) -> float:
    """Median size in metres of a texel, along the direction in which it is longest; inf where it cannot be told."""
    texels = np.asarray(image.texels, dtype=np.float64)
    place = image.vector.read(passes)[..., : len(texels)] * texels
    across = (place[1:-1, 2:] - place[1:-1, :-2]) / (2.0 * pixel_m)
    along = (place[2:, 1:-1] - place[:-2, 1:-1]) / (2.0 * pixel_m)
    # Singular values of the Jacobian (texels per metre) by its first fundamental form.
    e, f, g = (np.sum(a * b, axis=-1) for a, b in ((across, across), (across, along), (along, along)))
    smallest = np.sqrt(np.maximum((e + g - np.sqrt((e - g) ** 2 + 4.0 * f**2)) / 2.0, 0.0))
    inner = mask[1:-1, 1:-1] & (smallest > 0.0)
    return float(np.median(1.0 / smallest[inner])) if inner.any() else float("inf")
