"""Materials of the demo scene, whose bumps are in metres.

Every height is that of the whole range 0 … 1 of its texture (noise uses about 0.4 of it), every wavelength that of the
real material. Cloth, leather and clay are flatter than real ones, as if worn: an actuator of ordinary strength can then
play the signal.
"""

from __future__ import annotations

from typing import Any

import bpy

from hnf_blender import compat

Colour = tuple[float, float, float]
MM, UM = 1e-3, 1e-6


class ShaderBuilder:
    """Material under construction, whose operations take sockets and numbers alike."""

    def __init__(self, name: str, **principled: Any) -> None:
        self.material = bpy.data.materials.new(name)
        compat.switch_nodes_on(self.material)
        self.nodes, self.links = self.material.node_tree.nodes, self.material.node_tree.links
        self.surface = next(node for node in self.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
        for label, value in principled.items():
            self.set_input(self.surface.inputs[label.replace("_", " ")], value)
        uv = self.add("ShaderNodeUVMap").outputs["UV"]
        split = self.add("ShaderNodeSeparateXYZ", uv)
        self.u, self.v = split.outputs["X"], split.outputs["Y"]

    def add(self, kind: str, *inputs: Any, label: str = "", **properties: Any) -> Any:
        """Add a node of a kind with these inputs (None: left as it is) and properties."""
        node = self.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        if label:
            node.name = node.label = label
        for socket, value in zip(node.inputs, inputs, strict=False):
            if value is not None:
                self.set_input(socket, value)
        return node

    def set_input(self, socket: Any, value: Any) -> None:
        """Link an input socket to an output socket, or set its default value."""
        if isinstance(value, bpy.types.NodeSocket):
            self.links.new(value, socket)
        elif socket.type == "RGBA" and len(value) == 3:
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def math(self, operation: str, *values: Any) -> Any:
        return self.add("ShaderNodeMath", *values, operation=operation).outputs[0]

    def add_values(self, *values: Any) -> Any:
        result = values[0]
        for value in values[1:]:
            result = self.math("ADD", result, value)
        return result

    def ridges(self, coordinate: Any, pitch_m: float) -> Any:
        """Compute |cos(π x / pitch)|: round backs with sharp valleys between, 0 … 1."""
        return self.math("ABSOLUTE", self.math("COSINE", self.math("MULTIPLY", coordinate, 3.14159265 / pitch_m)))

    def scale_coordinates(self, u_m: float, v_m: float) -> Any:
        """Scale the UVs to texture coordinates that grow by one per u_m along u and per v_m along v."""
        parts = [self.math("DIVIDE", self.u, u_m), self.math("DIVIDE", self.v, v_m)]
        return self.add("ShaderNodeCombineXYZ", *parts).outputs[0]

    def noise(self, u_m: float, v_m: float | None = None, detail: float = 2.0, rough: float = 0.5) -> Any:
        """Add smooth noise of wavelength about u_m by v_m with finer octaves, 0 … 1 around 0.5."""
        node = self.add("ShaderNodeTexNoise", self.scale_coordinates(u_m, v_m or u_m))
        node.inputs["Scale"].default_value = 1.0
        node.inputs["Detail"].default_value = detail
        node.inputs["Roughness"].default_value = rough
        return node.outputs[0]

    def cells(self, size_m: float, feature: str = "DISTANCE_TO_EDGE", jitter: float = 1.0) -> Any:
        """Add Voronoi cells; returns the distance to the cell's edge or centre, in cell sizes."""
        node = self.add("ShaderNodeTexVoronoi", self.scale_coordinates(size_m, size_m), feature=feature)
        node.inputs["Scale"].default_value = 1.0
        node.inputs["Randomness"].default_value = jitter
        return node.outputs["Distance"]

    def step(self, value: Any, low: float, high: float) -> Any:
        """Add a smooth step: 0 below low, 1 above high."""
        node = self.add("ShaderNodeMapRange", interpolation_type="SMOOTHSTEP")
        for name, part in (("Value", value), ("From Min", low), ("From Max", high)):
            self.set_input(next(socket for socket in node.inputs if socket.name == name), part)
        return node.outputs[0]

    def ramp(self, value: Any, *stops: tuple[float, Colour]) -> Any:
        node = self.add("ShaderNodeValToRGB", value)
        elements = node.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(0.5)
        for element, (position, colour) in zip(elements, stops, strict=True):
            element.position, element.color = position, (*colour, 1.0)
        return node.outputs["Color"]

    def add_bump(self, height_m: float, height: Any, label: str) -> None:
        """Add height (0 … 1) × height_m [m] of relief.

        The node's distance is set in metres because its default differs by version.
        """
        node = self.add("ShaderNodeBump", label=label)
        node.inputs["Strength"].default_value = 1.0
        node.inputs["Distance"].default_value = height_m
        self.set_input(node.inputs["Height"], height)
        normal_input = self.surface.inputs["Normal"]
        if normal_input.is_linked:
            self.set_input(node.inputs["Normal"], normal_input.links[0].from_socket)
        self.set_input(normal_input, node.outputs["Normal"])

    def set_colour(self, colour: Any) -> None:
        self.set_input(self.surface.inputs["Base Color"], colour)


def make_corduroy() -> Any:
    """Make corduroy: wales 2.2 mm apart along v, 60 µm high, with a fibrous pile."""
    s = ShaderBuilder("Corduroy", Roughness=0.9, Sheen_Weight=0.35, Sheen_Roughness=0.45, Specular_IOR_Level=0.15)
    wale = s.ridges(s.u, 2.2 * MM)
    pile = s.noise(0.22 * MM, 0.6 * MM, detail=1.0)
    s.add_bump(60 * UM, wale, "Wales")
    s.add_bump(12 * UM, pile, "Pile")
    worn = s.math("MULTIPLY", s.add_values(wale, s.math("MULTIPLY", s.noise(30 * MM, detail=3.0), 0.5)), 0.72)
    s.set_colour(
        s.ramp(worn, (0.12, (0.006, 0.030, 0.038)), (0.62, (0.018, 0.105, 0.120)), (1.0, (0.045, 0.185, 0.195)))
    )
    return s.material


def make_linen() -> Any:
    """Make linen in plain weave: threads 0.9 mm apart, 32 µm deep."""
    s = ShaderBuilder("Linen book cloth", Roughness=0.85, Sheen_Weight=0.2, Specular_IOR_Level=0.2)
    pitch = 0.9 * MM
    waves = [s.math("COSINE", s.math("MULTIPLY", x, 3.14159265 / pitch)) for x in (s.u, s.v)]
    over = s.math("MULTIPLY", s.math("MULTIPLY", *waves), 0.3)
    warp = s.math("MULTIPLY", s.math("ABSOLUTE", waves[0]), s.math("ADD", over, 0.7))
    weft = s.math("MULTIPLY", s.math("ABSOLUTE", waves[1]), s.math("SUBTRACT", 0.7, over))
    weave = s.math("MAXIMUM", warp, weft)
    s.add_bump(32 * UM, weave, "Weave")
    s.add_bump(8 * UM, s.noise(0.15 * MM, detail=1.0), "Fibres")
    slub = s.math("MULTIPLY", s.math("ADD", s.noise(0.8 * MM, 14 * MM), s.noise(14 * MM, 0.8 * MM)), 0.35)
    s.set_colour(
        s.ramp(
            s.add_values(s.math("MULTIPLY", weave, 0.65), slub), (0.2, (0.20, 0.13, 0.07)), (1.0, (0.62, 0.50, 0.34))
        )
    )
    return s.material


def make_leather() -> Any:
    """Make leather: pebbles of 1.5 mm, 32 µm high, and finer pores."""
    s = ShaderBuilder("Leather", Roughness=0.5, Specular_IOR_Level=0.5)
    pebble = s.step(s.cells(1.5 * MM, jitter=0.9), 0.0, 0.32)
    crease = s.step(s.cells(6.0 * MM), 0.0, 0.08)
    s.add_bump(32 * UM, s.math("MULTIPLY", pebble, s.math("ADD", s.math("MULTIPLY", crease, 0.4), 0.6)), "Pebbles")
    s.add_bump(8 * UM, s.noise(0.3 * MM, detail=2.0), "Pores")
    tone = s.add_values(s.math("MULTIPLY", s.noise(25 * MM, detail=4.0), 0.7), s.math("MULTIPLY", pebble, 0.25))
    s.set_colour(s.ramp(tone, (0.2, (0.055, 0.012, 0.006)), (0.6, (0.150, 0.036, 0.014)), (0.9, (0.235, 0.066, 0.026))))
    return s.material


def make_brushed_metal() -> Any:
    """Make brushed metal: scratches along u, 0.1–0.8 mm apart, about 5 of the noise's 15 µm deep."""
    s = ShaderBuilder("Brushed metal", Metallic=1.0, Roughness=0.3, Anisotropic=0.6)
    lines = s.noise(25 * MM, 0.4 * MM, detail=3.0, rough=0.7)
    s.add_bump(10 * UM, lines, "Brushing")
    s.set_colour(s.ramp(lines, (0.3, (0.50, 0.47, 0.42)), (0.7, (0.66, 0.62, 0.55))))
    s.set_input(s.surface.inputs["Roughness"], s.math("ADD", s.math("MULTIPLY", lines, 0.25), 0.16))
    return s.material


def make_terracotta() -> Any:
    """Make fired clay: grain from 1.6 mm down to 0.05 mm, about 0.4 of the noise's 26 µm range, with pits."""
    s = ShaderBuilder("Terracotta", Roughness=0.88, Specular_IOR_Level=0.2)
    grain = s.noise(1.6 * MM, detail=5.0, rough=0.7)
    pits = s.step(s.cells(3.2 * MM, "F1"), 0.06, 0.16)
    s.add_bump(26 * UM, grain, "Grain")
    s.add_bump(10 * UM, pits, "Pits")
    tone = s.add_values(s.math("MULTIPLY", s.noise(45 * MM, detail=6.0), 0.8), s.math("MULTIPLY", grain, 0.3))
    clay = s.ramp(tone, (0.3, (0.33, 0.105, 0.045)), (0.55, (0.47, 0.170, 0.080)), (0.8, (0.60, 0.275, 0.155)))
    dark = s.add("ShaderNodeMix", data_type="RGBA", blend_type="MULTIPLY")
    for socket in dark.inputs:
        if socket.enabled and socket.name in ("A", "B"):
            s.set_input(socket, clay if socket.name == "A" else (0.45, 0.40, 0.38))
        elif socket.enabled and socket.type == "VALUE":
            s.set_input(socket, s.math("SUBTRACT", 1.0, pits))
    s.set_colour(next(socket for socket in dark.outputs if socket.enabled))
    return s.material


def make_oak() -> Any:
    """Make oak planks 110 mm wide along u: open pores 60 µm deep, seams 300 µm deep."""
    s = ShaderBuilder("Oak planks", Roughness=0.5, Specular_IOR_Level=0.35)
    board = s.math("DIVIDE", s.v, 110 * MM)
    edge = s.math("MULTIPLY", s.math("PINGPONG", board, 0.5), 110 * MM)
    number = s.math("FLOOR", board)
    shift = s.math("MULTIPLY", number, 7.31)
    along = s.math("ADD", s.u, shift)
    warp = s.math("MULTIPLY", s.math("SUBTRACT", s.noise(180 * MM, 60 * MM, detail=2.0), 0.5), 0.05)
    across = s.math("ADD", s.math("ADD", s.v, warp), shift)

    def stretched(length_m: float, width_m: float, detail: float) -> Any:
        parts = [s.math("DIVIDE", along, length_m), s.math("DIVIDE", across, width_m)]
        node = s.add("ShaderNodeTexNoise", s.add("ShaderNodeCombineXYZ", *parts).outputs[0])
        node.inputs["Scale"].default_value, node.inputs["Detail"].default_value = 1.0, detail
        return node.outputs[0]

    rings, pores = stretched(400 * MM, 9 * MM, 4.0), stretched(14 * MM, 0.5 * MM, 2.0)
    open_pores = s.step(pores, 0.36, 0.5)
    s.add_bump(60 * UM, open_pores, "Pores")
    s.add_bump(300 * UM, s.step(edge, 0.0, 0.7 * MM), "Seams")
    tone = s.add_values(s.math("MULTIPLY", rings, 0.75), s.math("MULTIPLY", open_pores, 0.16))
    brightness = s.add("ShaderNodeTexWhiteNoise", None, number, noise_dimensions="1D").outputs[0]
    tone = s.math("ADD", tone, s.math("MULTIPLY", s.math("SUBTRACT", brightness, 0.5), 0.16))
    wood = s.ramp(tone, (0.28, (0.115, 0.058, 0.026)), (0.52, (0.270, 0.150, 0.072)), (0.8, (0.420, 0.262, 0.140)))
    s.set_colour(wood)
    return s.material


def make_paper() -> Any:
    """Make the edges of a block of pages: sheets 0.1 mm thick along the long side."""
    s = ShaderBuilder("Paper", Roughness=0.8)
    sheets = s.noise(90 * MM, 0.25 * MM, detail=1.0)
    s.add_bump(30 * UM, sheets, "Sheets")
    s.set_colour(s.ramp(sheets, (0.3, (0.50, 0.44, 0.34)), (0.7, (0.80, 0.75, 0.64))))
    return s.material


def make_glaze() -> Any:
    """Make glazed stoneware without any relief, so that only its appearance and name tell how it feels."""
    s = ShaderBuilder("Ceramic glaze", Roughness=0.16, Coat_Weight=0.4, Coat_Roughness=0.05)
    specks = s.step(s.cells(7 * MM, "F1"), 0.05, 0.10)
    s.set_colour(s.ramp(specks, (0.3, (0.16, 0.10, 0.06)), (0.7, (0.70, 0.67, 0.60))))
    return s.material


def make_lemon_peel() -> Any:
    """Make lemon peel: oil glands 1.8 mm apart, dimples 130 µm deep."""
    s = ShaderBuilder("Lemon peel", Roughness=0.38, Subsurface_Weight=0.08)
    s.surface.inputs["Subsurface Radius"].default_value = (4 * MM, 2 * MM, 0.5 * MM)
    s.surface.inputs["Subsurface Scale"].default_value = 1.0
    dimple = s.step(s.cells(1.8 * MM, "F1"), 0.05, 0.42)
    s.add_bump(130 * UM, dimple, "Dimples")
    s.set_colour(s.ramp(s.noise(20 * MM, detail=3.0), (0.3, (0.72, 0.42, 0.012)), (0.7, (0.86, 0.60, 0.035))))
    return s.material
