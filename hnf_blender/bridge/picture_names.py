"""Names of the pictures that feed a shader: what an artist called a texture says what it shows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import PureWindowsPath
from typing import Any

from .. import compat

IMAGE_NODES = frozenset({"ShaderNodeTexImage"})
GROUP_NODE, GROUP_OUTPUT_NODE = "ShaderNodeGroup", "NodeGroupOutput"


def list_texture_names(material: Any) -> tuple[str, ...]:
    """Of every image that material's surface is computed from: the datablock's name, and its file's where that is
    another; each once, in the order of the nodes' names. () for no material, or one without nodes."""
    if material is None or not compat.use_nodes(material) or material.node_tree is None:
        return ()
    output = material.node_tree.get_output_node("CYCLES")
    if output is None:
        return ()
    images = {node.image.name_full: node.image for node in _iter_image_nodes(output, set()) if node.image is not None}
    return tuple(dict.fromkeys(name for key in sorted(images) for name in _iter_image_names(images[key])))


def _iter_image_names(image: Any) -> Iterator[str]:
    yield str(image.name)
    file = PureWindowsPath(image.filepath).name if image.filepath else ""  # splits at both kinds of slash
    if file and not image.name.startswith(file):
        yield file


def _iter_image_nodes(node: Any, visited: set[int]) -> Iterator[Any]:
    """Image nodes that node depends on, its own groups' insides included."""
    if node.as_pointer() in visited:
        return
    visited.add(node.as_pointer())
    if node.bl_idname in IMAGE_NODES and not node.mute:
        yield node
    if node.bl_idname == GROUP_NODE and node.node_tree is not None and not node.mute:
        for inner in node.node_tree.nodes:
            if inner.bl_idname == GROUP_OUTPUT_NODE:
                yield from _iter_image_nodes(inner, visited)
    for socket in node.inputs:
        for link in socket.links:
            if not link.is_muted and link.is_valid:
                yield from _iter_image_nodes(link.from_node, visited)
