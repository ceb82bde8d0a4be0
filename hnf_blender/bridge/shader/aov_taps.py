"""Taps: values inside a shader that are rendered as AOV passes, so that they can be combined in numpy.

The texel size of the images behind such values, measured on the rendered patch (a square of surface), is here too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from .images import COPIED_FROM, get_image_size, get_rounding_step
from .node_graph import NodeGraph

Float = NDArray[np.float64]
Passes = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True)
class Tap:
    """A shader value rendered as AOV pass `name`: (H, W) for VALUE, (H, W, 3) for COLOR."""

    name: str
    kind: Literal["VALUE", "COLOR"]

    def read(self, passes: Passes) -> Float:
        """Return the value at every pixel, (H, W) or (H, W, 3), from the rendered passes."""
        pixels = passes[self.name].astype(np.float64)
        return pixels[..., :3] if self.kind == "COLOR" else pixels


@dataclass(frozen=True)
class Constant:
    """A shader value that is the same at every pixel: a number, or three for a color."""

    value: float | tuple[float, float, float]

    def read(self, passes: Passes) -> Float:
        """Return the value; the rendered passes are not used."""
        return np.asarray(self.value, dtype=np.float64)


Quantity = Tap | Constant


class Tapper:
    """Adds AOV Output nodes to a copy of a material; their pass names start with `prefix`, which makes them unique."""

    def __init__(self, graph: NodeGraph, prefix: str) -> None:
        self.graph = graph
        self.taps: list[Tap] = []
        self._prefix = prefix
        self._tap_cache: dict[tuple[str, str, str, str], Tap] = {}

    def tap_output(self, socket: Any, kind: Literal["VALUE", "COLOR"]) -> Tap:
        """Add an AOV output for an output socket and return its pass; the socket may be inside a node group."""
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
        """Return the value of an input socket: an AOV pass (Tap), or a constant if nothing is linked."""
        source = self.graph.resolve(socket)
        if source.is_output and not source.node.mute:
            return self.tap_output(source, kind)
        return Constant(get_constant_value(source, kind))

    def multiply(self, tree: Any, *factors: Any) -> Any:
        """Add a chain of Math nodes to `tree` and return the output socket with the product of `factors`.

        A factor is an input or output socket in `tree`, or a number.
        """
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
    """Let an input socket `target` have the same value as `source`.

    `source` is an output socket in `tree`, an input socket in `tree`, or a number.
    """
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
    """Return the default value of an unlinked socket: for VALUE a number, for COLOR three.

    A color read as VALUE gives its luminance, as in Blender.
    """
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
"""Types of nodes that, between an image and a relief, do not make the relief finer than the image's texels."""
STEPLESS_MATH = frozenset({"ADD", "SUBTRACT", "MULTIPLY", "MULTIPLY_ADD", "DIVIDE"})
"""Operations of Math nodes without a step, which therefore add no detail finer than a texel."""


@dataclass(frozen=True)
class ImageTap:
    """An image texture behind a shader value, with the AOV pass of its coordinates.

    Attributes
    ----------
    name : str
        Name of the image.
    vector : Tap
        Texture coordinates at which it is read.
    texels : tuple of float
        Texels per unit of each coordinate: (x, y), or (x, y, z) if the image is projected from several sides.
    step : float
        Step to which its values are rounded, 0 for none or if it does not matter.
    values : Tap or None
        AOV pass of its values, if they are rounded.
    is_data : bool
        False if its values are colors, decoded from sRGB.
    """

    name: str
    vector: Tap
    texels: tuple[float, ...]
    step: float = 0.0
    values: Tap | None = None
    is_data: bool = True


class ImageSourced(Protocol):
    """Protocol of shader values that are made from images, and possibly from procedural textures."""

    @property
    def images(self) -> tuple[ImageTap, ...]: ...
    @property
    def procedural(self) -> bool: ...


def find_image_sources(
    tapper: Tapper, sockets: Iterable[Any], with_values: bool = False
) -> tuple[tuple[ImageTap, ...], bool]:
    """Return the images behind input sockets, and True if procedural textures are among their sources.

    Nodes that only move or distort an image's coordinates do not count, as they add no detail of their own.
    `with_values` renders the values of rounded images too, to tell their steps from relief.
    """
    stop = PROCEDURAL_NODES | {IMAGE_NODE}
    nodes = {
        (node.id_data.name_full, node.name): node for socket in sockets for node in tapper.graph.upstream(socket, stop)
    }
    images = tuple(
        tap_image(node, tapper, with_values)
        for node in nodes.values()
        if node.bl_idname == IMAGE_NODE and node.image is not None
    )
    kinds = {node.bl_idname for node in nodes.values()}
    return images, bool(kinds & PROCEDURAL_NODES) or (not images and bool(kinds & COORDINATE_NODES))


def is_texel_limited(graph: NodeGraph, sockets: Iterable[Any]) -> bool:
    """Return True if the input sockets show no detail finer than the texels of one image.

    They must depend on at most one image: a product of two contains sums of their frequencies. A color ramp with a step
    may be as fine as a pixel.
    """
    stop = frozenset({IMAGE_NODE})
    nodes = {(node.id_data.name_full, node.name): node for socket in sockets for node in graph.upstream(socket, stop)}
    steps = (
        node for node in nodes.values() if node.bl_idname == "ShaderNodeMath" and node.operation not in STEPLESS_MATH
    )
    images = sum(node.bl_idname == IMAGE_NODE for node in nodes.values())
    return (
        images <= 1 and next(steps, None) is None and {node.bl_idname for node in nodes.values()} <= TEXEL_LIMITED_NODES
    )


def tap_image(node: Any, tapper: Tapper, with_values: bool = False) -> ImageTap:
    """Add an AOV output for the coordinates of an Image Texture node, from which its texel size is measured.

    `with_values` adds one for its values, if they are rounded.
    """
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
    # Box, sphere and tube projections use all three coordinates.
    texels = flat if node.projection == "FLAT" else (*flat, width * scale[2])
    step = get_rounding_step(node.image)
    values = tapper.tap_output(node.outputs["Color"], "COLOR") if with_values and step > 0.0 else None
    return ImageTap(
        str(node.image.get(COPIED_FROM, node.image.name)),
        tap,
        texels,
        step,
        values,
        bool(node.image.colorspace_settings.is_data),
    )


def compute_resolved_wavelength(sources: Iterable[ImageSourced], passes: Passes, mask: Mask, pixel_m: float) -> float:
    """Return the shortest resolved wavelength [m]: two texels of the finest image, at least two pixels (`pixel_m`)."""
    return max(2.0 * find_finest_texel(sources, passes, mask, pixel_m), 2.0 * pixel_m)


def find_finest_texel(sources: Iterable[ImageSourced], passes: Passes, mask: Mask, pixel_m: float) -> float:
    """Return the smallest texel size on the surface among the images of `sources` [m].

    It is 0 if a source is procedural, inf if unknown. `mask` (H, W) is the patch's surface, `pixel_m` the size of a
    pixel [m].
    """
    sources = tuple(sources)
    if any(source.procedural for source in sources):
        return 0.0
    texels = (measure_texel_size(image, passes, mask, pixel_m) for source in sources for image in source.images)
    return min(texels, default=float("inf"))


def measure_texel_size(image: ImageTap, passes: Passes, mask: Mask, pixel_m: float) -> float:
    """Return the median size on the surface of a texel [m], in the direction in which it is shortest; inf if unknown.

    A strip of long texels shows waves across them. `mask` (H, W) is the patch's surface, `pixel_m` the size of a pixel
    [m].
    """
    across, along = _measure_texel_rates(image, passes, pixel_m)
    # Larger singular value of the Jacobian (texels per meter), by its first fundamental form.
    e, f, g = (np.sum(a * b, axis=-1) for a, b in ((across, across), (across, along), (along, along)))
    largest = np.sqrt(np.maximum((e + g + np.sqrt((e - g) ** 2 + 4.0 * f**2)) / 2.0, 0.0))
    inner = mask[SPARSE] & (largest > LEAST_TEXELS / (max(mask.shape) * pixel_m))
    return float(np.median(1.0 / largest[inner])) if inner.any() else float("inf")


MAX_TEXEL_SCATTER = 0.2
"""Relative deviation from the median up to which the texels of a patch count as one grid."""


def find_texel_grid(image: ImageTap, passes: Passes, mask: Mask, pixel_m: float) -> Float | None:
    """Return the grid of an image's texels on a patch as the derivative (2, 2) of (u, v) [texels] by (x, y), y up [m].

    None unless nine tenths of the patch have nearly the same grid, as they have not at a seam or on a strong bend.
    """
    if len(image.texels) != 2:
        return None
    across, along = _measure_texel_rates(image, passes, pixel_m)
    rates = np.stack([across, -along], axis=-1)[mask[SPARSE]]
    if len(rates) == 0:
        return None
    middle = np.median(rates, axis=0)
    if abs(np.linalg.det(middle)) < 1e-12 * np.sum(middle**2) or not np.isfinite(middle).all():
        return None
    # In steps of texels, so that both axes of a strip count alike.
    deviation = np.linalg.norm(rates @ np.linalg.inv(middle) - np.eye(2), axis=(1, 2))
    return middle if np.mean(deviation < MAX_TEXEL_SCATTER) > 0.9 else None


LEAST_TEXELS = 1e-3
"""Texels along a patch below which its coordinates are constant but for rounding."""
SPARSE = (slice(1, -1, 4), slice(1, -1, 4))
"""Pixels of a patch (rows, columns) at which texels are measured: every fourth, not at the edge."""


def _measure_texel_rates(image: ImageTap, passes: Passes, pixel_m: float) -> tuple[Float, Float]:
    """Return the texels per meter (…, 2 or 3) along the columns and along the rows of a patch, at SPARSE pixels."""
    texels = np.asarray(image.texels, dtype=np.float64)
    coordinates = passes[image.vector.name][..., : len(texels)]
    rows, columns = SPARSE
    right, left = (coordinates[rows, 1 + shift : coordinates.shape[1] - 1 + shift : 4] for shift in (1, -1))
    below, above = (coordinates[1 + shift : coordinates.shape[0] - 1 + shift : 4, columns] for shift in (1, -1))
    scale = texels / (2.0 * pixel_m)
    return (right.astype(np.float64) - left) * scale, (below.astype(np.float64) - above) * scale


def measure_image_step(image: ImageTap, quantity: Float, passes: Passes, mask: Mask) -> float:
    """Return how far one rounding step of an image moves a quantity (H, W) made from it; 0 if it is not rounded.

    The slope of the quantity over the image's values is fitted on the patch, so that nodes between them count.
    """
    if image.values is None or image.step == 0.0:
        return 0.0
    mask = mask[SPARSE]
    values = image.values.read(passes)[SPARSE][mask]
    if len(values) == 0:
        return 0.0
    level = values - values.mean(axis=0)
    if not np.any(level):
        return 0.0
    if np.ptp(level, axis=1).max() < 1e-3 * np.ptp(level):  # grey: the channels are rounded together
        level, values = level[:, :1], values[:, :1]
    sample = quantity[SPARSE][mask]
    gain, *_ = np.linalg.lstsq(level.T @ level, level.T @ (sample - sample.mean()), rcond=1e-9)
    steps = np.full(len(gain), image.step)
    if not image.is_data:
        steps = image.step * _srgb_slope(np.clip(np.median(values, axis=0), 0.0, 1.0))
    return float(np.linalg.norm(gain * steps))


def _srgb_slope(linear: Float) -> Float:
    """Return the derivative of linear values by their sRGB codes (0 to 1)."""
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return np.where(encoded <= 0.04045, 1.0 / 12.92, 2.4 / 1.055 * ((encoded + 0.055) / 1.055) ** 1.4)
