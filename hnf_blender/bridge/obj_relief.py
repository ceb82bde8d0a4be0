"""Restore the relief of an imported OBJ: height maps in metres, normal maps and displacement, as the .mtl means them.

Blender makes a normal map of every `map_Bump`, tagged as a color, and drops `norm` and `disp`. In the format `map_Bump`
is a grey height, times `-bm` in the units of the file; many programs write a normal map there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.errors import FileError
from hnf_core.scene.file_kind import identify, read_head

from .shader.images import is_grey, make_data_image

KEYWORDS = {
    "bump": "bump", "map_bump": "bump", "norm": "norm", "map_norm": "norm", "map_kn": "norm", "disp": "disp",
    "map_disp": "disp",
}  # fmt: skip
"""Statement of a .mtl file, in lower case → kind of relief."""
OPTION_COUNTS = {
    "-bm": 1, "-mm": 2, "-blendu": 1, "-blendv": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-texres": 1,
    "-type": 1,
}  # fmt: skip
"""Option of a texture statement → number of its values; -o, -s and -t have one to three."""


@dataclass(frozen=True)
class ReliefMap:
    """One texture statement of a .mtl file that gives a relief.

    Attributes
    ----------
    file : str
        Path of the picture, as written.
    multiplier : float
        -bm: height of white in units of the file (bump), or strength (norm).
    base, gain : float
        -mm: value v of the picture counts as base + gain · v.
    offset, scale : tuple of float
        -o and -s of the texture coordinates.
    """

    file: str
    multiplier: float = 1.0
    base: float = 0.0
    gain: float = 1.0
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)


def parse_relief_map(text: str) -> ReliefMap | None:
    """Parse what follows the keyword of a texture statement; None if it names no file or an option has no number."""
    words, values = text.split(), {}
    while words and words[0] in {*OPTION_COUNTS, "-o", "-s", "-t"}:
        option = words.pop(0)
        count = OPTION_COUNTS.get(option, 3)
        numbers: list[str] = []
        while words and len(numbers) < count and (option in OPTION_COUNTS or _is_number(words[0])):
            numbers.append(words.pop(0))
        values[option] = numbers
    if not words:
        return None
    try:
        base, gain = (float(each) for each in values.get("-mm", ("0", "1")))
        multiplier = float(values.get("-bm", ["1"])[0])
        offset, scale = (
            tuple([*(float(each) for each in values.get(name, ())), *default][:3])
            for name, default in (("-o", (0.0, 0.0, 0.0)), ("-s", (1.0, 1.0, 1.0)))
        )
    except (ValueError, IndexError):
        return None
    return ReliefMap(text[text.index(words[0]) :].strip(), multiplier, base, gain, offset, scale)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def parse_mtl(text: str) -> dict[str, dict[str, ReliefMap]]:
    """Return material name → kind of relief ("bump", "norm" or "disp") → its map, of the text of a .mtl file."""
    materials: dict[str, dict[str, ReliefMap]] = {}
    current: dict[str, ReliefMap] = {}
    for line in text.splitlines():
        keyword, _, rest = line.strip().partition(" ")
        if keyword == "newmtl":
            current = materials.setdefault(rest.strip(), {})
        elif keyword.lower() in KEYWORDS and (relief := parse_relief_map(rest.strip())) is not None:
            current[KEYWORDS[keyword.lower()]] = relief
    return materials


def restore_obj_relief(path: Path) -> None:
    """Give the materials that were imported from an .obj file the relief of its .mtl files.

    Raises FileError for a .mtl file that is something else.
    """
    import bpy

    for library in dict.fromkeys(_iter_libraries(path)):
        kind = identify(read_head(library))
        if kind is not None:
            raise FileError(f"is {kind.what}.", where=str(library), remedy=kind.remedy or "Export it again.")
        for name, reliefs in parse_mtl(library.read_text(encoding="utf-8", errors="replace")).items():
            material = bpy.data.materials.get(name)
            if material is not None and reliefs:
                _set_relief(material, reliefs, library.parent)


def _iter_libraries(path: Path) -> Iterator[Path]:
    """Yield the existing .mtl files that an .obj file names."""
    with path.open("rb") as stream:
        for line in stream:
            if line.startswith(b"mtllib"):
                library = path.parent / line[6:].decode("utf-8", "replace").strip()
                if library.is_file():
                    yield library


def _set_relief(material: Any, reliefs: dict[str, ReliefMap], folder: Path) -> None:
    tree = material.node_tree
    shader = next((node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"), None)
    if shader is None:
        return
    for node in _find_nodes_before(shader.inputs["Normal"]):  # Blender's reading
        tree.nodes.remove(node)
    if "norm" in reliefs:
        tree.links.new(_add_normal_map(tree, reliefs["norm"], folder), shader.inputs["Normal"])
    if "bump" in reliefs:
        _connect_bump(tree, shader, reliefs["bump"], folder)
    output = tree.get_output_node("CYCLES")
    if "disp" in reliefs and output is not None:
        relief = reliefs["disp"]
        node = tree.nodes.new("ShaderNodeDisplacement")
        node.inputs["Midlevel"].default_value = 0.0
        node.inputs["Scale"].default_value = relief.gain * relief.multiplier
        tree.links.new(_add_picture(tree, relief, folder).outputs["Color"], node.inputs["Height"])
        tree.links.new(node.outputs[0], output.inputs["Displacement"])


def _find_nodes_before(socket: Any) -> list[Any]:
    """Return the nodes that a socket depends on, each once."""
    nodes: dict[str, Any] = {}
    pending = [socket]
    while pending:
        for link in pending.pop().links:
            if link.from_node.name not in nodes:
                nodes[link.from_node.name] = link.from_node
                pending += link.from_node.inputs
    return list(nodes.values())


def _connect_bump(tree: Any, shader: Any, relief: ReliefMap, folder: Path) -> None:
    """Connect a `map_Bump`: a Bump node for a grey picture, a Normal Map node for one of normals."""
    picture = _add_picture(tree, relief, folder)
    if not is_grey(picture.image):
        tree.nodes.remove(picture)
        if not shader.inputs["Normal"].links:
            tree.links.new(_add_normal_map(tree, relief, folder), shader.inputs["Normal"])
        return
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Distance"].default_value = relief.multiplier * relief.gain
    bump.inputs["Strength"].default_value = 1.0
    tree.links.new(picture.outputs["Color"], bump.inputs["Height"])
    for link in list(shader.inputs["Normal"].links):
        tree.links.new(link.from_socket, bump.inputs["Normal"])
    tree.links.new(bump.outputs[0], shader.inputs["Normal"])


def _add_normal_map(tree: Any, relief: ReliefMap, folder: Path) -> Any:
    node = tree.nodes.new("ShaderNodeNormalMap")
    node.inputs["Strength"].default_value = max(relief.multiplier, 0.0)
    tree.links.new(_add_picture(tree, relief, folder).outputs["Color"], node.inputs["Color"])
    return node.outputs[0]


def _add_picture(tree: Any, relief: ReliefMap, folder: Path) -> Any:
    """Add an Image Texture node with a picture read as data, at the statement's texture coordinates."""
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = make_data_image(folder / relief.file.replace("\\", "/"))
    if not np.allclose(relief.offset, 0.0) or not np.allclose(relief.scale, 1.0):
        mapping, uv = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
        mapping.inputs["Location"].default_value = relief.offset
        mapping.inputs["Scale"].default_value = relief.scale
        tree.links.new(uv.outputs["UV"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs[0], node.inputs["Vector"])
    return node
