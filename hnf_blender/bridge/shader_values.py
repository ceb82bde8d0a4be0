"""What a shader says of a material without rendering it: the values that stand in its nodes."""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.material import Appearance

from .. import compat
from .appearance import SHADING, Closure, mix_closures, read_shader, read_viewport_shading
from .node_graph import NodeGraph
from .taps import Constant, Quantity, Tapper, get_constant_value
from .temporary import TemporaryScene

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
