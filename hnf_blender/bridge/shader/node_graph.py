"""Traverse shader node trees through reroutes, muted nodes and node groups."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

GROUP_NODE = "ShaderNodeGroup"


class NodeGraph:
    """A material's node tree with links resolved across reroutes, muted nodes and groups.

    Parameters
    ----------
    material : bpy.types.Material
        Material; a copy if nodes are to be edited.
    copy_groups : bool, default True
        Make node groups single-user, so that every node exists once and may be edited. If False the material is only
        read, and a group used twice is entered from one of its uses.
    """

    def __init__(self, material: Any, copy_groups: bool = True) -> None:
        self.material = material
        self.tree = material.node_tree
        self._parent: dict[str, Any] = {}
        self._enter_groups(self.tree, copy_groups)

    @property
    def output(self) -> Any:
        """Material Output node that Cycles uses, or None."""
        return self.tree.get_output_node("CYCLES")

    def resolve(self, socket: Any) -> Any:
        """Return the socket that gives an input socket its value.

        This is the output socket that computes it, or the unlinked input socket whose default_value it is.
        """
        if not socket.is_linked:  # Reading `links` takes a pass over all links of the tree.
            return socket
        link = next((link for link in socket.links if not link.is_muted and link.is_valid), None)
        return socket if link is None else self._source(link.from_socket)

    def _source(self, output: Any) -> Any:
        node = output.node
        if node.mute:
            internal_link = next((link for link in node.internal_links if link.to_socket == output), None)
            return output if internal_link is None else self.resolve(internal_link.from_socket)
        if node.bl_idname == "NodeReroute":
            return self.resolve(node.inputs[0])
        if node.bl_idname == GROUP_NODE and node.node_tree is not None:
            inner = _find_group_output(node.node_tree)
            return output if inner is None else self.resolve(_find_matching_socket(inner.inputs, output))
        if node.bl_idname == "NodeGroupInput":
            parent = self._parent.get(output.id_data.name_full)
            return output if parent is None else self.resolve(_find_matching_socket(parent.inputs, output))
        return output

    def source_node(self, socket: Any) -> Any:
        """Return the node that computes an input socket, or None for a constant."""
        source = self.resolve(socket)
        return source.node if source.is_output and not source.node.mute else None

    def upstream(self, socket: Any, stop: frozenset[str] = frozenset()) -> Iterator[Any]:
        """Yield every node that a socket depends on, each once.

        Nodes whose bl_idname is in `stop` are yielded, but their inputs are not followed.
        """
        visited: set[tuple[str, str]] = set()
        pending = [socket]
        while pending:
            node = self.source_node(pending.pop())
            if node is None or (key := (node.id_data.name_full, node.name)) in visited:
                continue
            visited.add(key)
            yield node
            if node.bl_idname not in stop:
                pending.extend(node.inputs)

    def _enter_groups(self, tree: Any, copy_groups: bool) -> None:
        for node in tree.nodes:
            if node.bl_idname == GROUP_NODE and node.node_tree is not None:
                if copy_groups:
                    node.node_tree = node.node_tree.copy()
                self._parent[node.node_tree.name_full] = node
                self._enter_groups(node.node_tree, copy_groups)


def iter_nodes(tree: Any, visited: set[str] | None = None) -> Iterator[Any]:
    """Yield every node of a tree and of the node groups in it, each group once."""
    visited = set() if visited is None else visited
    if tree is None or tree.name_full in visited:
        return
    visited.add(tree.name_full)
    for node in tree.nodes:
        yield node
        if getattr(node, "node_tree", None) is not None:
            yield from iter_nodes(node.node_tree, visited)


def _find_group_output(tree: Any) -> Any:
    outputs = [node for node in tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), outputs[0] if outputs else None)


def _find_matching_socket(sockets: Any, socket: Any) -> Any:
    return next(candidate for candidate in sockets if candidate.identifier == socket.identifier)
