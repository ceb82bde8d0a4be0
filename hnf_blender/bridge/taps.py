"""Taps: values inside a shader, sent to the render as AOV passes and weighed together in numpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

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
