"""What a shader says of a material without rendering it: the values that stand in its nodes."""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.material import Appearance

from .. import compat
from .appearance import SHADING, Closure, mixed, plain_shading, read_shader
from .node_graph import NodeGraph
from .taps import Constant, Quantity, Tapper, constant_value
from .temporary import Temporary

VALUE_NODES = {"ShaderNodeRGB", "ShaderNodeValue"}
UNKNOWN_SHARE = 0.5
"""Of two mixed shaders whose factor is a texture."""


def stated_appearance(material: Any) -> Appearance:
    """Shading values of a material as its nodes state them; what a texture or a calculation says stays unknown.

    Renders nothing and leaves nothing behind in the file.
    """
    if not compat.use_nodes(material):
        return _appearance(plain_shading(material), {})
    with Temporary():
        tapper = _Reader(NodeGraph(material.copy()), "hnf")
        layers = read_shader(tapper).layers
        shares = {tap.name: np.asarray(UNKNOWN_SHARE, dtype=np.float32) for tap in tapper.taps}
    return Appearance() if layers is None else _appearance(layers, shares)


class _Reader(Tapper):
    """A tapper that takes the constants of value and colour nodes as such."""

    def input(self, socket: Any, kind: Literal["VALUE", "COLOR"]) -> Quantity:
        source = self.graph.resolve(socket)
        if source.is_output and source.node.bl_idname in VALUE_NODES and not source.node.mute:
            return Constant(constant_value(source, kind))
        return super().input(socket, kind)


def _appearance(layers: Any, shares: dict[str, NDArray[np.float32]]) -> Appearance:
    values: dict[str, Any] = {}
    for name in SHADING:
        value = mixed(layers, shares, partial(_stated, name))
        if value is not None:
            clipped = np.clip(value, 0.0, 1.0)
            values[name] = tuple(float(part) for part in clipped) if name == "base_color" else float(clipped)
    return Appearance(**values)


def _stated(name: str, closure: Closure) -> NDArray[np.float64] | None:
    quantity = closure.shading.get(name)
    return quantity.read({}) if isinstance(quantity, Constant) else None
