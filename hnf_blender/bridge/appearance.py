"""Shaders as layers of closures: shading values and micro-geometry of each, and the weights that mix them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.material import Appearance

from .shader_height import MicroGeometry, read_displacement, read_normal_input
from .taps import Constant, Passes, Quantity, Tapper

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
