"""Names of the pictures that feed a shader: what an artist called a texture says what it shows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import PureWindowsPath
from typing import Any

from .. import compat

IMAGE_NODES = frozenset({"ShaderNodeTexImage"})
GROUP, GROUP_OUTPUT = "ShaderNodeGroup", "NodeGroupOutput"


def picture_names(material: Any) -> tuple[str, ...]:
    """Of every image that material's surface is computed from: the datablock's name, and its file's where that is
    another; each once, in the order of the nodes' names. () for no material, or one without nodes."""
    if material is None or not compat.use_nodes(material) or material.node_tree is None:
        return ()
    output = material.node_tree.get_output_node("CYCLES")
    if output is None:
        return ()
    images = {node.image.name_full: node.image for node in _feeding(output, set()) if node.image is not None}
    return tuple(dict.fromkeys(name for key in sorted(images) for name in _names(images[key])))


def _names(image: Any) -> Iterator[str]:
    yield str(image.name)
    file = PureWindowsPath(image.filepath).name if image.filepath else ""  # splits at both kinds of slash
    if file and not image.name.startswith(file):
        yield file


def _feeding(node: Any, seen: set[int]) -> Iterator[Any]:
    """Image nodes that node depends on, its own groups' insides included."""
    if node.as_pointer() in seen:
        return
    seen.add(node.as_pointer())
    if node.bl_idname in IMAGE_NODES and not node.mute:
        yield node
    if node.bl_idname == GROUP and node.node_tree is not None and not node.mute:
        for inner in node.node_tree.nodes:
            if inner.bl_idname == GROUP_OUTPUT:
                yield from _feeding(inner, seen)
    for socket in node.inputs:
        for link in socket.links:
            if not link.is_muted and link.is_valid:
                yield from _feeding(link.from_node, seen)
